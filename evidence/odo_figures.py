"""The statistics of drives, and the checks that all of them share."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from evidence.checks import Check, upper
from evidence.monte_carlo import rms
from evidence.odo_runs import Drive
from sins_align.types import Array
from sins_align.units import ARCMIN

TIMES_S = (30, 60, 120, 150, 300, 600, 870)
# Of the mean over runs; of 30 honest ones it leaves the bounds twice in a thousand cases.
NEES = (0.4, 2.2)


def heading_errors(drives: Sequence[Drive]) -> Array:
    """(runs, T) heading error [arcmin]."""
    return np.array([d.phi[:, 2] for d in drives]) / ARCMIN


def ratios(drives: Sequence[Drive]) -> Array:
    """(runs, T) heading error over its sigma."""
    return np.array([d.phi[:, 2] / d.sigma[:, 2] for d in drives])


def nees(drives: Sequence[Drive], at_s: int) -> float:
    """Mean normalised square of the heading error."""
    return float(rms(ratios(drives)[:, at_s]) ** 2)


def shown_nees(drives: Sequence[Drive]) -> float:
    """As `nees`, of every heading that was shown, at whatever time."""
    shown = np.array([d.published for d in drives]) == 1.0
    return float(rms(ratios(drives)[shown]) ** 2)


def below_since(curve: Array, bound: float) -> float:
    """The second from which on `curve` (T,) stays below; infinity where it does not."""
    above = np.flatnonzero(~(curve < bound))
    since = 0 if above.size == 0 else int(above[-1]) + 1
    return float(since) if since < curve.size else math.inf


def rows(drives: Sequence[Drive], times_s: Sequence[int] = TIMES_S) -> list[str]:
    """Heading and levels at some times: the statistics of all runs, published or not."""
    error, length = heading_errors(drives), drives[0].phi.shape[0]
    sigma = np.array([d.sigma for d in drives]) / ARCMIN
    level = np.array([d.phi[:, :2] for d in drives]) / ARCMIN
    level_nees = np.array([d.level_nees for d in drives])
    scale = 100.0 * np.array([d.scale_error for d in drives])
    published = np.array([d.published for d in drives])
    heading = "heading ': mean     RMS     max   sigma  NEES  shown"
    text = [f"      t [s]  {heading}  level ':  RMS   sigma  NEES/2  scale %:  RMS     max"]
    for t in times_s:
        if t >= length:
            continue
        text.append(
            f"      {t:5d}  {error[:, t].mean():15.3f} {rms(error[:, t]):7.3f}"
            f" {np.abs(error[:, t]).max():7.3f} {rms(sigma[:, t, 2]):7.3f}"
            f" {nees(drives, t):5.2f} {int(published[:, t].sum()):6d}"
            f" {rms(level[:, t]):14.4f} {rms(sigma[:, t, :2]):7.4f}"
            f" {level_nees[:, t].mean() / 2.0:7.2f}"
            f" {rms(scale[:, t]):14.5f} {np.abs(scale[:, t]).max():7.5f}"
        )
    worst = int(np.abs(error[:, -1]).argmax())
    text.append(f"      worst seed {drives[worst].seed}: {error[worst, -1]:.2f}' at the end")
    return text


def divergence(drives: Sequence[Drive]) -> list[Check]:
    """No run diverges: each has an estimate at the end, none was ever shown with a sigma
    that has nothing to do with its error, and none is called aligned that is not.
    """  # fmt: skip
    shown = np.array([d.published for d in drives]) == 1.0
    aligned = np.array([d.aligned for d in drives]) & shown
    ratio = np.abs(ratios(drives))
    return [
        upper("runs without an estimate at the end", float((~shown[:, -1]).sum()), 0.0),
        upper("largest heading error / sigma ever shown", ratio[shown].max(initial=0.0), 6.0),
        upper("largest heading error / sigma called aligned", ratio[aligned].max(initial=0.0), 4.5),
        upper("claims of alignment above the threshold", sum(d.false_claims for d in drives), 0.0),
    ]
