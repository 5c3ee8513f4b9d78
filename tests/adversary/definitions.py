"""Sound message definitions, and definitions that cost a parser time or memory."""

from collections.abc import Callable, Mapping

from .grammar import Draw

HEADER = """
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
SOUND: Mapping[str, str] = {
    "sensor_msgs/msg/JointState": "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\n"
    "float64[] effort" + HEADER,
    "sensor_msgs/msg/Image": "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\n"
    "uint8 is_bigendian\nuint32 step\nuint8[] data" + HEADER,
    "sensor_msgs/msg/CompressedImage": "std_msgs/Header header\nstring format\nuint8[] data" + HEADER,
    "std_msgs/msg/Float64MultiArray": "MultiArrayLayout layout\nfloat64[] data\n"
    + "=" * 80
    + "\nMSG: std_msgs/MultiArrayLayout\nMultiArrayDimension[] dim\nuint32 data_offset\n"
    + "=" * 80
    + "\nMSG: std_msgs/MultiArrayDimension\nstring label\nuint32 size\nuint32 stride\n",
}
IDL = """================================================================================
IDL: demo_msgs/msg/Cells
module demo_msgs { module msg { struct Cells { sequence<double> data; }; }; };
"""


def _nested_idl(draw: Draw) -> tuple[str, str]:
    depth = draw.of((3, 8, 20, 40, 400))
    inner = "sequence<" * depth + "double" + ">" * depth
    return f"module m {{ module msg {{ struct X {{ {inner} data; }}; }}; }};", "ros2idl"


def _dimensions(draw: Draw) -> tuple[str, str]:
    count = draw.of((2, 30, 3000))
    return f"module m {{ module msg {{ struct X {{ double data{'[2]' * count}; }}; }}; }};", "ros2idl"


def _odd_idl(draw: Draw) -> tuple[str, str]:
    pieces = (
        "module ",
        "{",
        "}",
        ";",
        "struct X",
        "typedef ",
        "const long A = ",
        "(" * 30,
        "1 + " * 40,
        "enum E {A,",
        "@key ",
        '@verbatim(language="c", text="',
        "/*",
        "//",
        "string<5>",
        "wstring",
        "double a",
        "[",
        "<",
        "::",
        '"',
    )
    return "".join(draw.of(pieces) for _ in range(draw.random.randint(5, 120))), "ros2idl"


def _many_lines(draw: Draw) -> tuple[str, str]:
    count = draw.of((100, 300, 1000, 5000, 30_000))
    return "\n".join(f"float64 f{i}" for i in range(count)), "ros2msg"


def _branching(draw: Draw) -> tuple[str, str]:
    """Types that contain the next one twice: 2**depth values."""
    depth, size = draw.of((10, 30, 60)), draw.of(("", "[2]", "[]", "[2147483647]"))
    text = f"T0{size} a\nT0{size} b\n"
    for level in range(depth):
        inner = f"T{level + 1}{size} a\nT{level + 1}{size} b\n" if level < depth - 1 else "uint8[0] x\n"
        text += "=" * 80 + f"\nMSG: m/T{level}\n{inner}"
    return text, "ros2msg"


def _itself(draw: Draw) -> tuple[str, str]:
    return "m/A a\n" + "=" * 80 + "\nMSG: m/A\nm/B b\n" + "=" * 80 + "\nMSG: m/B\nm/A[] a\n", "ros2msg"


def _large(draw: Draw) -> tuple[str, str]:
    size = draw.of(("0", "2147483647", "2147483648", "9" * 40, "<=3", "-1", "1000000"))
    return f"{draw.of(('float64', 'string', 'std_msgs/Header', 'wstring', 'time'))}[{size}] data" + HEADER, "ros2msg"


def _long_line(draw: Draw) -> tuple[str, str]:
    return draw.of(("a" * 50_000, "float64 " + "x" * 50_000, "float64" + " " * 50_000 + "x", "[" * 20_000)), "ros2msg"


def _noise(draw: Draw) -> tuple[str, str]:
    return draw.noise(300).decode("latin1"), draw.of(("ros2msg", "ros1msg", "ros2idl"))


def _constants(draw: Draw) -> tuple[str, str]:
    values = ("1e999", "9" * 500, '"', "'\\", "-", "", "0x", "True")
    return "".join(f"int32 A{i}={draw.of(values)}\n" for i in range(9)) + "float64[] data", "ros2msg"


BOMBS: tuple[Callable[[Draw], tuple[str, str]], ...] = (
    _nested_idl,
    _dimensions,
    _odd_idl,
    _many_lines,
    _branching,
    _itself,
    _large,
    _long_line,
    _noise,
    _constants,
)


def definition(draw: Draw, kind: str) -> tuple[bytes, str]:
    """A definition for messages of that type, and its dialect."""
    if not draw.hostile(0.5):
        return SOUND[kind].encode(), "ros2msg"
    text, dialect = draw.of(BOMBS)(draw)
    if draw.hostile(0.3):
        text += SOUND[kind]
    return text.encode("utf-8", "replace"), dialect if not draw.hostile() else draw.text(dialect)
