"""When the declared noise of the gyros is not believed.

Two models of the same data differ in that noise only: as declared, and `FACTOR` times as much.
The ratio of the likelihoods of the two is the most powerful test there is, and whenever one looks
at it: if what is declared is true it exceeds c at any time of a run by a chance of 1/c at most
(Ville's inequality).
"""

from __future__ import annotations

import math

from sins_align.reasons import GYRO_NOISY, Finding

FACTOR = 3.0
# The logarithm of the ratio beyond which the declared noise is not believed, which holds up one run
# in thirty for nothing at most; and that below which it is again.
DOUBTED, BELIEVED = math.log(30.0), math.log(10.0)


class NoiseDoubt:
    """What the ratio says.

    log_ratio : logarithm of the likelihoods' ratio, louder over declared
    """

    def __init__(self) -> None:
        self.log_ratio = 0.0
        self._is_doubted = False

    def note(self, log_ratio: float) -> None:
        """What the ratio is now."""
        self.log_ratio = log_ratio
        self._is_doubted = log_ratio > (BELIEVED if self._is_doubted else DOUBTED)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What there is to doubt."""
        if not self._is_doubted:
            return ()
        return (GYRO_NOISY(factor=FACTOR, log_ratio=self.log_ratio),)
