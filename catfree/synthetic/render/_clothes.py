"""Clothes of rendered people: the color of every body part, and bags."""

import numpy as np
from jaxtyping import Bool, Float

from catfree.synthetic.render._bodies import (
    BAG,
    FOREARM_PART,
    HAIR,
    SHANK_PART,
    SHIRT,
    SHOES,
    SKIN,
    SLEEVE,
    TROUSERS,
)

# Blue, green, red in [0, 1].
_SHIRTS = np.array(
    [
        (0.2, 0.2, 0.75),
        (0.65, 0.3, 0.15),
        (0.25, 0.55, 0.2),
        (0.9, 0.9, 0.88),
        (0.15, 0.6, 0.85),
        (0.18, 0.18, 0.2),
        (0.5, 0.25, 0.5),
        (0.65, 0.6, 0.2),
        (0.45, 0.5, 0.52),
        (0.2, 0.42, 0.9),
        (0.6, 0.5, 0.85),
        (0.28, 0.36, 0.5),
        (0.78, 0.7, 0.5),
    ]
)
_TROUSERS = np.array(
    [
        (0.42, 0.28, 0.18),
        (0.16, 0.15, 0.15),
        (0.4, 0.5, 0.6),
        (0.55, 0.42, 0.32),
        (0.3, 0.32, 0.33),
        (0.2, 0.28, 0.36),
        (0.7, 0.75, 0.78),
    ]
)
_SKINS = np.array([(0.6, 0.7, 0.92), (0.5, 0.62, 0.85), (0.36, 0.5, 0.72), (0.2, 0.28, 0.42)])
_HAIRS = np.array(
    [(0.06, 0.08, 0.1), (0.1, 0.16, 0.26), (0.3, 0.5, 0.68), (0.62, 0.64, 0.66), (0.1, 0.2, 0.45)]
)
_SHOES = np.array([(0.1, 0.1, 0.1), (0.8, 0.8, 0.8), (0.14, 0.2, 0.3), (0.25, 0.2, 0.55)])


def dress(people: int, seed: int) -> tuple[Float[np.ndarray, "p part 3"], Bool[np.ndarray, " p"]]:
    """Draw the clothes of each person.

    Args:
        people: number of people P.
        seed: determines all random draws.

    Returns:
        (P, parts, 3) colors in BGR, indexed by the parts of `_bodies`, and (P,) whether the person
        has a bag.
        Neighboring identities get different shirts until the palette is used up.
    """
    rng = np.random.default_rng([seed, 11])

    def choose(palette: np.ndarray) -> np.ndarray:
        order = [rng.permutation(len(palette)) for _ in range(people // len(palette) + 1)]
        color = palette[np.concatenate(order)[:people]]
        return np.clip(color * rng.uniform(0.85, 1.15, (people, 1)), 0, 1)

    colors = np.zeros((people, 9, 3))
    shirt, trousers, skin = choose(_SHIRTS), choose(_TROUSERS), choose(_SKINS)
    warm = rng.uniform(size=people)
    colors[:, SHIRT] = colors[:, SLEEVE] = shirt
    colors[:, FOREARM_PART] = np.where((warm < 0.5)[:, None], skin, shirt)
    colors[:, TROUSERS] = trousers
    colors[:, SHANK_PART] = np.where((warm < 0.2)[:, None], skin, trousers)
    colors[:, SHOES] = choose(_SHOES)
    colors[:, SKIN] = skin
    colors[:, HAIR] = choose(_HAIRS)
    colors[:, BAG] = 0.8 * choose(_SHIRTS)
    return colors, rng.uniform(size=people) < 0.35
