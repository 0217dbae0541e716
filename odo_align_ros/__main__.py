"""`odo_align` as a process: a signal that comes early waits until there is a node."""

from __future__ import annotations

import sys

from sins_align.ros.signals import hold_signals


def main() -> int:
    """Run the node with the arguments of the process; returns its exit status."""
    hold_signals()
    from odo_align_ros.node import main as run  # takes a second or so where the machine is busy

    return run()


if __name__ == "__main__":
    sys.exit(main())
