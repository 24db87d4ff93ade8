"""Results: tracks, the localization that they are part of, and reconstructions."""

from catfree.types.results._arrow_table import (
    MOST_CAMERAS as MOST_CAMERAS,
    require_pyarrow as require_pyarrow,
    symmetric as symmetric,
)
from catfree.types.results._localization import (
    Candidates as Candidates,
    Fate as Fate,
    Localization as Localization,
    Reliability as Reliability,
    Thresholds as Thresholds,
    require_sound_localization as require_sound_localization,
)
from catfree.types.results._tracks import (
    Origin as Origin,
    Tracks as Tracks,
    require_sound_tracks as require_sound_tracks,
    supporting_boxes as supporting_boxes,
)
