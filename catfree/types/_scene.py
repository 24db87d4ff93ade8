"""The ground `Plane`, the `Scene` of a rig and its ground, and the cameras' `Rays`."""

import os
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from catfree.errors import InvalidInputError
from catfree.types._annotations import HostOrDevice
from catfree.types._archive import arguments_of, load_arrays, naming_file, save_arrays
from catfree.types._georeference import GeoReference
from catfree.types._rig import Rig
from catfree.types._validation import (
    as_flag,
    as_float,
    as_number,
    is_traced,
    require_finite,
    require_instance,
    require_shape,
)

HIGHEST_CAMERA = 100.0  # meters


class Plane(eqx.Module):
    """The plane `normal · x + offset = 0` with the cameras on its positive side.

    Attributes:
        normal: (3,) unit normal; any non-zero normal is accepted and scaled together with offset.
        offset: () in scene units.
    """

    normal: Float[HostOrDevice, "3"]
    offset: Float[HostOrDevice, ""]

    def __init__(self, normal: Any, offset: Any) -> None:
        """Normalize and store.

        Raises:
            InvalidInputError: if the normal is zero or anything is not finite.
        """
        normal, offset = as_float(normal, "normal"), as_float(offset, "offset")
        require_shape(normal, (3,), "normal")
        require_shape(offset, (), "offset")
        if is_traced(normal, offset):
            length = jnp.linalg.norm(normal)
        else:
            require_finite(normal, "normal")
            require_finite(offset, "offset")
            largest = np.abs(normal).max()
            if largest == 0:
                raise InvalidInputError("A plane needs a non-zero normal.")
            # Squares of very large or small components overflow or underflow.
            if not 1e-15 < largest < 1e15:
                with np.errstate(over="ignore"):
                    normal, offset = normal / largest, np.asarray(offset / largest)
                require_finite(offset, "The offset of a plane in units of its normal")
            length = np.linalg.norm(np.asarray(normal, np.float64)).astype(normal.dtype)
            # A normal of unit length to within rounding is kept bit for bit. Any other is scaled:
            # even a small error of its length would displace the plane far from the origin of a
            # map.
            exact = abs(length - 1) <= 4 * np.finfo(normal.dtype).eps
            length = normal.dtype.type(1) if exact else length
        self.normal = normal / length
        self.offset = offset / length
        if isinstance(offset, np.ndarray) and not is_traced(length):
            self.offset = np.asarray(self.offset)

    @property
    def basis(self) -> Float[HostOrDevice, "3 2"]:
        """(3, 2) orthonormal in-plane axes P; world x and y for a plane with normal z.

        The first axis is world x projected on the plane (world z where x is almost the normal),
        the second is `normal x first`.
        """
        xp = np if isinstance(self.normal, np.ndarray) else jnp
        axes = xp.eye(3, dtype=self.normal.dtype)
        seed = xp.where(xp.abs(self.normal[0]) < 0.9, axes[0], axes[2])
        first = seed - self.normal * (self.normal @ seed)
        first = first / xp.sqrt(first @ first)
        return xp.stack([first, xp.cross(self.normal, first)], axis=-1)

    def signed_distance(self, x: Any) -> Any:
        """Signed distance of points (..., 3) to the plane, (...), positive on the cameras' side.

        Raises:
            InvalidInputError: if points do not have three coordinates.
        """
        x = as_float(x, "x")
        if x.shape[-1:] != (3,):
            raise InvalidInputError(f"Points must have shape (..., 3), got {x.shape}.")
        return x @ self.normal + self.offset

    def project(self, x: Any) -> Any:
        """Orthogonal projection of points (..., 3) onto the plane, (..., 3).

        Raises:
            InvalidInputError: if points do not have three coordinates.
        """
        x = as_float(x, "x")
        return x - self.signed_distance(x)[..., None] * self.normal


class Scene(eqx.Module):
    """A rig, its ground plane, and the reference length of the scene.

    Attributes:
        rig: the cameras.
        ground: the plane people stand on, cameras on its positive side.
        extent: () E, a length in scene units: twice the median distance of the camera centers
            from their mean (`Scene.from_rig`), unless the source of the scene says otherwise.
        metric: whether scene units are meters.
        georeference: where the ground is on Earth, or None.
        rig_sd: standard deviation of the camera centers in scene units, root mean square over the
            cameras after the best similarity; None if unknown, as for given cameras.
    """

    rig: Rig
    ground: Plane
    extent: Float[HostOrDevice, ""]
    metric: bool = eqx.field(static=True)
    georeference: GeoReference | None = eqx.field(static=True)
    rig_sd: float | None

    def __init__(
        self,
        rig: Rig,
        ground: Plane,
        extent: Any,
        metric: bool = False,
        georeference: GeoReference | None = None,
        rig_sd: Any = None,
    ) -> None:
        """Validate and store.

        Raises:
            InvalidInputError: if rig, ground, metric or georeference has another type, the extent
                is not positive, `rig_sd` is not a length, or the cameras are below the ground.
        """
        require_instance(rig, Rig, "rig")
        require_instance(ground, Plane, "ground")
        if georeference is not None:
            require_instance(georeference, GeoReference, "georeference")
        self.georeference = georeference
        self.rig, self.ground, self.extent = rig, ground, as_float(extent, "extent")
        self.metric = as_flag(metric, "metric")
        if not (rig_sd is None or is_traced(rig_sd)):
            rig_sd = as_number(rig_sd, "rig_sd")
        self.rig_sd = rig_sd
        require_shape(self.extent, (), "extent")
        if is_traced(self.extent, rig.R, rig.t, ground.normal, ground.offset):
            return
        if not (np.isfinite(self.extent) and self.extent > 0):
            raise InvalidInputError(f"extent is {self.extent}; it must be a positive length.")
        if self.rig_sd is not None and self.rig_sd < 0:
            raise InvalidInputError(f"rig_sd is {self.rig_sd}; it must be a length, or None.")
        height = np.asarray(ground.signed_distance(np.asarray(rig.centers)))[rig.registered]
        if height.size and np.median(height) < 0:
            raise InvalidInputError(
                "The cameras are on the negative side of the ground (median "
                f"{np.median(height):.3g} scene units). Flip the plane: Plane(-normal, -offset)."
            )

    @classmethod
    def from_rig(cls, rig: Any, ground: Plane, metric: bool = False) -> "Scene":
        """Make a scene whose extent is twice the median distance of the centers from their mean.

        Args:
            rig: a `Rig`, or an object with an attribute `rig`, as calibration readers return.
            ground: the plane people stand on, cameras on its positive side.
            metric: whether the rig is in meters.

        Raises:
            InvalidInputError: if fewer than 2 cameras are registered, if a camera of a metric scene
                is so high that the rig must be in another unit, or as `Scene`.
        """
        rig = getattr(rig, "rig", rig)
        require_instance(rig, Rig, "rig")
        centers = np.asarray(rig.centers)[rig.registered]
        if len(centers) < 2:
            raise InvalidInputError(
                f"The extent of a scene needs at least 2 registered cameras, got {len(centers)}. "
                "Pass extent= to Scene instead."
            )
        with np.errstate(over="ignore"):  # an infinite extent is refused
            extent = 2 * np.median(np.linalg.norm(centers - centers.mean(0), axis=-1))
        return require_plausible_heights(cls(rig, ground, extent, metric))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write to one `.npz` file (no pickle).

        Raises:
            InvalidInputError: if the folder does not exist.
            WriteError: if the disk is full or not writable.
        """
        save_arrays(
            path,
            "Scene",
            {f"rig_{name}": value for name, value in vars(self.rig).items()}
            | {"normal": self.ground.normal, "offset": self.ground.offset}
            | {"extent": self.extent, "metric": self.metric, "deviation": self.rig_sd}
            | {"georeference": None if self.georeference is None else self.georeference.to_array()},
        )

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "Scene":
        """Read what `save` wrote.

        Raises:
            InvalidInputError: if there is no such file, or a value in it is invalid.
            FileFormatError: if the file holds something else.
        """
        required, optional = ([f"rig_{name}" for name in names] for names in arguments_of(Rig))
        required += ["normal", "offset", "extent", "metric"]
        optional += ["georeference", "deviation"]
        arrays = load_arrays(path, "Scene", required=required, optional=optional)
        of_rig = {k.removeprefix("rig_"): v for k, v in arrays.items() if k.startswith("rig_")}
        with naming_file(path):
            metric = as_flag(arrays["metric"], "metric")
            ground = Plane(arrays["normal"], arrays["offset"])
            earth = arrays.get("georeference")
            earth = None if earth is None else GeoReference.of_array(earth)
            sd = arrays.get("deviation")
            scene = cls(Rig(**of_rig), ground, arrays["extent"], metric, earth, sd)
            return require_plausible_heights(scene)


def metric_scene(rig: Rig) -> Scene:
    """Make the scene of a rig in meters, z up, above the ground z = 0."""
    return Scene.from_rig(rig, Plane(np.array([0.0, 0.0, 1.0]), 0.0), metric=True)


def require_scene(scene: Any) -> None:
    """Raise unless this is a scene.

    Raises:
        InvalidInputError: saying how to make a scene from the argument.
    """
    if isinstance(getattr(scene, "rig", scene), Rig) and not isinstance(scene, Scene):
        raise InvalidInputError(
            f"scene must be a Scene, got {type(scene).__name__}: make one with "
            "cf.Scene.from_rig(rig, ground), where z = 0 is cf.Plane([0, 0, 1], 0)."
        )
    require_instance(scene, Scene, "scene")


def require_plausible_heights(scene: Scene) -> Scene:
    """Return the scene; raise if it claims meters but a camera is too high to show people.

    Use this for scenes from outside; within the library, scenes may be scaled at will.

    Raises:
        InvalidInputError: naming the highest camera.
    """
    rig, ground = scene.rig, scene.ground
    if not scene.metric or is_traced(rig.R, rig.t, ground.normal, ground.offset):
        return scene
    height = np.asarray(ground.signed_distance(np.asarray(rig.centers)))
    height = np.where(rig.registered, height, 0.0)
    if height.max(initial=0.0) < HIGHEST_CAMERA:
        return scene
    at = int(height.argmax())
    raise InvalidInputError(
        f"Camera {at} is {height[at]:.5g} m above the ground, but cameras that show people are "
        f"below {HIGHEST_CAMERA:g} m. If the rig is in millimeters or centimeters, divide t by "
        "1000 or 100 (the readers of calibration files have metres_per_unit); if its units are "
        "not known, pass metric=False."
    )


class Rays(eqx.Module):
    """One ray per detection, from the camera center through the bottom center of the box.

    Attributes:
        origin: (N, 3) camera centers in scene units.
        direction: (N, 3) unit vectors in the world frame.
        weight: (N,) reliability w in (0, 1] (Eq. w); 0 marks an absent ray.
    """

    origin: Float[HostOrDevice, "*n 3"]
    direction: Float[HostOrDevice, "*n 3"]
    weight: Float[HostOrDevice, "*n"]
