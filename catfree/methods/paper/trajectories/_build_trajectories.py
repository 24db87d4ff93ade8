"""Tracks from accepted positions: link, drop short tracks, extend."""

import numpy as np
from jaxtyping import Float, Int

from catfree.methods.paper._select import Selection
from catfree.methods.paper.association import Located, Observations, find_support
from catfree.methods.paper.trajectories._extend import extend_tracks
from catfree.methods.paper.trajectories._link import (
    Positions,
    drop_short,
    link_positions,
)
from catfree.settings import Settings
from catfree.types import Origin, Rays


def build_trajectories(
    observations: Observations,
    rays: Rays,
    located: Located,
    selection: Selection,
    settings: Settings,
) -> tuple[Positions, float | None]:
    """Link the accepted positions, drop short tracks, extend the others.

    Args:
        observations: detections in canonical order.
        rays: their weighted rays in the canonical frame.
        located: the hypotheses.
        selection: their fates.
        settings: settings of the run.

    Returns:
        The positions of all tracks, and the appearance threshold of the extension, or None if it
        was not used.

    Source:
        Sec. "Trajectories".
    """
    rules = settings.trajectories
    chosen = np.flatnonzero(selection.accepted)
    chosen = chosen[np.argsort(located.hypotheses.frame_index[chosen], kind="stable")]
    positions = Positions(
        located.hypotheses.frame_index[chosen],
        located.hypotheses.ground_xy[chosen],
        located.support.member[chosen],
        np.full(len(chosen), -1),
        np.full(len(chosen), int(Origin.DETECTED)),
    )
    if not rules.enabled:
        return positions, None
    track = link_positions(positions, observations.time, observations.appearance, rules)
    lasting = drop_short(track, positions.ground_xy, rules)
    positions = Positions(*(column[lasting] for column in positions._replace(track=track)))
    positions = positions._replace(track=np.unique(positions.track, return_inverse=True)[1])
    if not rules.extend:
        return positions, None
    radius = rules.extension_support_factor * settings.rays.sigma_theta

    def recount(
        frame_index: Int[np.ndarray, " k"], xy: Float[np.ndarray, "k 2"]
    ) -> tuple[Int[np.ndarray, "k cam"], Float[np.ndarray, " k"]]:
        member = find_support(
            located.table, frame_index, np.pad(xy, ((0, 0), (0, 1))), radius=radius
        )
        weight = np.where(member >= 0, rays.weight[member], 0).sum(axis=1)
        return member, weight

    return extend_tracks(
        positions,
        observations.time,
        observations.appearance,
        recount,
        rules,
        occupied_radius=settings.selection.suppression_radius,
    )
