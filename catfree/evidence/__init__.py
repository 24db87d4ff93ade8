"""catfree's own method: every hypothesis weighed by what the cameras saw and did not see."""

from catfree.evidence.output import (
    Clusters as Clusters,
    clusters_of as clusters_of,
    describe as describe,
    locate as locate,
)
from catfree.evidence.solve import EvidenceSolution as EvidenceSolution, solve as solve
from catfree.settings import EvidenceSettings as EvidenceSettings
