"""The predicted time to go, looked up now and then and counted down in between."""

from __future__ import annotations

import math

from sins_align.session import Session
from sins_align.types import State

# A prediction costs some milliseconds, and longer ones change more slowly.
LEAST_AGE_S, SHARE = 5.0, 0.1


class EtaClock:
    """Asks the session when its last answer has become old, by the time of the data.

    Or when something else is said than then: no number outlives the doubt, or the new beginning,
    that has made it void.
    """

    def __init__(self) -> None:
        self._asked_s = -math.inf
        self._asked_of: tuple[object, ...] = ()
        self._eta_s = math.nan

    def eta_s(self, session: Session) -> float:
        """Time to go [s]; NaN or inf where there is none to be told."""
        status = session.status
        if status.state is State.ALIGNED:
            self._asked_s = -math.inf
            return 0.0
        of = (session.beginnings, session.config.completion, status.state, status.keys)
        age = status.elapsed_s - self._asked_s
        if of != self._asked_of or not 0.0 <= age < LEAST_AGE_S + SHARE * status.elapsed_s:
            self._asked_s, self._asked_of = status.elapsed_s, of
            self._eta_s, age = session.eta_s, 0.0
        return max(self._eta_s - age, 0.0) if math.isfinite(self._eta_s) else self._eta_s
