"""catfree's own method: every hypothesis weighed by what the cameras saw and did not see.

In the order of the data: boxes become likelihoods of place and height (`boxes`, `visibility`,
`measurement`) in information form, which adds over cameras (`gaussian` derives it); the sequence
teaches their noise (`self_calibration`, `noise`); boxes that are likelier one person than two are
grouped (`association`, `appearance`), each group is weighed against clutter and misses
(`existence`), linked over time by motion, height and looks (`tracking`), there while the evidence
lasts (`presence`), and reported once in its place (`exclusion`, `working_area`) with what else may
be wrong (`uneven_ground`, `shared_error`). Every constant and its reason:
`docs/evidence_constants.md`.
"""

from catfree.methods.evidence._localize_by_evidence import (
    Clusters as Clusters,
    clusters_of as clusters_of,
    describe as describe,
    localize_by_evidence as localize_by_evidence,
)
from catfree.methods.evidence._solve import EvidenceSolution as EvidenceSolution, solve as solve
from catfree.settings import EvidenceSettings as EvidenceSettings
