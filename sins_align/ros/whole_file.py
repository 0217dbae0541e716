"""Files that are written whole or not at all, also when the process is killed meanwhile."""

from __future__ import annotations

import errno
import os
import re
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import IO

SUFFIX = ".part"
LEFT_OVER_S = 60.0  # no file takes longer to be written


def write_whole(path: Path, write: Callable[[IO[bytes]], object]) -> None:
    """Write a file whole or not at all: to a temporary name beside it, then renamed.

    The temporary name is `.NAME.xxxxxxxx.part`. A device or a pipe is written to as it is,
    and of a link the file it leads to.

    Raises
    ------
    OSError : the folder is missing or not writable, or the disk is full; names `path`
    """
    try:
        if _is_stream(path):
            with path.open("wb") as file:
                write(file)
        else:
            _write_and_rename(_target(path), write)
    except OSError as error:  # of the temporary file, whose name says nothing to anybody
        raise OSError(error.errno, error.strerror, str(path)) from None


def write_text_whole(path: Path, text: str) -> None:
    """`write_whole` for a text, in UTF-8."""
    write_whole(path, lambda file: file.write(text.encode()))


def check_target(path: Path) -> None:
    """Find out before a long run whether `path` can be written.

    Raises
    ------
    OSError : as `write_whole`
    """
    if _is_stream(path):
        return
    try:
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        descriptor, temporary = _make_temporary(_target(path))
        os.close(descriptor)
        os.unlink(temporary)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None


def remove_leftovers(path: Path) -> None:
    """Remove what processes have left that were killed while they wrote `path`.

    That are files with the temporary names of `write_whole` for this very path, older than any
    writing takes: another process may be about it just now.
    """
    target = _target(path)
    name = re.compile(re.escape(f".{target.name}.") + r"[a-z0-9_]{8}" + re.escape(SUFFIX))
    now = time.time()
    with suppress(OSError), os.scandir(target.parent) as entries:
        for entry in entries:
            if name.fullmatch(entry.name) and now - entry.stat().st_mtime > LEFT_OVER_S:
                os.unlink(entry)


def _target(path: Path) -> Path:
    return Path(os.path.realpath(path))


def _make_temporary(target: Path) -> tuple[int, str]:
    return tempfile.mkstemp(prefix=f".{target.name}.", suffix=SUFFIX, dir=target.parent)


def _write_and_rename(target: Path, write: Callable[[IO[bytes]], object]) -> None:
    descriptor, temporary = _make_temporary(target)
    try:
        with os.fdopen(descriptor, "wb") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        mask = os.umask(0)  # mkstemp makes the file private; give it the usual mode
        os.umask(mask)
        os.chmod(temporary, 0o666 & ~mask)
        os.replace(temporary, target)
    except BaseException:
        os.unlink(temporary)
        raise


def _is_stream(path: Path) -> bool:
    """True for what must not be replaced by a file: /dev/null, a terminal, a pipe."""
    return path.exists() and not path.is_file() and not path.is_dir()
