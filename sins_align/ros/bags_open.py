"""From paths to storage files: folders with metadata.yaml, bare files, compressed files."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path, PurePath

from sins_align.ros.bags_files import Ros1File, SqliteFile
from sins_align.ros.bags_mcap import MAGIC, open_mcap
from sins_align.ros.bags_merge import BagError, Source, Warnings

_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_METADATA = "metadata.yaml"


def open_path(path: Path, warnings: Warnings, stack: ExitStack) -> Iterator[tuple[Source, bool]]:
    """The storage files of one bag, and whether each message in them is compressed.

    Files stay open, and decompressed copies on the disk, until `stack` is closed.
    Raises BagError.
    """
    try:
        if not path.exists():
            raise BagError(path, "no such file or folder")
        if not path.is_dir():
            yield _open_file(path, warnings, stack), False
            return
        files, compressed = _read_metadata(path)
        for file in files:
            if not file.exists():
                raise BagError(file, f"the file is missing, {_METADATA} names it")
            yield _open_file(file, warnings, stack), compressed
    except OSError as error:
        raise BagError(path, error.strerror or error) from error


def _read_metadata(folder: Path) -> tuple[list[Path], bool]:
    """Storage files of a rosbag2 folder, and whether each message in them is compressed."""
    import yaml

    where = folder / _METADATA
    if not where.exists():
        raise BagError(folder, f"no {_METADATA} in this folder; name the files in it one by one")
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # ten times as fast
    try:
        metadata = yaml.load(where.read_text(), loader)["rosbag2_bagfile_information"]
        # Early versions wrote the folder's name too.
        files = [folder / PurePath(name).name for name in metadata["relative_file_paths"]]
        mode = str(metadata.get("compression_mode") or "").lower()
    except (yaml.YAMLError, UnicodeDecodeError, LookupError, TypeError, AttributeError) as error:
        raise BagError(where, f"not the metadata of a bag: {error!r}") from error
    if not files:
        raise BagError(where, "no storage file is named")
    return files, mode == "message"


def _open_file(path: Path, warnings: Warnings, stack: ExitStack) -> Source:
    """Open a storage file, whatever its suffix says, by how it begins."""
    with path.open("rb") as file:
        head = file.read(16)
    source: Source
    if head.startswith(_ZSTD_MAGIC):
        return _open_file(_decompress(path, warnings, stack), warnings, stack)
    if head.startswith(MAGIC):
        source = open_mcap(path, warnings)
    elif head.startswith(b"SQLite format 3"):
        source = SqliteFile(path, warnings)
    elif head.startswith(b"#ROSBAG V"):
        source = Ros1File(path, warnings)
    elif not head:
        raise BagError(path, "the file is empty")
    else:
        raise BagError(path, "not a bag: neither MCAP nor sqlite3 nor ROS 1")
    stack.callback(source.close)
    return source


def _decompress(path: Path, warnings: Warnings, stack: ExitStack) -> Path:
    """Decompress a file to a temporary folder; of a damaged one, as much as possible."""
    import zstandard

    folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="sins_align_"))
    copy = Path(folder) / path.stem
    with path.open("rb") as source, copy.open("wb") as target:
        try:
            with zstandard.ZstdDecompressor().stream_reader(source) as reader:
                shutil.copyfileobj(reader, target, 1 << 20)
        except zstandard.ZstdError as error:
            warnings.note(path, f"{error}; what followed is lost")
    return copy
