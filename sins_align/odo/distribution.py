"""What the steps of a filter hand to each other: distributions of its errors, and a measurement."""

from __future__ import annotations

from typing import NamedTuple

from sins_align.types import Array


class Forecast(NamedTuple):
    """The errors at the end of an epoch, path included, before the measurement.

    mean : (n + 3,); P : (n + 3, n + 3) covariance; Q : (n + 3, n + 3) what of it is new noise
    """

    mean: Array
    P: Array
    Q: Array


class Expected(NamedTuple):
    """What the errors let one expect of the measurement.

    z : (3,) mean [m]; cross : (n + 3, 3) covariance of errors and measurement; S : (3, 3)
    covariance of the measurement by the errors [m^2]
    """

    z: Array
    cross: Array
    S: Array


class Posterior(NamedTuple):
    """What a filter gives out after an epoch.

    alpha : wander angle of a [rad]; mean : (n,) of the errors that is not fed back; P : (n, n)
    phi_by_errors : (3, n) phi in a, its vertical part that of the heading, by the errors
    """

    alpha: float
    mean: Array
    P: Array
    phi_by_errors: Array


class Taken(NamedTuple):
    """What was made of a measurement.

    value : (3,) innovation [m]; S : (3, 3) its covariance, noise included [m^2]
    R : (3, 3) the noise that it was taken in with, which is grown where it was implausible
    correction : (n,) errors that it took off the estimates
    jump : variance that the scale, which had jumped, was given first; None: it had not
    """

    value: Array
    S: Array
    R: Array
    correction: Array
    jump: float | None
