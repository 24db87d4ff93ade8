"""Association of detections with people: tracklets, ray reliability, groups, hypotheses."""

from catfree.methods.paper.association._associate import (
    associate as associate,
    associate_in_two_passes as associate_in_two_passes,
    learn_pose_ratio as learn_pose_ratio,
    weigh_rays as weigh_rays,
)
from catfree.methods.paper.association._candidate_pairs import (
    CandidatePairs as CandidatePairs,
    candidate_pairs as candidate_pairs,
)
from catfree.methods.paper.association._cast_rays import cast_rays as cast_rays
from catfree.methods.paper.association._greedy_partition import greedy_partition as greedy_partition
from catfree.methods.paper.association._hypotheses import (
    RayTable as RayTable,
    Support as Support,
    exclusive_support as exclusive_support,
    find_support as find_support,
    measure_support as measure_support,
    ray_table as ray_table,
    triangulate_groups as triangulate_groups,
)
from catfree.methods.paper.association._hypothesis_scores import (
    hypothesis_scores as hypothesis_scores,
)
from catfree.methods.paper.association._locate import Located as Located, locate as locate
from catfree.methods.paper.association._observe import (
    Observations as Observations,
    observe as observe,
)
from catfree.methods.paper.association._ray_weights import (
    measured_pose_ratio as measured_pose_ratio,
    ray_weights as ray_weights,
)
from catfree.methods.paper.association._tracklets import link_tracklets as link_tracklets
