"""The evidence method: weigh every hypothesis by what the cameras saw and did not see.

`_solve` runs the `passes` in order. Each pass maps an `EvidenceState`, which holds everything known
so far, to the next one, using one or two of the other packages. `observe` turns boxes into
likelihoods of position and height, in an information form that adds over cameras (derived in
`_gaussian`). `learn` estimates their noise from the sequence. `group` merges boxes that are more
likely to show one person than several. `track` weighs each group against clutter and misses, links
groups over time by motion, height and appearance, decides when each person is present, and
suppresses overlapping tracks. `report` selects the working area and adds the errors due to uneven
ground and camera poses. `docs/evidence_constants.md` lists and explains every constant.
"""

from catfree.methods.evidence._localize_by_evidence import (
    describe as describe,
    localize_by_evidence as localize_by_evidence,
)
from catfree.methods.evidence._solve import solve as solve
from catfree.methods.evidence._state import EvidenceState as EvidenceState
from catfree.settings import EvidenceSettings as EvidenceSettings
