"""Messages of ROS as objects, from their bytes, by the definitions that are installed here.

The definition that a publisher sends is never compiled.
"""

from __future__ import annotations

from typing import Any, Dict

from genpy.message import get_message_class

from applr_ros1.common.errors import ApplrError
from applr_ros1.why.black_box.bag_file import Publication

_classes: Dict[str, Any] = {}  # classes of messages by type; None for one that is not installed


def deserialize(publication: Publication, data: bytes) -> Any:
    """Return a message as an object.

    Raises:
        ApplrError: Its type is not installed here, or has another definition.
    """
    message_type = publication.type
    if message_type not in _classes:
        _classes[message_type] = get_message_class(message_type)
    message_class = _classes[message_type]
    if message_class is None:
        problem = f"{message_type} is not installed"
        raise ApplrError(f"{publication.topic}: {problem}: install its package")
    if message_class._md5sum != publication.md5sum:
        problem = f"{message_type} has another definition than the one installed here"
        raise ApplrError(f"{publication.topic}: {problem}: install the publisher's version")
    return message_class().deserialize(data)
