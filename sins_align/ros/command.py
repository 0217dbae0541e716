"""What the commands share: one-line errors, exit codes."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable
from typing import NoReturn

ALIGNED = 0  # 1 is Python's own, of a bug
UNUSABLE = 2
NOT_ALIGNED = 3


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line on standard error."""

    def error(self, message: str) -> NoReturn:
        """Say what is wrong and exit with status 2."""
        print(f"{self.prog}: {message} (try --help)", file=sys.stderr)
        raise SystemExit(UNUSABLE)


def say(text: str) -> None:
    """Print; when the reader of our output has left, go on without one."""
    try:
        print(text, flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def error_text(error: BaseException) -> str:
    """What went wrong as one line: of an OSError, which file and what."""
    if isinstance(error, OSError) and error.filename and error.strerror:
        return f"{error.filename}: {error.strerror}"
    return " ".join(str(error).split()) or type(error).__name__


def run_command(name: str, action: Callable[[], int]) -> int:
    """Run `action` and return its exit status.

    A ValueError that the ROS side raises for unusable input (ConfigError, BagError), an
    OSError and a lack of memory become one line on standard error and status 2.
    """
    from sins_align.grades import ConfigError
    from sins_align.ros.bags_merge import BagError

    try:
        return action()
    except (ConfigError, BagError, OSError, MemoryError) as error:
        print(f"{name}: {error_text(error)}", file=sys.stderr)
        return UNUSABLE
    except KeyboardInterrupt:
        return 130
