"""SIGINT and SIGTERM, kept waiting while there is nothing yet that could end well."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager

SIGNALS = (signal.SIGINT, signal.SIGTERM)


def hold_signals() -> None:
    """From now on they wait, until a `signals_held` ends.

    For the very begin of a process: the threads that it starts later leave them to the first.
    """
    signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)


@contextmanager
def signals_held() -> Iterator[None]:
    """Those that come inside are delivered at the end."""
    hold_signals()
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
