"""Robust normal equations of cameras and people, with the people eliminated (Schur complement).

People are coupled only through the cameras, so each person is eliminated as a 3x3 block, leaving a
system of seven parameters per camera.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from catfree.calibration.people.adjustment._box_measurements import (
    BoxMeasurements,
    KnownCameras,
    Linearized,
)
from catfree.calibration.people.cameras._camera_model import (
    LOG_FOCAL,
    PAN,
    ROLL,
    TILT,
    Z,
    box_jacobian,
)
from catfree.settings import CalibrationSettings

CAUCHY = 2.0  # standard deviations at which the weight of a residual is 1/2
SMALL_PRODUCT = 2**18  # multiplications below which BLAS libraries use one thread


class NormalEquations:
    """The normal equations of one adjustment.

    Args:
        measurements: the boxes.
        camera_count: number C of cameras, including those without boxes.
        person_count: number P of people.
        log_focal_prior: (C,) mean of the weak prior on log focal length.
        settings: constants.
        shared_focal: whether all cameras have one focal length.
        known: prior on the cameras; if None, heading and position of one camera are fixed.

    Attributes:
        used: (C,) cameras that have boxes.
        rows: measurement rows per camera.
    """

    used: Bool[np.ndarray, " cam"]
    rows: list[Int[np.ndarray, " row"]]

    def __init__(
        self,
        measurements: BoxMeasurements,
        camera_count: int,
        person_count: int,
        log_focal_prior: Float[np.ndarray, " cam"],
        settings: CalibrationSettings,
        shared_focal: bool,
        known: KnownCameras | None,
    ) -> None:
        self.data, self.settings, self.prior = measurements, settings, log_focal_prior
        self.people, self.cameras, self.shared = person_count, camera_count, shared_focal
        self.used = np.bincount(measurements.camera, minlength=camera_count) > 0
        self.rows = [np.flatnonzero(measurements.camera == c) for c in range(camera_count)]
        self.starts = np.searchsorted(measurements.person, np.arange(person_count))
        free = np.repeat(self.used, 7)
        if known is None:
            anchor = int(np.argmax(np.bincount(measurements.camera, minlength=camera_count)))
            free[7 * anchor + PAN : 7 * anchor + Z] = False
            known = KnownCameras(np.zeros((camera_count, 7)), np.zeros(7))
        self.known = known
        self.free = np.append(free, False)

    def linearize(
        self,
        parameters: Float[np.ndarray, "cam 7"],
        offset: float,
        xy: Float[np.ndarray, "person 2"],
        height: Float[np.ndarray, " person"],
    ) -> Linearized:
        """Compute residuals, weights and derivatives at a state.

        Args:
            parameters: (C, 7) cameras.
            offset: foot offset in meters.
            xy: (P, 2) people in meters.
            height: (P,) their heights in meters.
        """
        data, s = self.data, self.settings
        box, by_camera, by_person, by_offset = box_jacobian(
            parameters[data.camera], xy[data.person], height[data.person], offset
        )
        residual = (data.box - box) / data.sd
        scaled = residual / CAUCHY
        cost = CAUCHY**2 * float(np.log1p(scaled**2).sum())
        cost += float((((height - s.apparent_height) / s.person_height_sd) ** 2).sum())
        cost += ((offset - s.foot_offset) / s.foot_offset_sd) ** 2
        active = parameters[self.used]
        log_focal = active[:, LOG_FOCAL]
        cost += float((((log_focal - self.prior[self.used]) / s.focal_log_sd) ** 2).sum())
        cost += float(((active[:, ROLL] / s.roll_sd) ** 2).sum())
        cost += float((self._deviation_from_prior(parameters) ** 2 * self.known.precision).sum())
        if self.shared:
            cost += float((((log_focal - log_focal.mean()) / s.shared_focal_sd) ** 2).sum())
        common = np.concatenate([by_camera, by_offset[..., None]], -1) / data.sd[..., None]
        return Linearized(
            residual, 1 / (1 + scaled**2), common, by_person / data.sd[..., None], cost
        )

    def _deviation_from_prior(
        self, parameters: Float[np.ndarray, "cam 7"]
    ) -> Float[np.ndarray, "cam 7"]:
        """(C, 7) deviation of the used cameras from the mean of their prior."""
        away = parameters - self.known.parameters
        away[:, ROLL : PAN + 1] = (away[:, ROLL : PAN + 1] + np.pi) % (2 * np.pi) - np.pi
        return np.where(self.used[:, None], away, 0.0)

    def _reduce(
        self,
        linear: Linearized,
        parameters: Float[np.ndarray, "cam 7"],
        offset: float,
        height: Float[np.ndarray, " person"],
        damping: float,
    ) -> tuple[
        Float[np.ndarray, "common common"],
        Float[np.ndarray, " common"],
        Float[np.ndarray, "person 3 common"],
        Float[np.ndarray, "person 3 3"],
        Float[np.ndarray, "person 3"],
    ]:
        """Reduced normal equations of the cameras, and the terms that recover the people."""
        s, data = self.settings, self.data
        size = 7 * self.cameras + 1
        root = np.sqrt(linear.weight)[..., None]
        common, person = linear.by_common * root, linear.by_person * root
        residual = linear.residual[..., None] * root
        U, g = np.zeros((size, size)), np.zeros(size)
        for camera, rows in enumerate(self.rows):
            if not len(rows):
                continue
            index = np.append(np.arange(7 * camera, 7 * camera + 7), size - 1)
            block = common[rows].reshape(-1, 8)
            U[np.ix_(index, index)] += _gram(block, block)
            g[index] += block.T @ residual[rows].reshape(-1)
            at = 7 * camera + LOG_FOCAL
            U[at, at] += s.focal_log_sd**-2
            g[at] -= (parameters[camera, LOG_FOCAL] - self.prior[camera]) * s.focal_log_sd**-2
            at = 7 * camera + ROLL
            U[at, at] += s.roll_sd**-2
            g[at] -= parameters[camera, ROLL] * s.roll_sd**-2
        if self.shared:
            at = 7 * np.flatnonzero(self.used) + LOG_FOCAL
            log_focal = parameters[self.used, LOG_FOCAL]
            pull = (np.eye(len(at)) - 1 / len(at)) * s.shared_focal_sd**-2
            U[np.ix_(at, at)] += pull
            g[at] -= pull @ log_focal
        precision = self.used[:, None] * self.known.precision
        diagonal = np.arange(size - 1)
        U[diagonal, diagonal] += precision.ravel()
        g[:-1] -= (self._deviation_from_prior(parameters) * precision).ravel()
        U[-1, -1] += s.foot_offset_sd**-2
        g[-1] -= (offset - s.foot_offset) * s.foot_offset_sd**-2
        turned = np.swapaxes(person, 1, 2)
        V = np.add.reduceat(turned @ person, self.starts)
        b = np.add.reduceat((turned @ residual)[..., 0], self.starts)
        V[:, 2, 2] += s.person_height_sd**-2
        b[:, 2] -= (height - s.apparent_height) * s.person_height_sd**-2
        diagonal = np.arange(3)
        V[:, diagonal, diagonal] *= 1 + damping
        V[:, diagonal, diagonal] += 1e-6
        E = np.zeros((self.people, 3, size))
        mixed = turned @ common
        columns = 7 * data.camera[:, None] + np.arange(7)
        E[data.person[:, None, None], np.arange(3)[:, None], columns[:, None]] = mixed[..., :7]
        E[..., -1] = np.add.reduceat(mixed[..., 7], self.starts)
        inverse = np.linalg.inv(V)
        VE = (inverse @ E).reshape(-1, size)  # V is symmetric
        diagonal = np.arange(size)
        U[diagonal, diagonal] *= 1 + damping
        S = U - _gram(VE, E.reshape(-1, size))
        r = g - VE.T @ b.reshape(-1)
        return S, r, E, inverse, b

    def step(
        self,
        linear: Linearized,
        parameters: Float[np.ndarray, "cam 7"],
        offset: float,
        xy: Float[np.ndarray, "person 2"],
        height: Float[np.ndarray, " person"],
        damping: float,
    ) -> (
        tuple[
            Float[np.ndarray, "cam 7"],
            float,
            Float[np.ndarray, "person 2"],
            Float[np.ndarray, " person"],
        ]
        | None
    ):
        """Take one damped step; None if the step is not usable.

        Args:
            linear: the boxes linearized at the state.
            parameters: (C, 7) cameras.
            offset: foot offset in meters.
            xy: (P, 2) people in meters.
            height: (P,) their heights in meters.
            damping: relative increase of the diagonal.

        Returns:
            Cameras, foot offset, people and their heights, with unchanged shapes.
        """
        S, r, E, inverse, b = self._reduce(linear, parameters, offset, height, damping)
        free = self.free
        common = np.zeros(len(free))
        try:
            common[free] = np.linalg.solve(S[np.ix_(free, free)], r[free])
        except np.linalg.LinAlgError:
            return None
        people = np.einsum("pij,pj->pi", inverse, b - E @ common)
        moved = parameters + common[:-1].reshape(-1, 7)
        active = moved[self.used]
        outside = (np.abs(active[:, TILT]) > 1.5) | (active[:, Z] < 0.3) | (active[:, Z] > 80)
        if outside.any() or not np.isfinite(common).all():
            return None
        people[:, :2] = np.clip(people[:, :2], -10, 10)
        return (
            moved,
            float(np.clip(offset + common[-1], 0.0, 0.6)),
            xy + people[:, :2],
            np.clip(height + people[:, 2], 1.0, 2.4),
        )

    def covariance(
        self,
        linear: Linearized,
        parameters: Float[np.ndarray, "cam 7"],
        offset: float,
        xy: Float[np.ndarray, "person 2"],
        height: Float[np.ndarray, " person"],
    ) -> Float[np.ndarray, "common common"]:
        """Covariance of the free parameters, including the effect of the uncertain foot offset.

        Boxes seem to determine the offset to centimeters, but lens, occlusion and slack bias it by
        more, so it keeps its prior uncertainty (a consider covariance).

        Args:
            linear: the boxes linearized at the state.
            parameters: (C, 7) cameras.
            offset: foot offset in meters.
            xy: (P, 2) people in meters.
            height: (P,) their heights in meters.

        Returns:
            (7C+1, 7C+1) covariance of cameras and foot offset.
        """
        S = self._reduce(linear, parameters, offset, height, 0.0)[0]
        free = self.free
        out = np.zeros_like(S)
        out[np.ix_(free, free)] = np.linalg.pinv(S[np.ix_(free, free)], hermitian=True)
        by_offset = -out @ np.where(free, S[:, -1], 0.0)
        by_offset[-1] = 1.0
        return out + self.settings.foot_offset_sd**2 * np.outer(by_offset, by_offset)


def _gram(
    first: Float[np.ndarray, "n row"], second: Float[np.ndarray, "n column"]
) -> Float[np.ndarray, "row column"]:
    """first.T @ second in blocks, since multithreading slows down such small products."""
    length, (rows, columns) = len(first), (first.shape[1], second.shape[1])
    size = max(1, SMALL_PRODUCT // (rows * columns))
    blocks, whole = length // size, length // size * size
    head = first[:whole].reshape(blocks, size, rows).swapaxes(1, 2)
    product = (head @ second[:whole].reshape(blocks, size, columns)).sum(0)
    return product + first[whole:].T @ second[whole:]
