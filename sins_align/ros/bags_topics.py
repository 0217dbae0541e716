"""Which topic of a bag is meant."""

from __future__ import annotations

from collections.abc import Iterable

from sins_align.ros.bags_merge import Topic

KINDS = {
    "imu": ("sensor_msgs/msg/Imu",),
    "fix": ("sensor_msgs/msg/NavSatFix",),
    "odom": (
        "geometry_msgs/msg/TwistStamped",
        "geometry_msgs/msg/TwistWithCovarianceStamped",
        "nav_msgs/msg/Odometry",
    ),
}
"""The kinds of topics, with their message types."""


def types_of(kind: str) -> tuple[str, ...]:
    """Message types of a kind; a message type stands for itself."""
    return KINDS.get(kind, (kind,))


def odometer_type(odom_type: str) -> str:
    """The message type that a value of parameter `odom_type` stands for."""
    return next(name for name in KINDS["odom"] if name.endswith(f"/{odom_type}"))


def choose_topic(topics: Iterable[Topic], kind: str, requested: str | None) -> Topic:
    """The requested topic, else the only one of that kind.

    Raises LookupError that says what there is instead.
    """
    topics = list(topics)
    candidates = [topic for topic in topics if topic.type in types_of(kind)]
    what = " or ".join(map(_short, types_of(kind)))
    if requested:
        for topic in candidates:
            if topic.name.lstrip("/") == requested.lstrip("/"):
                return topic
        raise LookupError(f"no {what} on {requested}; {describe_topics(topics)}")
    if not candidates:
        raise LookupError(f"no topic of {what}; {describe_topics(topics)}")
    if len(candidates) > 1:
        names = ", ".join(sorted(topic.name for topic in candidates))
        raise LookupError(f"several topics of {what}, name one of them: {names}")
    return candidates[0]


def describe_topics(topics: Iterable[Topic]) -> str:
    """What topics there are, in words."""
    names = sorted(f"{topic.name} ({_short(topic.type)})" for topic in topics)
    return f"there is {', '.join(names)}" if names else "there are no topics at all"


def _short(message_type: str) -> str:
    return message_type.replace("/msg/", "/")
