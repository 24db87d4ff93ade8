"""Colors that color-blind readers can tell apart, the same for an identity in every picture."""

import numpy as np

from catfree.types import Fate

Color = tuple[int, int, int]

# Six of the hues of Okabe and Ito ("Color universal design", 2008), without black (used for other
# marks) and yellow (invisible on white), then a dark version of each: twelve colors, red, green and
# blue in 0..255.
_HUES: tuple[Color, ...] = (
    (0, 114, 178),
    (213, 94, 0),
    (0, 158, 115),
    (204, 121, 167),
    (230, 159, 0),
    (86, 180, 233),
)
TRACK_COLORS: tuple[Color, ...] = (
    *_HUES,
    *((r * 11 // 20, g * 11 // 20, b * 11 // 20) for r, g, b in _HUES),
)
LINE_STYLES = ("-", "--", ":")  # combined with the colors, they repeat after 36 tracks
UNTRACKED: Color = (120, 120, 120)
CAMERA_COLOR: Color = (40, 40, 40)
TRUTH_COLOR: Color = (0, 0, 0)

# Green and blue for kept candidates, other colors for removed ones.
FATE_COLORS: dict[Fate, Color] = {
    Fate.ACCEPTED: (0, 158, 115),
    Fate.RECOVERED: (0, 114, 178),
    Fate.SUPPRESSED: (86, 180, 233),
    Fate.TEMPORAL_FILTER: (204, 121, 167),
    Fate.SUPPORT_FILTER: (120, 60, 130),
    Fate.EXISTENCE: (140, 100, 40),
    Fate.TRACKING: (90, 90, 90),
    Fate.WORKING_AREA: (150, 150, 60),
    Fate.GROUND_FILTER: (230, 159, 0),
    Fate.UNCERTAINTY_FILTER: (213, 94, 0),
    Fate.RMS_GATE: (190, 190, 190),
}


def track_color(track_id: int | np.integer) -> Color:
    """Return the color of an identity, the same in every picture, in 0..255; gray for -1."""
    return UNTRACKED if track_id < 0 else TRACK_COLORS[int(track_id) % len(TRACK_COLORS)]


def line_style(track_id: int | np.integer) -> str:
    """Return an identity's matplotlib line style, to tell apart tracks of the same color."""
    return LINE_STYLES[max(int(track_id), 0) // len(TRACK_COLORS) % len(LINE_STYLES)]


def fraction(color: Color) -> tuple[float, float, float]:
    """Convert a color to matplotlib's range 0..1."""
    return color[0] / 255, color[1] / 255, color[2] / 255
