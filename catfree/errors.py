"""Every exception that catfree raises on purpose.

Each message is a sentence that says what was wrong, where (file, camera, frame, index) and what to
do about it. Catch `CatFreeError` to catch them all.
"""


class CatFreeError(Exception):
    """Base class of every error that catfree raises on purpose."""


class InvalidInputError(CatFreeError, ValueError):
    """An argument or a file's content breaks the documented contract."""


class FileFormatError(CatFreeError, ValueError):
    """A file exists but does not hold what its format promises."""


class WriteError(CatFreeError, OSError):
    """A file cannot be written: the disk is full, or the folder not writable."""


class InsufficientDataError(CatFreeError):
    """A stage has too little to work with: cameras, detections, frames or shared people."""


class GroundRejectedError(CatFreeError):
    """No plane found in the scene can be the ground that people walk on."""


class CalibrationError(CatFreeError):
    """No camera rig could be recovered that the evidence supports."""


class DegenerateGeometryError(CatFreeError, ValueError):
    """Points or rays are in a position that leaves the answer undetermined."""


class ForkedProcessError(CatFreeError, RuntimeError):
    """A forked process would wait forever; the message says how to start one that does not."""


class MissingDependencyError(CatFreeError, ImportError):
    """An optional dependency is not installed; the message holds the pip command."""
