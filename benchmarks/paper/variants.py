"""The paper's named variants as settings, from the baseline I to the final method BT.

The base of each table follows from the paper's numbers: Table "gates" ends with BK's numbers, Table
"traj" with BS's, and Tables "quantile", "baselines" and "gatesunseen" with BT's.
"""

import dataclasses
from typing import Any

import catfree as cf


def changed(base: cf.Settings, **stages: dict[str, Any]) -> cf.Settings:
    """Replace some fields of settings: `changed(BT, selection={"gates": "none"})`."""
    return dataclasses.replace(
        base,
        **{
            stage: dataclasses.replace(getattr(base, stage), **fields)
            for stage, fields in stages.items()
        },
    )


BT = cf.Settings.paper()
BS = changed(BT, trajectories={"remove_short_static": True})
BK = changed(BS, triangulation={"refit_inliers": False})
BF = changed(BK, selection={"gates": "uncertainty_replace"})
Q = changed(BK, selection={"gates": "support"})
K = changed(Q, selection={"exclusive_support": True})
I = changed(  # noqa: E741 - the paper's name
    K, rays={"only_confirmed_ankles": True, "use_ankles": False, "use_box_height": False}
)
EVIDENCE = cf.Settings()
