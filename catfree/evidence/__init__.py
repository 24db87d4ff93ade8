"""catfree's own method: every hypothesis weighed by what the cameras saw and did not see."""

from catfree.evidence.constants import EvidenceSettings as EvidenceSettings
from catfree.evidence.output import locate as locate
from catfree.evidence.solve import Solution as Solution, solve as solve
