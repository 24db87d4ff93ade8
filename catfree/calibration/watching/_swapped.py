"""Find cameras whose boxes fit the place of another camera: their videos or names were swapped."""

import numpy as np
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment

from catfree.calibration.watching._matching import match_boxes
from catfree.calibration.watching._sights import PARAMETERS, Sights, with_cameras

SHARE = 0.5  # of what the best camera matches: the wrong place reaches less, the right one more
FEWEST_EXPECTED = 20  # people in all frames, whom a camera should show to be judged


def swapped_cameras(sights: Sights, matched: Float[np.ndarray, " cam"]) -> dict[int, int]:
    """Find the camera in whose place the boxes of a camera meet most people.

    The boxes of each suspect are compared with the people whom two other cameras see, once in the
    place and through the lens of every other suspect.

    Args:
        sights: the recording.
        matched: (C,) share of the people whom the boxes of each camera meet in its own place, NaN
            if it should show nobody; those that meet few are suspects.

    Returns:
        Suspects that were found, each with the camera whose place its boxes fit.
    """
    least = SHARE * float(np.nan_to_num(matched).max(initial=0.0))
    suspects, trusted = np.flatnonzero(matched < least), np.flatnonzero(matched >= least)
    people, count = sights.people, len(suspects)
    person = np.flatnonzero(people.seen[:, trusted].sum(-1) >= 2)
    share = np.zeros((count, count))
    for turn in range(1, count):
        home = np.arange(len(sights.place))
        home[suspects] = np.roll(suspects, -turn)
        tried = with_cameras(sights, home[sights.detections.camera])
        right, state = np.zeros((count, PARAMETERS)), people.state[person]
        for i, one in enumerate(match_boxes(tried, person, state, home[suspects], right)):
            if len(one.expected) >= FEWEST_EXPECTED:
                share[i, (i + turn) % count] = len(one.person) / len(one.expected)
    rows, columns = linear_sum_assignment(-share)
    found = share[rows, columns] > least
    return dict(zip(suspects[rows[found]].tolist(), suspects[columns[found]].tolist(), strict=True))
