"""Self-alignment by the method of Mu and Fang, with its misprints corrected."""

from __future__ import annotations

from sins_align.config import SwingConfig
from sins_align.types import Estimate, ImuBlock, Position


class PaperAligner:
    """Aligner of method `paper`."""

    def __init__(self, config: SwingConfig, position: Position) -> None:
        self._config = config
        self._position = position

    def update(self, block: ImuBlock) -> None:
        """Take in the next block of samples."""

    @property
    def estimate(self) -> Estimate | None:
        """At the last stamp of the last block; None before there is one."""
        return None

    def propagate(self, block: ImuBlock) -> Estimate | None:
        """`estimate` carried to the end of `block`; changes nothing."""
        return None
