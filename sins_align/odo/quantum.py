"""The distance of one count of an odometer, found from its speeds.

An odometer that counts says multiples of a quantum: either speed times the time since the
sample before (the driver divides by the time that passed), or the speed itself (it divides by
the nominal interval, or rounds, as a car's own bus does). A quantum too small is worse than
none: of the grids that fit, the coarsest one is taken, and none without clear evidence.
"""

from __future__ import annotations

import numpy as np

from sins_align.types import Array

# Before the data have told, the filter leaves room for counts as coarse as this [m].
COARSE_QUANTUM = 0.1
# Searches take place when so many samples of a vehicle in motion have come.
SEARCHES = (64, 256, 1024, 4096)
# Without a find by then, there are no counts.
ENOUGH = 256
# Samples looked at.
WINDOW = 256

# A value fits when it is so near to a multiple [counts]; chance does that to three in ten.
FIT = 0.15
# So many have to fit, outliers being few; of the differences fewer, as an outlier spoils several.
FITTING = 0.9
COARSE_FITTING = 0.65
# Outliers may have hidden a step behind one of its parts; when in doubt, it is the coarser one.
MULTIPLE_FITTING = 0.8
_MULTIPLES = (6, 5, 4, 3, 2)
EVIDENCE = 20
# Steps between values are compared with candidates up to so many counts, which may then be
# apart by `_SPACING`.
_MOST_COUNTS = 3.5
_SPACING = 0.04
_CANDIDATES = np.exp(-_SPACING * np.arange(round(np.log(4096.0) / _SPACING)))
# Equal but for rounding, relative to the largest.
_ROUNDING = 1e-6
# The step from values up to so many counts tells values up to the next number of counts.
_WIDER = (8.0, 32.0, 128.0, 512.0, 2048.0)


class QuantumFinder:
    """Finds the quantum as samples come; a function of the samples, not of the chunks.

    quantum : distance of one count [m], 0 where none is found
    """

    def __init__(self) -> None:
        self.quantum = 0.0
        self._moving = 0  # samples of a vehicle in motion so far
        self._stands = False
        self._searches = 0
        self._samples: Array = np.empty((2, 0))  # speed, length
        self._parts: list[tuple[Array, Array]] = []
        self._jump = COARSE_QUANTUM

    @property
    def noise_quantum(self) -> float:
        """What the speeds go up and down by [m], as if that were counts; of an outlier filter.

        The quantum where it is known. Before the first search, what is coarse for any vehicle.
        """
        if self.quantum > 0.0:
            return self.quantum
        return self._jump if self._moving >= ENOUGH else max(self._jump, COARSE_QUANTUM)

    @property
    def cautious_quantum(self) -> float:
        """The quantum [m]; coarse while it is not known, 0 once it is clear that there is none."""
        return COARSE_QUANTUM if not self.quantum and self._moving < ENOUGH else self.quantum

    def count_until_search(self, speed: Array) -> int:
        """How many of the next samples to add at once: a search comes after the last of them.

        speed : (n,) [m/s]
        """
        size = int(speed.shape[0])
        if self._searches == len(SEARCHES) or self._moving + size < SEARCHES[self._searches]:
            return size
        missing = SEARCHES[self._searches] - self._moving
        index = np.flatnonzero(speed)
        return int(index[missing - 1]) + 1 if index.shape[0] >= missing else size

    def add(self, speed: Array, length: Array) -> None:
        """Take in samples, no more than `count_until_search` says.

        speed : (n,) [m/s]
        length : (n,) time over which it is the mean [s]
        """
        if self._searches == len(SEARCHES):
            return
        stood, self._stands = self._stands, not speed[-1]
        if stood and not speed.any():
            return
        self._moving += int(np.count_nonzero(speed))
        self._parts.append((speed, length))
        if self._moving >= SEARCHES[self._searches]:
            self._searches += 1
            self._search()

    def _search(self) -> None:
        samples = np.concatenate((self._samples, *map(np.array, self._parts)), axis=1)
        keep = samples[0] != 0.0
        keep[1:] |= keep[:-1]  # of a standstill, the first zero is enough
        samples = samples[:, keep & (samples[1] > 0.0)]
        self._samples, self._parts = samples[:, -WINDOW:], []
        speed, length = self._samples
        if speed.shape[0] < EVIDENCE:
            return
        usual = float(np.median(length))
        self._jump = _usual_jump(speed) * usual
        found = find_grid(speed) * usual
        if np.abs(length - usual).max() > _ROUNDING * usual:
            found = max(found, find_grid(speed * length))
        self.quantum = _agree(self.quantum, found)


def _usual_jump(speed: Array) -> float:
    """What the speed (n,) changes by from sample to sample; outliers do not count [m/s]."""
    jumps = np.abs(np.diff(speed))
    # A coarse count seldom changes, and then by no less than one.
    changes = jumps[jumps > _ROUNDING * np.abs(speed).max()]
    least = float(np.quantile(changes, 0.25)) if changes.shape[0] else 0.0
    return max(float(np.quantile(jumps, 0.9)), least)


def _agree(old: float, new: float) -> float:
    """What two searches say together: a finer grid that explains both, else the coarser one."""
    if old == 0.0 or new == 0.0:
        return max(old, new)
    ratio = max(old, new) / min(old, new)
    return min(old, new) if abs(ratio - round(ratio)) < 0.02 * ratio else max(old, new)


def find_grid(x: Array) -> float:
    """The coarsest step of which the values x (n,), in order of time, are multiples; or 0."""
    size = np.abs(x)
    largest = float(size.max())
    if largest == 0.0:
        return 0.0
    # What lies between values one after the other, and between neighbours by size: a fast
    # odometer tells by the ones, a slow one by the others.
    changes = np.abs(np.diff(x))
    apart = np.concatenate((changes, np.diff(np.sort(size))))
    apart = apart[apart > _ROUNDING * largest]
    # Changes that are all alike are those of a steady acceleration.
    bends = np.abs(np.diff(x, n=2))
    for step in _coarse_steps(apart, largest).tolist():
        refined = _refine(apart, step, _MOST_COUNTS)
        for counts in _WIDER:
            refined = _refine(size, refined, counts)
        if not _fits(size, changes, bends, refined, FITTING, EVIDENCE):
            continue
        for multiple in _MULTIPLES:
            coarser = multiple * refined
            if _fits(size, changes, bends, coarser, MULTIPLE_FITTING, EVIDENCE // 2):
                return coarser
        return refined
    return 0.0


def _fits(
    size: Array, changes: Array, bends: Array, step: float, fitting: float, evidence: int
) -> bool:
    return bool(
        np.count_nonzero(bends > 0.5 * step) >= evidence
        and _is_multiple(changes, step, COARSE_FITTING, evidence)
        and _is_multiple(size, step, fitting, evidence)
    )


def _coarse_steps(apart: Array, largest: float) -> Array:
    """Candidates that steps of a few counts fit, the coarsest first."""
    candidates = largest * _CANDIDATES
    counts = apart / candidates[:, None]
    off = np.abs(counts - np.rint(counts))
    inside = (counts > FIT) & (counts < _MOST_COUNTS)
    fitting = (inside & (off <= FIT)).sum(axis=1)
    # Fewer than in the end: a candidate is not exact, and an outlier makes several gaps.
    enough = (fitting >= EVIDENCE) & (fitting >= COARSE_FITTING * inside.sum(axis=1))
    return candidates[enough]


def _refine(values: Array, step: float, most: float) -> float:
    """The step by least squares, from values up to `most` counts."""
    counts = np.rint(values / step)
    near = (counts >= 1.0) & (counts <= most) & (np.abs(values / step - counts) <= FIT)
    n = counts[near]
    return float(values[near] @ n / (n @ n)) if n.shape[0] else step


def _is_multiple(values: Array, step: float, fitting: float, evidence: int) -> bool:
    """Whether the values (n,), but for some, are multiples of a step, and enough not of zero."""
    counts = values / step
    counts = counts[counts > FIT]
    on = np.count_nonzero(np.abs(counts - np.rint(counts)) <= FIT)
    return on >= max(evidence, fitting * counts.shape[0])
