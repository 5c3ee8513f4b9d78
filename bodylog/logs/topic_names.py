"""Names of topics: what ROS allows in one, and where what bodylog writes stands."""

import re

PREFIX = "/bodylog/"
"""How the name of every topic begins that bodylog writes."""
TRACK = PREFIX + "track/"
TRACK_NAMES = ("u", "v", "std_u", "std_v")
_ILLEGAL = re.compile(r"(?:^|(?<=/))[0-9]|[^A-Za-z0-9_/]|(?:^|(?<=/))/|/(?=/|$)|_(?=x[0-9a-f]+[^A-Za-z0-9])")


def escape(name: str) -> str:
    """`name`, whose / part it, as the end of a topic name: what ROS does not allow there becomes _x<hex>_."""
    return _ILLEGAL.sub(lambda m: f"_x{ord(m[0]):x}_", name)


def unescape(segment: str) -> str:
    """The name that `escape` was given."""
    return re.sub(r"_x([0-9a-f]+)_", lambda m: chr(int(m[1], 16)), segment)
