"""The node `swing_align`: alignment on a swinging or still base."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

# Small matrices: threads cost more than they bring. It counts before numpy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from sins_align.config import swing_config
from sins_align.ros.diagnostics import lever_arm_texts
from sins_align.ros.node_base import AlignNode
from sins_align.ros.run_node import prepare_aligner, run_node
from sins_align.session import Session
from sins_align.types import Estimate

NAME = "swing_align"


class SwingAlignNode(AlignNode):
    """Adds the lever arm to what all alignment nodes do."""

    def __init__(self) -> None:
        super().__init__(NAME, lambda values: Session(swing_config(values)), "lever_arm")

    def diagnostic_texts(self, estimate: Estimate | None) -> dict[str, str]:
        """The keys of the lever arm."""
        return lever_arm_texts(estimate)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; returns its exit status."""
    return run_node(NAME, SwingAlignNode, prepare_aligner, args)


if __name__ == "__main__":
    sys.exit(main())
