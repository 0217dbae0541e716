"""What every section yields: cases, with the figures that have to keep their bounds."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple


@dataclass(frozen=True)
class Check:
    """A figure, and the bounds that it has to keep."""

    name: str
    value: float
    low: float
    high: float

    @property
    def kept(self) -> bool:
        """Whether the value lies within the bounds."""
        return self.low <= self.value <= self.high

    def __str__(self) -> str:
        verdict = "kept" if self.kept else "BROKEN"
        return f"    {self.name:48s} {self.value:10.4g}  [{self.low:g}, {self.high:g}]  {verdict}"


def upper(name: str, value: float, bound: float) -> Check:
    """A magnitude with an upper bound."""
    return Check(name, abs(float(value)), 0.0, bound)


class Case(NamedTuple):
    """A row of evidence: how many runs it is made of, what is printed of them, the checks."""

    name: str
    runs: int
    lines: Sequence[str]
    checks: Sequence[Check]


Cases = Iterable[Case]
