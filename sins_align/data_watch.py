"""What is wrong with the data themselves, whatever is made of them: values, units, axes, stamps."""

from __future__ import annotations

from collections import deque

from sins_align.config import OdoConfig, SwingConfig
from sins_align.reasons import Finding
from sins_align.soundness import find_fault
from sins_align.stamp_watch import StampWatch
from sins_align.types import ImuBlock
from sins_align.units_watch import UnitsWatch


class DataWatch:
    """Looks at every block before an aligner does."""

    def __init__(self, config: SwingConfig | OdoConfig) -> None:
        is_driving = isinstance(config, OdoConfig) and not config.stationary
        self._units = UnitsWatch(config.sampling, is_driving)
        self._stamps = StampWatch(config.grade.gyro_arw)
        # Of the blocks that the aligner is not through with, by their ends.
        self._said: deque[tuple[int, tuple[Finding, ...]]] = deque()

    def update(self, block: ImuBlock) -> Finding | None:
        """Take in a block: why nothing can be made of it, None where something can."""
        fault = find_fault(block)
        if fault is not None:
            return fault
        self._units.update(block)
        self._stamps.update(block)
        found = (self._units.hint, self._stamps.finding)
        said = tuple(finding for finding in found if finding is not None)
        self._said.append((int(block.stamp_ns[-1]), said))
        return self._units.fault

    def findings(self, stamp_ns: int) -> tuple[Finding, ...]:
        """What was to be said of the block at that stamp; the stamps asked for do not go back."""
        while self._said[0][0] < stamp_ns:
            self._said.popleft()
        return self._said[0][1]
