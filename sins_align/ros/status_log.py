"""What goes to the log of a node: what is new of its status, and nothing twice."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from sins_align.reasons import BEGAN_ANEW, Finding, Kind
from sins_align.session import Session
from sins_align.types import State, Status


class StatusLog:
    """Remembers what has been said.

    Parameters
    ----------
    get_logger : the node's, asked each time: once ROS is down it gives another one
    session : whose status it is
    """

    def __init__(self, get_logger: Callable[[], Any], session: Session) -> None:
        self._get_logger = get_logger
        self._session = session
        self._state = session.status.state
        self._keys: set[str] = set()
        self._inputs: set[str] = set()
        self._restarts = 0

    def tell(self, status: Status) -> None:
        """Log a change of state, a new beginning, and findings that are new."""
        restarts = self._session.restarts
        if restarts != self._restarts:
            self._restarts = restarts
            self._state = State.WAITING
            self._keys = {BEGAN_ANEW.key}
            self._get_logger().warning(f"the alignment began anew: {self._session.begin_reason}")
        if status.state is not self._state:
            self._state = status.state
            self._log(status.state, ": ".join(filter(None, (status.state.value, status.reason))))
            self._keys = set(status.keys)
        for finding in status.findings:
            key, kind = finding.reason.key, finding.reason.kind
            if key not in self._keys and kind is not Kind.PROGRESS:
                self._keys.add(key)
                self._log(status.state, f"{status.state.value}: {finding.text}")

    def tell_inputs(self, inputs: list[Finding]) -> None:
        """Log what is new of what is wrong with the inputs, unless the status has said it."""
        told = self._inputs | set(self._session.status.keys)
        for finding in inputs:
            if finding.reason.key not in told:
                self._get_logger().warning(finding.text)
        self._inputs = {finding.reason.key for finding in inputs}

    def _log(self, state: State, text: str) -> None:
        if state is State.FAILED:
            self._get_logger().error(text)
        else:
            self._get_logger().info(text)
