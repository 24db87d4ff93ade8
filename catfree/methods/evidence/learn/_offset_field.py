"""Learn smooth offsets of the edges of boxes, of all cameras together: a small bundle adjustment.

A camera that is a little off shows everybody a little off, and so the others seem to be off, too:
the offsets of one camera depend on those of all others. The people, who may move, are eliminated
from the normal equations; what is left has a few unknowns per camera.
"""

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import block_diag

# The middle of a box has coefficients of focal length, column and row of its own. Those of its ends
# are the same, as for an error of the pose; the shares of the box height differ.
MIDDLE, ENDS, TOP, BOTTOM = slice(0, 3), slice(3, 6), 6, 7
UNKNOWNS = 8  # coefficients of a camera
NOWHERE = 1e-6  # inverse variance, per H0², of a position of which nothing is known


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
    """Fit the offsets of all cameras' edges, while every person may move.

    Args:
        person: (n,) whom each box shows.
        camera: (n,) which camera it is from.
        offset: (n, 3) observed minus predicted edges in pixels.
        slopes: (n, 3, 3) derivatives of the predicted edges by the person's position and height.
        features: (n, 3, 4) of `field_features`.
        weight: (n, 3) inverse variances of the edges, 0 for unused ones.
        height: (P,) height of each person for which the edges are predicted.
        spread: standard deviation of heights, whose mean is 1.
        prior: standard deviations of the four kinds of coefficients.
        cameras: number of cameras.

    Returns:
        (C, 3, 4) coefficients; those of the ends of a box differ only in the last, and a camera
        without boxes has none.
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
