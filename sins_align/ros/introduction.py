"""One node makes itself known to another."""

from __future__ import annotations

import time

from rcl_interfaces.srv import ListParameters
from rclpy.node import Node
from rclpy.task import Future

ASK_AGAIN_S = 0.5


class Introduction:
    """Asks another node until it answers; then it knows of all that was made here before.

    That its subscriptions are known here does not say that it knows of the publishers here, and
    until it does, best-effort samples and the answers of its services are lost. DDS tells it of
    writers in the order in which they were made, and of readers likewise. The client here is
    made after them: who has got its question and reached it with the answer knows of all.

    Parameters
    ----------
    node : spun by the caller
    other : the name of the other one, as in the name of a topic
    """

    def __init__(self, node: Node, other: str) -> None:
        self._node = node
        self._client = node.create_client(ListParameters, f"{other}/list_parameters")
        self._answers: list[Future] = []
        self._asked_s = 0.0

    def is_done(self) -> bool:
        """Whether an answer has come; asks now and then, for the first ones may be lost."""
        now_s = time.monotonic()
        due = not self._answers or now_s > self._asked_s + ASK_AGAIN_S
        if due and self._client.service_is_ready():
            self._asked_s = now_s
            self._answers.append(self._client.call_async(ListParameters.Request()))
        return any(answer.done() for answer in self._answers)

    def close(self) -> None:
        """Drop what it took."""
        self._node.destroy_client(self._client)
