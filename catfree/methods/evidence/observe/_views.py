"""Cameras as linear maps from (y1, y2, H) on the ground, in units of H0, to pixels."""

from dataclasses import replace
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from catfree.geometry._person import box_ends, edges_of, people_in_rig
from catfree.methods.evidence.observe._boxes import Boxes
from catfree.methods.evidence.observe._local_pinholes import local_pinholes
from catfree.settings._calibration_settings import FOOT_AHEAD
from catfree.types import Lens, Rig, Scene

IN_FRONT = 1e-6  # H0; nearer points have no image


class GroundViews(eqx.Module):
    """The cameras of a scene, and the boxes' own pinholes, expressed on its ground plane.

    A point at plane position (y1, y2) and height h (all in units of H0, from `origin`) has the
    homogeneous pixel `matrix @ (y1, y2, h, 1)`; its third entry is positive in front of the camera.

    The first C of V views are the cameras without distortion (unused for cameras that are not
    pinholes); the others are the boxes' own pinholes (`Boxes.view`).

    Attributes:
        matrix: (V, 3, 4) projection; contains no NaN, even for unregistered cameras.
        ground_inverse: (V, 3, 3) map from a pixel to the homogeneous plane position of a foot.
        head_inverse: (V, 3, 3) the same for a point at height H0.
        focal: (V,) in pixels.
        center: (V, 2) principal point of the camera in pixels.
        image_size: (C, 2) width and height in pixels.
        station: (V, 2) the camera center projected onto the plane, in H0.
        heading: (C, 2) unit viewing direction of the camera on the plane.
        registered: (C,) bool.
        origin: (2,) plane coordinates of the local origin in scene units.
        unit: () H0 in scene units.
        rig: the cameras with their lenses, in (y1, y2, h) coordinates; None if all are ideal.
    """

    matrix: Float[np.ndarray, "view 3 4"]
    ground_inverse: Float[np.ndarray, "view 3 3"]
    head_inverse: Float[np.ndarray, "view 3 3"]
    focal: Float[np.ndarray, " view"]
    center: Float[np.ndarray, "view 2"]
    image_size: Float[np.ndarray, "cam 2"]
    station: Float[np.ndarray, "view 2"]
    heading: Float[np.ndarray, "cam 2"]
    registered: Bool[np.ndarray, " cam"]
    origin: Float[np.ndarray, "2"]
    unit: Float[np.ndarray, ""]
    rig: Rig | None


def ground_views(scene: Scene, unit: float, boxes: Boxes | None = None) -> GroundViews:
    """Express the rig on the plane, in units of H0.

    Args:
        scene: rig and ground plane in scene units.
        unit: H0 in scene units.
        boxes: boxes whose own pinholes are appended to the cameras.

    Returns:
        The cameras as maps from the plane to pixels.
    """
    rig = scene.rig
    registered = rig.registered
    count = rig.camera_count

    def host(value: Any, fallback: np.ndarray) -> np.ndarray:
        array = np.asarray(value, np.float64)
        return np.where(registered.reshape(-1, *(1,) * (array.ndim - 1)), array, fallback)

    K = host(rig.K, np.eye(3))
    R = host(rig.R, np.eye(3))
    t = host(rig.t, np.array([0.0, 0.0, 1.0]))
    normal = np.asarray(scene.ground.normal, np.float64)
    offset = float(scene.ground.offset)
    basis = np.asarray(scene.ground.basis, np.float64)
    centers = -np.einsum("cji,cj->ci", R, t)
    plane_centers = centers @ basis
    origin = plane_centers[registered].mean(0) if registered.any() else np.zeros(2)
    start = basis @ origin - offset * normal  # the local origin in the world
    forward = R[:, 2] @ basis  # optical axis on the plane; image up for a camera looking down
    upward = -R[:, 1] @ basis
    place = ((R @ start + t) / unit)[..., None]
    turn = np.concatenate([R @ basis, (R @ normal)[..., None]], -1)
    bent = replace(rig, K=K, R=turn, t=place[..., 0]) if not rig.is_ideal else None
    center, station = K[:, :2, 2], (plane_centers - origin) / unit
    if boxes is not None and len(boxes.K):
        non_pinhole = np.flatnonzero(boxes.view >= count)
        camera = np.pad(
            boxes.camera[non_pinhole], (0, len(boxes.K) - len(non_pinhole)), mode="edge"
        )
        K, R = np.concatenate([K, boxes.K]), boxes.R
        own_turn = np.concatenate([R @ basis, (R @ normal)[..., None]], -1)
        own_place = R @ ((start - centers[camera]) / unit)[..., None]
        turn, place = np.concatenate([turn, own_turn]), np.concatenate([place, own_place])
        registered = np.concatenate([registered, np.ones(len(camera), bool)])
        center = np.concatenate([center, center[camera]])
        station = np.concatenate([station, station[camera]])
    matrix = K @ np.concatenate([turn, place], -1)
    foot = matrix[..., [0, 1, 3]]
    head = np.concatenate([matrix[..., :2], matrix[..., 2:3] + matrix[..., 3:]], axis=-1)
    norm = np.linalg.norm(forward, axis=-1, keepdims=True)
    heading = np.where(norm > 1e-3, forward, upward)
    heading = heading / np.maximum(np.linalg.norm(heading, axis=-1, keepdims=True), 1e-12)
    return GroundViews(
        matrix=np.where(registered[:, None, None], matrix, np.eye(3, 4)),
        ground_inverse=_inverse(foot, registered),
        head_inverse=_inverse(head, registered),
        focal=np.sqrt(np.abs(K[:, 0, 0] * K[:, 1, 1])),
        center=center.copy(),
        image_size=np.asarray(rig.image_size, np.float64).reshape(count, 2),
        station=station,
        heading=heading,
        registered=registered[:count],
        origin=origin,
        unit=np.asarray(unit, np.float64),
        rig=bent,
    )


def people_in_cameras(
    state: Float[np.ndarray, "person 3"], views: GroundViews
) -> tuple[Float[np.ndarray, "person cam 3"], Bool[np.ndarray, "person cam"]]:
    """Predict the box edges of people in the images of all cameras, through their lenses.

    Args:
        state: (H, 3) positions and heights in H0.
        views: the cameras.

    Returns:
        edges: (H, C, 3) center column, head row, foot row in original pixels.
        imaged: (H, C) whether the camera images both foot and head; false if unregistered.
    """
    count = len(views.registered)
    head, foot, depth = box_ends(
        views.matrix[:count], state[:, None], views.station[:count], FOOT_AHEAD
    )
    edges, imaged = edges_of(head, foot), depth > IN_FRONT
    if views.rig is not None:
        for camera in np.flatnonzero(views.registered):
            head, foot, imaged[:, camera] = people_in_rig(views.rig, camera, state, FOOT_AHEAD)
            edges[:, camera] = edges_of(head, foot)
    return edges, imaged & views.registered


def pinholes_towards(
    state: Float[np.ndarray, "person 3"], camera: int, views: GroundViews
) -> tuple[Float[np.ndarray, "person 3 4"], Float[np.ndarray, " person"]]:
    """The pinhole in which a camera sees each person: its own, or one turned toward the person.

    Args:
        state: (H, 3) positions and heights in H0.
        camera: index of the camera.
        views: the cameras.

    Returns:
        matrix: (H, 3, 4) as in `GroundViews`.
        focal: (H,) in pixels.
    """
    people, rig = len(state), views.rig
    if rig is None or not views.registered[camera] or rig.lenses[camera] == Lens.PINHOLE:
        own = views.matrix[camera], views.focal[camera]
        return np.broadcast_to(own[0], (people, 3, 4)), np.broadcast_to(own[1], people)
    edges = edges_of(*people_in_rig(rig, camera, state, FOOT_AHEAD)[:2])
    middle = np.stack([edges[:, 0], edges[:, 1:].mean(-1)], -1)
    inside = np.clip(middle, 0, rig.image_size[camera] - 1)
    K, R, usable = local_pinholes(rig, np.full(people, camera), inside)
    place = -R @ np.asarray(rig.centers, np.float64)[camera][:, None]
    turned = K @ np.concatenate([R, place], -1)
    matrix = np.where(usable[:, None, None], turned, np.eye(3, 4))
    return matrix, np.sqrt(K[:, 0, 0] * K[:, 1, 1])


def _inverse(matrix: np.ndarray, registered: np.ndarray) -> np.ndarray:
    """Invert each 3x3 map; identity for cameras that are unregistered or in the plane."""
    largest = np.linalg.norm(matrix, axis=-2).prod(-1)  # determinant, in any unit of length
    good = registered & (np.abs(np.linalg.det(matrix)) > 1e-12 * largest)
    return np.linalg.inv(np.where(good[:, None, None], matrix, np.eye(3)))
