"""What the commands share: one-line errors, exit codes."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable
from typing import NoReturn

ALIGNED = 0
BUG = 1
UNUSABLE = 2
NOT_ALIGNED = 3


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line on standard error."""

    def error(self, message: str) -> NoReturn:
        """Say what is wrong and exit with status 2."""
        print(f"{self.prog}: {message} (try --help)", file=sys.stderr)
        raise SystemExit(UNUSABLE)


def run_command(name: str, action: Callable[[], int]) -> int:
    """Run `action` and return its exit status.

    A ValueError that the ROS side raises for unusable input (ConfigError, BagError) and an
    OSError become one line on standard error and status 2.
    """
    from sins_align.grades import ConfigError
    from sins_align.ros.bags_merge import BagError

    try:
        return action()
    except BrokenPipeError:  # the reader of our output has left; nobody to tell
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return UNUSABLE
    except (ConfigError, BagError, OSError) as error:
        print(f"{name}: {' '.join(str(error).split())}", file=sys.stderr)
        return UNUSABLE
    except KeyboardInterrupt:
        return 130
