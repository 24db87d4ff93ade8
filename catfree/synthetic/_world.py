"""A complete seeded world: people, cameras, detections, a recovered scene and the truth."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from catfree.geometry._similarity import Similarity
from catfree.geometry.camera import rays_of_pixels
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
from catfree.types._validation import as_rows, require_instance


@dataclass(frozen=True)
class World:
    """Input of a method (`detections`, `scene`) and the truth to score it against.

    Attributes:
        detections: output of the simulated detector.
        scene: disturbed rig and ground in an arbitrary gauge, as from a reconstruction.
        ground_truth: (N, 4) rows [frame, id, x, y] in meters of people inside the area.
        true_rig: cameras in meters, z up, ground z = 0.
        true_centres: (C, 3) centers of these cameras in meters.
        area: evaluation area (x_min, x_max, y_min, y_max) in meters.
        identities: (len(detections),) person in each detection, -1 for no person.
        scene_from_world: similarity from meters to the gauge of `scene`; the disturbance is not
            part of it.
        walkers: all people, including bystanders and people outside the area.
        layout: the camera layout.
        columns: (K, 4) x, y, radius and height in meters of static occluders.
        seed: the seed of the world.
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
        """The undisturbed scene in meters."""
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
    """Simulate a world with people: the input of a method and the truth.

    `make_world("ring4", frames=10, people=6)` takes a hundredth of a second, fast enough for a
    unit test. `RigError` states the resulting angular noise of foot rays.

    These worlds are easier than real ones: errors of different cameras and people are independent,
    the ground is flat, lenses have no distortion, and frames are exactly synchronized.

    Args:
        layout: a name for `make_layout` or a layout.
        seed: determines all random draws.
        frames: number of frames.
        people: usual number of people in or around the area; None: the layout's.
        background: number of bystanders outside the area; None: a third of `people`.
        columns: (K, 4) x, y, radius and height in meters of static occluders, which people walk
            around, or None.
        rig_error: errors of the recovered scene; None: `RigError()`.
        detector: quality of the detector; None: `DetectorModel()`.
        stay: mean time in seconds until a group leaves the area.
        standing: share of groups that stand when the sequence begins.
        standing_time: mean time in seconds for which a group stands.

    Returns:
        The world.

    Raises:
        InvalidInputError: if there is no such layout, columns have another shape, the error or
            detector has another type, or as `simulate_walkers`.
    """
    layout = make_layout(layout, seed) if isinstance(layout, str) else layout
    require_instance(layout, Layout, "layout")
    errors = RigError() if rig_error is None else rig_error
    require_instance(errors, RigError, "rig_error")
    people = layout.people if people is None else people
    columns = as_rows([] if columns is None else columns, 4, "columns").astype(np.float64)
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
    recovered = _disturbed(layout.scene, errors, seed)
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
    """Compute angles between foot rays and their people's true positions, to get sigma_theta.

    Args:
        world: the world.
        rig: the cameras that cast the rays, in meters in the world's frame; None: the true ones,
            so that the angles contain only the detector's errors.

    Returns:
        (N,) radians, without false positives.
    """
    rig = world.true_rig if rig is None else rig
    real = world.identities >= 0
    people = world.detections[real]
    ray = rays_of_pixels(rig, people.camera, people.foot)
    position = world.walkers.position[people.frame, world.identities[real]]
    center = np.asarray(rig.centers)[people.camera]
    to_person = np.column_stack([position, np.zeros(len(people))]) - center
    sine = np.linalg.norm(np.cross(ray, to_person), axis=-1)
    return np.arctan2(sine, np.einsum("ni,ni->n", ray, to_person))


def _disturbed(scene: Scene, error: RigError, seed: int) -> Scene:
    """The scene with a disturbed rig and ground, still in meters."""
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
