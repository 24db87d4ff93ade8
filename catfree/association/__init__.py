"""Which detections are one person: tracklets, ray reliability, cross-view groups, hypotheses."""

from catfree.association.groups import (
    Groups as Groups,
    associate as associate,
    associate_in_two_passes as associate_in_two_passes,
    learn_pose_ratio as learn_pose_ratio,
    weigh_rays as weigh_rays,
)
from catfree.association.hypotheses import (
    RayTable as RayTable,
    Support as Support,
    exclusive_support as exclusive_support,
    find_support as find_support,
    measure_support as measure_support,
    ray_table as ray_table,
    triangulate_groups as triangulate_groups,
)
from catfree.association.locate import Located as Located, locate as locate
from catfree.association.observations import Observations as Observations, observe as observe
from catfree.association.pairs import (
    CandidatePairs as CandidatePairs,
    candidate_pairs as candidate_pairs,
)
from catfree.association.partition import greedy_partition as greedy_partition
from catfree.association.rays import CanonicalFrame as CanonicalFrame, cast_rays as cast_rays
from catfree.association.reliability import pose_ratio as pose_ratio, ray_weights as ray_weights
from catfree.association.signals import hypothesis_scores as hypothesis_scores
from catfree.association.tracklets import link_tracklets as link_tracklets
