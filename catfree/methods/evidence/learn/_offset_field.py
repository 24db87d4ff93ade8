"""Learn smooth offsets of box edges for all cameras jointly: a small bundle adjustment.

A slightly wrong camera displaces everybody slightly, so that the other cameras seem wrong, too: the
offsets of one camera depend on those of all others. The positions of the people are eliminated from
the normal equations, which leaves a few unknowns per camera.
"""

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import block_diag

# The center column of a box has its own coefficients of focal length, column and row. Top and
# bottom share theirs, as for an error of the pose, but have different shares of the box height.
MIDDLE, ENDS, TOP, BOTTOM = slice(0, 3), slice(3, 6), 6, 7
UNKNOWNS = 8  # coefficients of a camera
NOWHERE = 1e-6  # inverse variance, per H0², of an unknown position


def offset_field(
    person: Int[np.ndarray, " n"],
    camera: Int[np.ndarray, " n"],
    offset: Float[np.ndarray, "n 3"],
    slopes: Float[np.ndarray, "n 3 3"],
    features: Float[np.ndarray, "n 3 4"],
    weight: Float[np.ndarray, "n 3"],
    height: Float[np.ndarray, " person"],
    *,
    spread: float,
    prior: tuple[float, float, float, float],
    cameras: int,
) -> Float[np.ndarray, "{cameras} 3 4"]:
    """Fit the offsets of all cameras' edges jointly with the people's positions.

    Args:
        person: (n,) person in each box.
        camera: (n,) camera of each box.
        offset: (n, 3) observed minus predicted edges in pixels.
        slopes: (n, 3, 3) derivatives of the predicted edges by the person's position and height.
        features: (n, 3, 4) of `field_features`.
        weight: (n, 3) inverse variances of the edges, 0 for unused ones.
        height: (P,) height of each person at which the edges were predicted.
        spread: standard deviation of heights, whose mean is 1.
        prior: standard deviations of the four kinds of coefficients.
        cameras: number of cameras.

    Returns:
        (C, 3, 4) coefficients; top and bottom differ only in the last, and those of a camera
        without boxes are 0.
    """
    people, size = len(height), cameras * UNKNOWNS
    columns = np.zeros((len(person), 3, UNKNOWNS))
    columns[:, 0, MIDDLE], columns[:, 1:, ENDS] = features[:, 0, :3], features[:, 1:, :3]
    columns[:, 1, TOP], columns[:, 2, BOTTOM] = features[:, 1, 3], features[:, 2, 3]
    own = np.zeros((cameras, UNKNOWNS, UNKNOWNS))
    np.add.at(own, camera, np.einsum("nk,nks,nkt->nst", weight, columns, columns))
    pull = np.zeros((cameras, UNKNOWNS))
    np.add.at(pull, camera, np.einsum("nk,nks,nk->ns", weight, columns, offset))
    places = np.tile(np.diag([NOWHERE, NOWHERE, spread**-2.0]), (people, 1, 1))
    np.add.at(places, person, np.einsum("nk,nki,nkj->nij", weight, slopes, slopes))
    moves = np.column_stack([np.zeros((people, 2)), (1 - height) / spread**2])
    np.add.at(moves, person, np.einsum("nk,nki,nk->ni", weight, slopes, offset))
    mixed = np.zeros((people, cameras, UNKNOWNS, 3))
    mixed[person, camera] = np.einsum("nk,nks,nki->nsi", weight, columns, slopes)
    mixed = mixed.reshape(people, size, 3)

    gain = mixed @ np.linalg.inv(places)
    deviation = np.array([*prior[:3], *prior[:3], prior[3], prior[3]])
    normal = np.asarray(block_diag(*own)) + np.diag(np.tile(deviation**-2.0, cameras))
    normal -= np.tensordot(gain, mixed, ((0, 2), (0, 2)))
    found = np.linalg.solve(normal, pull.ravel() - np.einsum("pdi,pi->d", gain, moves))
    found = found.reshape(cameras, UNKNOWNS)
    field = np.zeros((cameras, 3, 4))
    field[:, 0, :3], field[:, 1:, :3] = found[:, MIDDLE], found[:, None, ENDS]
    field[:, 1:, 3] = found[:, [TOP, BOTTOM]]
    return field
