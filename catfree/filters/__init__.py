"""Selection of hypotheses: thresholds, gates, support, persistence, suppression, score."""

from catfree.filters._gates import Gates as Gates, select as select
from catfree.filters._otsu import (
    log_otsu as log_otsu,
    otsu as otsu,
    otsu_separability as otsu_separability,
)
from catfree.filters._score import (
    AuxiliaryScore as AuxiliaryScore,
    Signal as Signal,
    auxiliary_score as auxiliary_score,
    height_consistency as height_consistency,
    median_residual as median_residual,
    view_support_ratio as view_support_ratio,
)
from catfree.filters._support import support as support, weighted_support as weighted_support
from catfree.filters._suppression import outside as outside, suppress as suppress
from catfree.filters._temporal import (
    frames_of_pairs as frames_of_pairs,
    temporally_consistent as temporally_consistent,
)
from catfree.geometry._person import implied_height as implied_height
