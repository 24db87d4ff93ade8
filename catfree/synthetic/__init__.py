"""Seeded synthetic worlds with known truth: people, cameras, detections, rendered video."""

from catfree.synthetic._disturbance import (
    RigError as RigError,
    arbitrary_gauge as arbitrary_gauge,
    disturb as disturb,
    disturb_ground as disturb_ground,
)
from catfree.synthetic._layouts import (
    Layout as Layout,
    gmvd_like as gmvd_like,
    make_layout as make_layout,
    multiviewx_like as multiviewx_like,
    ring as ring,
    shop as shop,
    wildtrack_like as wildtrack_like,
)
from catfree.synthetic._simulated_detector import DetectorModel as DetectorModel, detect as detect
from catfree.synthetic._walkers import Walkers as Walkers, simulate_walkers as simulate_walkers
from catfree.synthetic._world import (
    World as World,
    angular_residuals as angular_residuals,
    make_world as make_world,
)
