"""The distance of one count of an odometer, found from its speeds."""

from __future__ import annotations

from sins_align.types import Array

# Before the data have told, the filter leaves room for counts as coarse as this [m].
COARSE_QUANTUM = 0.1


class QuantumFinder:
    """Finds nothing yet."""

    def __init__(self) -> None:
        self.quantum = 0.0

    @property
    def assumed_quantum(self) -> float:
        """What to reckon with before anything is known [m]."""
        return COARSE_QUANTUM

    def count_until_search(self, moving: Array) -> int:
        """How many of the samples to add before the next search."""
        return int(moving.shape[0])

    def add(self, speed: Array, length: Array, usual: Array) -> None:
        """Take in samples: speed [m/s], and what it is the mean over [s]."""
