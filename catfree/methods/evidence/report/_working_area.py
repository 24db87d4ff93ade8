"""Working area: the ground where the rig locates an unoccluded person precisely."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import KDTree

from catfree.geometry._person import edge_deviation
from catfree.methods.evidence._gaussian import Information, mean_and_covariance
from catfree.methods.evidence.observe._measurement import Noise
from catfree.methods.evidence.observe._sightings import predicted_edges
from catfree.methods.evidence.observe._views import GroundViews, pinholes_towards
from catfree.methods.evidence.observe._visibility import Views
from catfree.settings import EvidenceSettings
from catfree.types._sampling import evenly_spread

MOST_SAMPLES = 16384  # positions from which the usual place is learned


def coverage_of(
    state: np.ndarray,
    visibility: Views,
    seeing: Bool[np.ndarray, " cam"],
    views: GroundViews,
    noise: Noise,
    settings: EvidenceSettings,
) -> Float[np.ndarray, "person 2"]:
    """Compute how well the cameras that see any people, marked in `seeing`, cover places.

    Occlusion is ignored.

    Returns:
        (n, 2) ground uncertainty in H0, and number of images with the whole body.
    """
    # A weak prior makes positions that no camera sees vague, not undefined.
    info = np.tile(1e-6 * np.eye(3), (len(state), 1, 1))
    for camera in np.flatnonzero(seeing).tolist():  # all slopes together would be large
        matrix, focal = pinholes_towards(state, camera, views)
        station = np.broadcast_to(views.station[camera], (len(state), 2))
        _, slopes = predicted_edges(state, matrix, station)
        height, floor = visibility.height[:, camera, None], noise.angular * focal[:, None]
        sd = edge_deviation(height, noise.edge[camera], floor)
        weight = visibility.inside[:, camera, None] / sd**2
        info += np.einsum("nki,nk,nkj->nij", slopes[..., :3], weight, slopes[..., :3])
    flat = Information(info, np.zeros(state.shape), np.zeros(len(state)))
    _, covariance = mean_and_covariance(flat, noise.spread)
    sigma = np.sqrt((covariance[:, 0, 0] + covariance[:, 1, 1]) / 2)
    whole = (visibility.share[:, seeing] >= settings.cover_edges[-1]).sum(1)
    return np.column_stack([sigma, whole])


def in_working_area(
    xy: Float[np.ndarray, "person 2"],
    coverage: Float[np.ndarray, "person 2"],
    cameras: int,
    settings: EvidenceSettings,
) -> Bool[np.ndarray, " person"]:
    """Mark the positions in the working area, relative to the usual places of people, (n,).

    Two criteria must hold. First, the design uncertainty is not far above the median of the places.
    Second, the number of images with the whole body is less than half of the rig (`missing_views`)
    below that of most places (`most_places`), or at least `witnesses`, which suffice for the
    cameras to check each other. The second criterion is waived if most places have fewer such
    images than that.

    Args:
        xy: (n, 2) positions in H0.
        coverage: (n, 2) result of `coverage_of`.
        cameras: number of cameras that see any people: the size of the rig.
        settings: constants.

    Returns:
        (n,) whether the position is in the area.
    """
    if len(xy) == 0:
        return np.zeros(0, bool)
    return usual_place(xy, coverage, settings).holds(coverage, cameras, settings)


class UsualPlace(NamedTuple):
    """Typical coverage of the places where people go.

    Attributes:
        sigma: median design uncertainty, in the unit of its input.
        whole: number of images with the whole body that most places have.
    """

    sigma: float
    whole: float

    def holds(
        self, coverage: Float[np.ndarray, "person 2"], cameras: int, settings: EvidenceSettings
    ) -> Bool[np.ndarray, " person"]:
        """Mark the places whose coverage puts them in the area, (n,)."""
        sigma, whole = coverage.T
        enough = self.whole - whole < settings.missing_views * cameras
        enough |= (whole >= settings.witnesses) | (self.whole < settings.witnesses)
        return (np.log(sigma) <= np.log(self.sigma) + np.log(settings.working_sigma)) & enough


def usual_place(
    xy: Float[np.ndarray, "person 2"],
    coverage: Float[np.ndarray, "person 2"],
    settings: EvidenceSettings,
) -> UsualPlace:
    """Learn from at least one position; each place counts once, however long somebody stands there.

    Args:
        xy: as `in_working_area`; many are evenly subsampled. Positions closer than `report_radius`
            share the weight of one.
        coverage: as `in_working_area`.
        settings: constants.
    """
    xy, (sigma, whole) = evenly_spread(xy, MOST_SAMPLES), evenly_spread(coverage, MOST_SAMPLES).T
    weight = 1 / KDTree(xy).query_ball_point(xy, settings.report_radius, return_length=True)
    return UsualPlace(
        _quantile(sigma, 0.5, weight), _quantile(whole, 1 - settings.most_places, weight)
    )


def _quantile(
    values: Float[np.ndarray, " person"], share: float, weight: Float[np.ndarray, " person"]
) -> float:
    """The smallest value that a share of the weight does not exceed."""
    return float(np.quantile(values, share, weights=weight, method="inverted_cdf"))
