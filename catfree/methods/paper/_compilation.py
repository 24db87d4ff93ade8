"""Compile the later stages while the first ones run: half of a cold start is XLA's compiler."""

from concurrent.futures import Future, ThreadPoolExecutor

import jax.numpy as jnp
import numpy as np

from catfree.methods.paper._select import select_positions, suppress_by_frame
from catfree.methods.paper.association import Groups, Observations, locate
from catfree.settings import Settings
from catfree.types import Rays, Rig

_started: set[tuple[object, ...]] = set()


def start_compilation(
    observations: Observations, rays: Rays, rig: Rig, settings: Settings
) -> Future[None]:
    """Run the stages behind the association on one dummy group, in a thread of its own.

    All stages work on blocks of fixed size, so what one group compiles serves the sequence. Nothing
    is computed twice: a second call with the same shapes and settings returns at once.

    Args:
        observations: detections in canonical order.
        rays: their rays.
        rig: cameras in the canonical frame.
        settings: settings of the run.

    Returns:
        A future to wait for before the first of those stages.
    """
    finished: Future[None] = Future()
    finished.set_result(None)
    widest = int(np.diff(observations.cell_start).max(initial=0)).bit_length()
    key = (observations.camera_count, rays.origin.dtype, widest, settings)
    # A float width that holds for one thread only would compile the wrong functions.
    if key in _started or len(observations) < 2 or jnp.result_type(float) == np.float64:
        return finished
    _started.add(key)
    pool = ThreadPoolExecutor(1)
    future = pool.submit(_run_once, observations, rays, rig, settings)
    pool.shutdown(wait=False)
    return future


def _run_once(observations: Observations, rays: Rays, rig: Rig, settings: Settings) -> None:
    member = np.full((1, observations.camera_count), -1)
    member[0, observations.camera[0]] = 0
    group = Groups(member, observations.frame_index[:1])
    tracklet = np.arange(len(observations))
    located = locate(observations, rays, rig, group, tracklet, settings)
    select_positions(located.hypotheses, settings.selection, sigma_theta=settings.rays.sigma_theta)
    suppress_by_frame(
        group.frame_index,
        located.hypotheses.ground_xy,
        np.zeros((1, 2), located.position.dtype),
        np.ones(1, bool),
        settings.selection.suppression_radius,
    )
