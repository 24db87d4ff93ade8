"""Camera calibrations in the formats of other tools."""

from catfree.adapters.calibration_files._ai_city import (
    read_ai_city as read_ai_city,
    write_ai_city as write_ai_city,
)
from catfree.adapters.calibration_files._anipose_toml import (
    read_anipose_toml as read_anipose_toml,
    write_anipose_toml as write_anipose_toml,
)
from catfree.adapters.calibration_files._named_rig import (
    NamedRig as NamedRig,
)
from catfree.adapters.calibration_files._opencv_yaml import (
    read_opencv_yaml as read_opencv_yaml,
    write_opencv_yaml as write_opencv_yaml,
)
from catfree.adapters.calibration_files._projection_matrices import (
    read_mv3dt as read_mv3dt,
    write_mv3dt as write_mv3dt,
)
from catfree.adapters.calibration_files._rig_json import (
    read_rig_json as read_rig_json,
    read_scene_json as read_scene_json,
    write_rig_json as write_rig_json,
    write_scene_json as write_scene_json,
)
from catfree.adapters.calibration_files.colmap import (
    read_colmap as read_colmap,
    write_colmap_text as write_colmap_text,
)
