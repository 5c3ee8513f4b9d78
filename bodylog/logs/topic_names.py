"""Topic names: the prefix of the topics that bodylog
writes, and escaping of characters that ROS forbids.
"""

import re

PREFIX = "/bodylog/"
"""The prefix of every topic that bodylog writes."""
TRACK = PREFIX + "track/"
TRACK_NAMES = ("u", "v", "std_u", "std_v")
POINT_NAMES = ("x", "y", "z", "std_x", "std_y", "std_z")
"""Columns of a track in images, px, and of a point in space, m."""
TRACKER = "tracker"
"""What measures points in space, where nothing says in which frame they are."""
_ILLEGAL = re.compile(
    r"(?:^|(?<=/))[0-9]|[^A-Za-z0-9_/]|(?:^|(?<=/))/|/(?=/|$)|_(?=x[0-9a-f]+[^A-Za-z0-9])"
)


def escape_topic_name(name: str) -> str:
    """`name`, whose / separate parts, as the end of a topic
    name; characters that ROS forbids become _x<hex>_.
    """
    return _ILLEGAL.sub(lambda m: f"_x{ord(m[0]):x}_", name)


def unescape_topic_name(segment: str) -> str:
    """Undo `escape_topic_name`."""
    return re.sub(r"_x([0-9a-f]+)_", lambda m: chr(int(m[1], 16)), segment)
