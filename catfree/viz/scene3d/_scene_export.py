"""Export of a scene in 3-D: a GLB file for any viewer, a `.rrd` file for rerun."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from catfree.adapters.files._documents import write_bytes_atomically
from catfree.errors import InvalidInputError, needing
from catfree.geometry import CanonicalFrame
from catfree.types import Localization, Scene
from catfree.types._scene import require_scene
from catfree.types._validation import as_path, as_rows
from catfree.types._writing import replacement
from catfree.viz._palette import CAMERA_COLOR, Color, track_color
from catfree.viz._plan_view import camera_names as names_of
from catfree.viz.scene3d._scene_geometry import (
    FRUSTUM_DEPTH,
    TUBE_RADIUS,
    frustum_corners,
    ground_corners,
    track_lines,
    tracks_of,
    tube,
)

GROUND_COLOR: Color = (200, 200, 200)
CLOUD_COLOR: Color = (110, 110, 110)


def write_glb(
    path: str | os.PathLike[str],
    scene: Scene,
    localization: Localization | None = None,
    *,
    points: Float[np.ndarray, "n 3"] | None = None,
    colors: Any = None,
    camera_names: Sequence[str] | None = None,
) -> Path:
    """Write cameras, ground, cloud and tracks as a GLB file, which any 3-D viewer opens.

    Nodes are named `ground`, `camera_<name>`, `cloud` and `track_<id>`. The file's y axis points
    up, as glTF requires; lengths are scene units, and the origin lies on the ground below the mean
    camera center, where float32 is accurate.

    Args:
        path: the GLB file.
        scene: cameras, ground and extent; unregistered cameras are left out.
        localization: its tracks are drawn as colored tubes, or None.
        points: (N, 3) reconstructed points in scene units, or None.
        colors: (N, 3) uint8 RGB of the points, or None for gray.
        camera_names: (C,) labels; None for C1, C2, ...

    Returns:
        The path.

    Raises:
        InvalidInputError: if colors do not match the points, the folder does not exist, or an
            argument has another type.
    """
    require_scene(scene)
    import trimesh
    from trimesh.exchange.gltf import export_glb
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    names, tracks = names_of(scene.rig, camera_names), tracks_of(localization)
    points = as_rows([] if points is None else points, 3, "points")
    frame, extent = CanonicalFrame.of(scene), float(scene.extent)

    def local(world: np.ndarray) -> np.ndarray:
        x, y, z = np.moveaxis(frame.to_canonical(world) * extent, -1, 0)
        return np.stack([x, z, -y], -1)

    model = trimesh.Scene()

    def add_mesh(name: str, vertices: np.ndarray, faces: Any, color: Color) -> None:
        material = PBRMaterial(
            baseColorFactor=[*color, 255], metallicFactor=0.0, roughnessFactor=0.9, doubleSided=True
        )
        look = TextureVisuals(material=material)
        mesh = trimesh.Trimesh(vertices, faces, visual=look, process=False)
        model.add_geometry(mesh, node_name=name, geom_name=name)

    quad = local(ground_corners(scene, tracks))
    add_mesh("ground", quad, [[0, 1, 2], [0, 2, 3]], GROUND_COLOR)
    pyramid = [[0, 2, 1], [0, 3, 2], [0, 4, 3], [0, 1, 4], [1, 2, 3], [1, 3, 4]]
    for camera in np.flatnonzero(scene.rig.registered).tolist():
        corners = local(frustum_corners(scene, camera, FRUSTUM_DEPTH * extent))
        add_mesh(f"camera_{names[camera]}", corners, pyramid, CAMERA_COLOR)
    if len(points):
        shade = np.tile(CLOUD_COLOR, (len(points), 1)) if colors is None else np.asarray(colors)
        if shade.shape != (len(points), 3):
            raise InvalidInputError(f"colors must be ({len(points)}, 3), got {shade.shape}.")
        cloud = trimesh.PointCloud(local(points), colors=shade.astype(np.uint8))
        model.add_geometry(cloud, node_name="cloud", geom_name="cloud")
    for identity, line in track_lines(tracks).items():
        rings = tube(local(line), TUBE_RADIUS * extent, np.array([0.0, 1.0, 0.0]))
        add_mesh(f"track_{identity}", *rings, track_color(identity))
    return write_bytes_atomically(path, export_glb(model))


def write_rerun(
    path: str | os.PathLike[str],
    scene: Scene,
    localization: Localization | None = None,
    *,
    points: Float[np.ndarray, "n 3"] | None = None,
    colors: Any = None,
    camera_names: Sequence[str] | None = None,
) -> Path:
    """Write the scene with moving tracks as a recording to play with `rerun FILE.rrd`.

    Args:
        path: the `.rrd` file.
        scene: cameras, ground and extent.
        localization: its positions are logged on the timeline "frame", or None.
        points: (N, 3) reconstructed points in scene units, or None.
        colors: (N, 3) uint8 RGB of the points, or None for gray.
        camera_names: (C,) labels; None for C1, C2, ...

    Returns:
        The path.

    Raises:
        MissingDependencyError: if rerun is not installed.
        InvalidInputError: if the folder does not exist.
        WriteError: if the disk is full or not writable.
    """
    require_scene(scene)
    with needing("Recordings for rerun need its SDK: pip install 'catfree[rerun]'."):
        import rerun  # pyright: ignore[reportMissingImports]
    target, rig, extent = as_path(path, "path"), scene.rig, float(scene.extent)
    names, tracks = names_of(rig, camera_names), tracks_of(localization)
    recording = rerun.RecordingStream("catfree")
    with replacement(target) as partial:
        recording.save(partial)
        outline = ground_corners(scene, tracks)
        border = rerun.LineStrips3D([np.vstack([outline, outline[:1]])], colors=[GROUND_COLOR])
        recording.log("ground", border, static=True)
        for camera in np.flatnonzero(rig.registered).tolist():
            pose = rerun.Transform3D(
                translation=np.asarray(rig.centers)[camera], mat3x3=np.asarray(rig.R)[camera].T
            )
            K = np.asarray(rig.K)[camera]
            lens = rerun.Pinhole(
                image_from_camera=K,
                resolution=rig.image_size[camera],
                image_plane_distance=FRUSTUM_DEPTH * extent,
            )
            recording.log(f"cameras/{names[camera]}", pose, lens, static=True)
        if points is not None and len(points):
            shade = [CLOUD_COLOR] if colors is None else np.asarray(colors, np.uint8)
            recording.log("cloud", rerun.Points3D(points, colors=shade), static=True)
        for identity, line in track_lines(tracks).items():
            strip = rerun.LineStrips3D([line], colors=[track_color(identity)])
            recording.log(f"tracks/{identity}", strip, static=True)
        for frame in np.unique(tracks.frame):
            people = tracks[tracks.frame == frame]
            recording.set_time("frame", sequence=int(frame))
            dots = rerun.Points3D(
                people.position,
                colors=[track_color(identity) for identity in people.track_id],
                labels=[str(identity) for identity in people.track_id],
                radii=4 * TUBE_RADIUS * extent,
            )
            recording.log("people", dots)
        recording.flush()
        recording.disconnect()  # closes the file
    return target
