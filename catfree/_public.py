"""The public names of `catfree` besides its packages; read, but not run until one is used."""

from catfree._coverage import (
    Coverage as Coverage,
    CoverageOptions as CoverageOptions,
    camera_gain as camera_gain,
    coverage as coverage,
    rank_cameras as rank_cameras,
)
from catfree._run._result_folder import (
    read_results as read_results,
    write_results as write_results,
)
from catfree._run._run import RunOutcome as RunOutcome, run as run, run_stages as run_stages
from catfree._run.sharded._executors import run_shards as run_shards
from catfree._run.sharded._join import join as join
from catfree._run.sharded._receipt import Receipt as Receipt
from catfree._run.sharded._run_shard import run_shard as run_shard
from catfree._run.sharded._shard import Shard as Shard, shards as shards
from catfree._run.sharded._sites import (
    Site as Site,
    read_sites as read_sites,
    run_sites as run_sites,
)
from catfree._run.sharded._stored_tracks import (
    StoredTracks as StoredTracks,
    open_tracks as open_tracks,
)
from catfree._worker import worker_environment as worker_environment
from catfree.adapters.datasets._detection_files import read_detections as read_detections
from catfree.adapters.datasets._scene_files import read_scene as read_scene
from catfree.calibration import (
    AnchorCheck as AnchorCheck,
    Calibration as Calibration,
    CameraCheck as CameraCheck,
    Check as Check,
    ClockJump as ClockJump,
    Clocks as Clocks,
    KnownCamera as KnownCamera,
    KnownDistance as KnownDistance,
    Refinement as Refinement,
    SurveyedPoint as SurveyedPoint,
    Verdict as Verdict,
    calibrate as calibrate,
    check as check,
    estimate_clocks as estimate_clocks,
    read_anchors as read_anchors,
    refine as refine,
)
from catfree.errors import CatFreeError as CatFreeError
from catfree.geometry.camera import rig_from_rays as rig_from_rays
from catfree.methods import localize as localize
from catfree.methods.online import (
    DroppedFrame as DroppedFrame,
    Event as Event,
    Instant as Instant,
    InstantAssembler as InstantAssembler,
    Tracker as Tracker,
    TrackerState as TrackerState,
    Update as Update,
    watch as watch,
)
from catfree.settings import Settings as Settings
from catfree.types import (
    Candidates as Candidates,
    Clock as Clock,
    Detections as Detections,
    Fate as Fate,
    GeoReference as GeoReference,
    Lens as Lens,
    Localization as Localization,
    Origin as Origin,
    Plane as Plane,
    Rays as Rays,
    Rig as Rig,
    Scene as Scene,
    Tracks as Tracks,
)
