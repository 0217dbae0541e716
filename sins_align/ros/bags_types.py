"""Message types, for what is not decoded as arrays. Importing them costs up to 0.3 s."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

from sins_align.ros.bags_merge import Topic

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore


@cache
def typestore_for(topic: Topic) -> Typestore:
    """The types of a topic as its bag defines them, else as Jazzy (ROS 1: Noetic) does."""
    from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

    if topic.definition:
        store = get_typestore(Stores.EMPTY)  # fast to import
        try:
            store.register(get_types_from_msg(topic.definition, topic.type))
            store.get_msgdef(topic.type)
        except (TypesysError, LookupError):  # the definition is damaged
            pass
        else:
            return store
    return get_typestore(Stores.ROS1_NOETIC if topic.ros1 else Stores.ROS2_JAZZY)
