"""A whole seeded world in one call: people, cameras, detections, a recovered scene, the truth."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from catfree.geometry._similarity import Similarity
from catfree.synthetic._disturbance import (
    RigError,
    arbitrary_gauge,
    disturb,
    disturb_ground,
)
from catfree.synthetic._layouts import Layout, make_layout
from catfree.synthetic._simulated_detector import DetectorModel, detect
from catfree.synthetic._walkers import Area, Walkers, simulate_walkers
from catfree.types import Detections, Rig, Scene


@dataclass(frozen=True)
class World:
    """What a method gets (`detections`, `scene`) and the truth that it is scored against.

    Attributes:
        detections: what the simulated detector reports.
        scene: disturbed rig and ground in an arbitrary gauge: what a reconstruction delivers.
        ground_truth: (N, 4) rows [frame, id, x, y] in metres of people inside the area.
        true_rig: cameras in metres, z up, ground z = 0.
        true_centres: (C, 3) their centres in metres.
        area: evaluation area (x_min, x_max, y_min, y_max) in metres.
        identities: (len(detections),) whom each detection shows, -1 for nobody.
        scene_from_world: similarity from metres to the gauge of `scene`; the disturbance is not
            part of it.
        walkers: everybody, bystanders and those outside the area too.
        layout: where the cameras stand.
        columns: (K, 4) x, y, radius and height in metres of static occluders.
        seed: the seed that it all follows from.
    """

    detections: Detections
    scene: Scene
    ground_truth: Float[np.ndarray, "n 4"]
    true_rig: Rig
    true_centres: Float[np.ndarray, "cam 3"]
    area: Area
    identities: Int[np.ndarray, " d"]
    scene_from_world: Similarity
    walkers: Walkers
    layout: Layout
    columns: Float[np.ndarray, "k 4"]
    seed: int

    @property
    def true_scene(self) -> Scene:
        """The undisturbed scene in metres."""
        return self.layout.scene


def make_world(
    layout: str | Layout = "ring6",
    seed: int = 0,
    *,
    frames: int = 100,
    people: int | None = None,
    background: int | None = None,
    columns: Float[np.ndarray, "k 4"] | None = None,
    rig_error: RigError | None = None,
    detector: DetectorModel | None = None,
    stay: float | int = 60.0,
    standing: float | int = 0.3,
    standing_time: float | int = 12.0,
) -> World:
    """A world with people in it, as a method sees it and as it is.

    `make_world("ring4", frames=10, people=6)` takes a hundredth of a second: small enough for a
    unit test. `RigError` says which angular noise of foot rays results.

    What is easy about these worlds: errors of different cameras and people are independent, the
    ground is flat, lenses have no distortion, and frames are synchronized exactly.

    Args:
        layout: a name for `make_layout` or a layout.
        seed: everything random follows from it.
        frames: number of frames.
        people: people in the area at a time; None: as usual for the layout.
        background: bystanders outside the area; None: a third as many as people.
        columns: (K, 4) x, y, radius and height in metres of static occluders, which people walk
            around, or None.
        rig_error: how wrong the recovered scene is; None: `RigError()`.
        detector: how good the detector is; None: `DetectorModel()`.
        stay: mean time in seconds until somebody leaves the area.
        standing: share of groups that stand when the sequence begins.
        standing_time: mean time in seconds for which a group stands.

    Returns:
        The world.
    """
    layout = make_layout(layout, seed) if isinstance(layout, str) else layout
    people = layout.people if people is None else people
    columns = np.zeros((0, 4)) if columns is None else np.asarray(columns, np.float64)
    walkers = simulate_walkers(
        layout.area,
        frames=frames,
        people=people,
        background=people // 3 if background is None else background,
        fps=layout.fps,
        seed=seed,
        stay=stay,
        standing=standing,
        standing_time=standing_time,
        obstacles=columns[:, :3],
    )
    detections, identities = detect(walkers, layout.rig, model=detector, columns=columns, seed=seed)
    recovered = _disturbed(layout.scene, RigError() if rig_error is None else rig_error, seed)
    scene, similarity = arbitrary_gauge(recovered, seed)
    return World(
        detections=detections,
        scene=scene,
        ground_truth=walkers.rows(),
        true_rig=layout.rig,
        true_centres=np.asarray(layout.rig.centers),
        area=layout.area,
        identities=identities,
        scene_from_world=similarity,
        walkers=walkers,
        layout=layout,
        columns=columns,
        seed=seed,
    )


def angular_residuals(world: World, rig: Rig | None = None) -> Float[np.ndarray, " n"]:
    """Angles between foot rays and the true positions of whom they show: real sigma_theta.

    Args:
        world: the world.
        rig: the cameras that shoot the rays, in metres and the world's frame; None: the true ones,
            which leaves the detector's part alone.

    Returns:
        (N,) radians, false positives left out.
    """
    rig = world.true_rig if rig is None else rig
    real = world.identities >= 0
    seen = world.detections[real]
    pixel = np.column_stack([seen.foot, np.ones(len(seen))])
    K, R = np.asarray(rig.K)[seen.camera], np.asarray(rig.R)[seen.camera]
    ray = np.einsum("nji,nj->ni", R, np.linalg.solve(K, pixel[..., None])[..., 0])
    position = world.walkers.position[seen.frame, world.identities[real]]
    center = np.asarray(rig.centers)[seen.camera]
    to_person = np.column_stack([position, np.zeros(len(seen))]) - center
    sine = np.linalg.norm(np.cross(ray, to_person), axis=-1)
    return np.arctan2(sine, np.einsum("ni,ni->n", ray, to_person))


def _disturbed(scene: Scene, error: RigError, seed: int) -> Scene:
    """The scene with a wrong rig and a wrong ground, still in metres."""
    rig = disturb(
        scene.rig,
        rotation_deg=error.rotation_deg,
        centre=error.centre,
        focal=error.focal,
        seed=seed,
    )
    ground = disturb_ground(
        scene.ground,
        tilt_deg=error.ground_tilt_deg,
        offset=error.ground_offset,
        about=np.zeros(3),
        seed=seed,
    )
    return Scene.from_rig(rig, ground)
