"""`read_tracks`: tracks from any file or folder that the library writes."""

from catfree.adapters.files._documents import StrPath
from catfree.adapters.tables._tracks_table import read_tracks_csv, read_tracks_parquet
from catfree.errors import InvalidInputError
from catfree.types import Tracks
from catfree.types._validation import as_path

_IN_FOLDER = ("tracks.csv", "tracks.parquet")


def read_tracks(path: StrPath) -> Tracks:
    """Read tracks: CSV, Parquet, `.npz`, or the results folder of a run.

    Args:
        path: the file, or a folder with `tracks.csv` or `tracks.parquet`.

    Returns:
        The tracks, without what the format does not store; see `read_tracks_csv` and
        `read_tracks_parquet`.

    Raises:
        InvalidInputError: if there is no such file, or a value in it is out of range.
        FileFormatError: if it has another format.
    """
    source = as_path(path, "path")
    if source.is_dir():
        tables = [source / name for name in _IN_FOLDER if (source / name).is_file()]
        if not tables:
            raise InvalidInputError(f"The folder {source} holds no tracks.csv or tracks.parquet.")
        source = tables[0]
    suffix = source.suffix.lower()
    if suffix == ".parquet":
        return read_tracks_parquet(source)
    return Tracks.load(source) if suffix == ".npz" else read_tracks_csv(source)
