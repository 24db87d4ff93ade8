"""Detection of swapped cameras, whose boxes fit the place of another camera."""

import numpy as np
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment

from catfree.calibration.watching._matching import match_boxes
from catfree.calibration.watching._sights import PARAMETERS, Sights, with_cameras

SHARE = 0.5  # of the best camera's share of matches; a wrong place has less, the right one more
FEWEST_EXPECTED = 20  # least number of expected people, over all frames, to judge a camera


def swapped_cameras(sights: Sights, matched: Float[np.ndarray, " cam"]) -> dict[int, int]:
    """Find, for each suspect camera, the camera in whose place its boxes match most people.

    The boxes of each suspect are compared with the people seen by two other cameras, in the place
    and through the lens of every other suspect.

    Args:
        sights: the recording.
        matched: (C,) share of people that each camera's boxes match in its own place, NaN if it
            should show nobody; cameras that match few are suspects.

    Returns:
        The swapped suspects, each with the camera whose place its boxes fit.
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
