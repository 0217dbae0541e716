"""`align_synth` as a process: a signal that comes early waits until there is a node."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from sins_align.ros.signals import hold_signals


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; returns its exit status. args : None: those of the process"""
    hold_signals()
    from sins_align.ros.synth_node import main as run  # numpy and rclpy take a moment

    return run(args)


if __name__ == "__main__":
    sys.exit(main())
