"""Compare robust triangulation with named peers: `python benchmarks/triangulation.py`.

Peers: pycolmap's `estimate_triangulation` (LO-RANSAC on angular errors) and a loop over SciPy's
    `least_squares` with a Huber loss. All methods see the same hypotheses: rays from cameras on a
    ring to one person, with angular noise and, in a share of them, one wrong ray. pycolmap
    minimizes angular errors and so gives near cameras more weight; catfree and SciPy get the same
    information as the weights of the paper's Eq. w, from the heights of the boxes.
"""

import argparse
import time
from collections.abc import Callable

import jax
import numpy as np
from scipy.optimize import least_squares

import catfree as cf

SIGMA_THETA = 0.0206


def make_problems(
    count: int, cameras: int, wrong_share: float, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Make (H, C, 3) origins and noisy directions, (H, C) weights, and (H, 3) true positions."""
    rng = np.random.default_rng(seed)
    angle = 2 * np.pi * np.arange(cameras) / cameras
    ring = np.stack([11 * np.cos(angle), 11 * np.sin(angle), np.full(cameras, 3.0)], axis=-1)
    person = np.concatenate([rng.uniform(-6, 6, (count, 2)), np.zeros((count, 1))], axis=-1)
    other = np.concatenate([rng.uniform(-6, 6, (count, 2)), np.zeros((count, 1))], axis=-1)
    target = np.repeat(person[:, None], cameras, axis=1)
    wrong = np.flatnonzero(rng.random(count) < wrong_share)
    target[wrong, rng.integers(cameras, size=len(wrong))] = other[wrong]
    direction = target - ring
    height = 1 / np.linalg.norm(direction, axis=-1)  # height of a box, up to a factor
    weight = np.minimum(1, (height / np.median(height)) ** 2)
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    noise = rng.normal(scale=SIGMA_THETA, size=direction.shape)
    noise -= (noise * direction).sum(-1, keepdims=True) * direction
    direction = direction + noise
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    return np.broadcast_to(ring, direction.shape).copy(), direction, weight, person


def best_time(run: Callable[[], np.ndarray], seconds: float) -> tuple[float, np.ndarray]:
    """Return the shortest of the runs within a time limit, in seconds, and the result.

    All methods get the same time, and hence the same chance of moments without other load.
    """
    result, taken = run(), []
    while sum(taken) < seconds:
        start = time.perf_counter()
        result = run()
        taken.append(time.perf_counter() - start)
    return min(taken), result


def with_catfree(
    origins: np.ndarray, directions: np.ndarray, weights: np.ndarray
) -> Callable[[], np.ndarray]:
    """Triangulate all hypotheses in one compiled call."""
    solve = jax.jit(jax.vmap(cf.geometry.triangulate, (0, 0, 0, None)))
    arrays = [a.astype(np.float32) for a in (origins, directions, weights)]
    return lambda: np.asarray(solve(*arrays, 0.22).position)


def with_scipy(
    origins: np.ndarray, directions: np.ndarray, weights: np.ndarray
) -> Callable[[], np.ndarray]:
    """Triangulate with one `least_squares` call per hypothesis, with Huber's loss."""

    def residual(x: np.ndarray, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        offset = x - o
        across = offset - (offset * d).sum(-1, keepdims=True) * d
        return np.linalg.norm(across, axis=-1)

    def huber(weight: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        def loss(squared: np.ndarray) -> np.ndarray:
            root = np.sqrt(np.maximum(squared, 1e-30))
            near = squared <= 1
            return weight * np.array(
                [
                    np.where(near, squared, 2 * root - 1),
                    np.where(near, 1, 1 / root),
                    np.where(near, 0, -0.5 / root**3),
                ]
            )

        return loss

    def run() -> np.ndarray:
        return np.array(
            [
                least_squares(residual, np.zeros(3), loss=huber(w), f_scale=0.22, args=(o, d)).x
                for o, d, w in zip(origins, directions, weights, strict=True)
            ]
        )

    return run


def with_pycolmap(origins: np.ndarray, directions: np.ndarray) -> Callable[[], np.ndarray]:
    """Triangulate with one `estimate_triangulation` call per hypothesis."""
    import pycolmap

    cameras = origins.shape[1]
    camera = pycolmap.Camera(
        model="PINHOLE", width=2000, height=2000, params=[1000, 1000, 1000, 1000]
    )
    to_middle = -origins[0].copy()
    poses = []
    for offset, origin in zip(to_middle, origins[0], strict=True):
        forward = offset / np.linalg.norm(offset)
        right = np.cross(forward, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward])
        poses.append(pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), -rotation @ origin))
    rotations = np.stack([pose.rotation.matrix() for pose in poses])
    local = np.einsum("cij,hcj->hci", rotations, directions)
    pixels = 1000 + 1000 * local[..., :2] / local[..., 2:]
    options = pycolmap.EstimateTriangulationOptions()
    options.ransac.max_error = 3 * SIGMA_THETA
    options.ransac.random_seed = 0

    def run() -> np.ndarray:
        found = [
            pycolmap.estimate_triangulation(p, poses, [camera] * cameras, options) for p in pixels
        ]
        return np.array([np.full(3, np.nan) if f is None else f["xyz"] for f in found])

    return run


def main() -> None:
    """Print time per hypothesis, error on the ground, and ratios."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hypotheses", type=int, default=16384)
    parser.add_argument("--cameras", type=int, default=6)
    parser.add_argument("--wrong-share", type=float, default=0.2)
    parser.add_argument("--seconds", type=float, default=2.0, help="of running each method")
    options = parser.parse_args()
    origins, directions, weights, truth = make_problems(
        options.hypotheses, options.cameras, options.wrong_share, seed=0
    )
    few = slice(0, min(300, options.hypotheses))  # enough to time SciPy
    runs = {
        "catfree": (best_time(with_catfree(origins, directions, weights), options.seconds), truth),
        "SciPy least_squares": (
            best_time(with_scipy(origins[few], directions[few], weights[few]), 0.1),
            truth[few],
        ),
    }
    try:
        runs["pycolmap LO-RANSAC"] = (
            best_time(with_pycolmap(origins, directions), options.seconds),
            truth,
        )
    except ImportError:
        print("pycolmap is not installed (pip install 'catfree[benchmark]'): skipped")
    ours = runs["catfree"][0][0] / options.hypotheses
    print(
        f"{options.hypotheses} hypotheses, {options.cameras} cameras, "
        f"{100 * options.wrong_share:.0f} % with one wrong ray"
    )
    header = ("us/hypothesis", "ratio", "median m", "p90 m", "failed", "of", "catfree m")
    print(f"{'method':22s} {header[0]:>14s} " + " ".join(f"{title:>9s}" for title in header[1:]))
    own = np.linalg.norm((runs["catfree"][0][1] - truth)[:, :2], axis=-1)
    for name, ((seconds, found), true) in runs.items():
        each = seconds / len(true)
        error = np.linalg.norm((found - true)[:, :2], axis=-1)
        missing = np.isnan(error)
        print(
            f"{name:22s} {1e6 * each:14.2f} {each / ours:9.1f} {np.nanmedian(error):9.4f} "
            f"{np.nanpercentile(error, 90):9.4f} {missing.sum():9d} {len(true):9d} "
            f"{np.median(own[: len(true)]):9.4f}"
        )


if __name__ == "__main__":
    main()
