"""Hostile settings: robot.toml and command-line options."""

import json
import math
import typing
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from bodylog.io.toml_keys import spell_key
from bodylog.settings import Settings, find_declaration

from .grammar import FLOATS, INTEGERS, TEXTS, Draw

TOPICS = (
    "/joint_states",
    "/joint_states.position",
    "/joint_states.position[:]",
    "/camera/image",
    "/camera/compressed",
    "/skin",
    "/skin.data",
    "/skin.data[-1:0]",
    "/skin.data[99999999999999999999]",
    '/skin.layout.dim[:]{label=="x"}.size',
    "video.mp4",
    "/",
    "",
    ".",
    "/nope",
    "/joint_states.header.stamp",
    "/joint_states.name",
)
COLOURS: tuple[Any, ...] = (
    "green",
    "red",
    "purple",
    {"low": [0, 0, 0], "high": [180, 255, 255]},
    {"low": [170, 50, 50], "high": [10, 255, 255]},
    {"low": [-1, 0, 0], "high": [999, 0, 0]},
    {"low": []},
    {},
    {"low": [180, 255, 255], "high": [0, 0, 0]},
)
WORDS = (
    "auto",
    "off",
    "on",
    "header",
    "log",
    "model",
    "fixed",
    "paper",
    "default",
    "filter",
    "smoother",
    "ekf",
    "kalman",
    "predictive-coding",
    "encoders",
    "vision",
    "touch",
    "effector",
    "rad",
    "deg",
    "literal",
    "explicit",
)
NUMBERS = (*FLOATS, 0.0, 1.0, -1.0, 0.5, 3600.0, 3600.1, 1e6, 1e-3, 50.0, 100.0, 1e15)


def value(draw: Draw, depth: int = 0) -> Any:
    """Any value that TOML can express."""
    kinds = [
        lambda: draw.of(NUMBERS),
        lambda: draw.of([n for n in INTEGERS if abs(n) < 2**63]),
        lambda: draw.of(TEXTS),
        lambda: draw.of(WORDS),
        lambda: draw.of(WORDS),
        lambda: draw.of(TOPICS),
        lambda: draw.of(TOPICS),
        lambda: draw.of((True, False)),
        lambda: draw.of(COLOURS),
        lambda: [value(draw, depth + 1) for _ in range(draw.random.randint(0, 4))] if depth < 2 else [],
        lambda: {draw.of((*WORDS, "camera", "a/b")): value(draw, depth + 1)} if depth < 2 else {},
    ]
    return draw.of(kinds)()


def fitting(draw: Draw, section: str, key: str, hint: Any) -> Any:
    """A value of a setting's type, mostly in range."""
    described = find_declaration(section, spell_key(key)).key
    if described.choices and hint is str:
        return draw.of(described.choices)
    low, high = (-10.0, 10.0) if described.low == -math.inf else (described.low, described.high)
    options = [option for option in typing.get_args(hint) or (hint,) if option is not type(None)]
    option = draw.of(options) if typing.get_origin(hint) is not tuple else hint
    if option is bool:
        return draw.of((True, False))
    if option in (int, float):
        edges = (low, high, low + 1, min(high, 1000), draw.random.uniform(low, min(high, 100.0)))
        number = draw.of(edges)
        return float(number) if option is float else int(min(number, 2**63 - 1))
    if section == "topics":
        return draw.of(TOPICS) if option is str else [draw.of(TOPICS), draw.of(TOPICS)]
    if section == "colours":
        return draw.of(COLOURS) if key != "markers" else {draw.text("tip"): draw.of(COLOURS)}
    if key == "delay":
        return draw.of(("auto", "off", {"camera": draw.of(NUMBERS)}, {"other": 0.1}, {"joints": -0.01}))
    if key in ("joints", "senses", "without"):
        return draw.of((["shoulder", "elbow"], ["elbow"], ["wrist"], ["vision"], ["encoders"], ["effector", "touch"]))
    if key == "start":
        return [draw.number(0.1), draw.number(0.2)]
    return draw.of(WORDS)


def toml(draw: Draw) -> str:
    """A robot.toml with one to four keys, mostly with valid values."""
    lines = []
    for _ in range(draw.random.randint(1, 4)):
        section = draw.of(fields(Settings)).name
        current = getattr(Settings(), section)
        key = draw.of([f.name for f in fields(current)]) if is_dataclass(current) else json.dumps(draw.text("tip"))
        hints = typing.get_type_hints(type(current)) if is_dataclass(current) else {}
        fits = key in hints and draw.random.random() < 0.85
        chosen = fitting(draw, section, key, hints[key]) if fits else value(draw)
        lines.append(f"[{section}]\n{key} = {_toml(chosen)}\n")
    text = "".join(dict((line.split("\n")[0], line) for line in lines).values())
    odd = (
        "a" + ".a" * 20_000 + " = 1\n",
        "x = [" * 3000,
        "[" * 5000,
        "\0",
        "[topics]\njoints = '''",
        "a = 1979-05-27\n",
    )
    return text + draw.of(odd) if draw.hostile(0.1) else text


def _toml(content: Any) -> str:
    if isinstance(content, bool):
        return str(content).lower()
    if isinstance(content, float):
        return repr(content)
    if isinstance(content, list):
        return "[" + ", ".join(map(_toml, content)) + "]"
    if isinstance(content, dict):
        return "{" + ", ".join(f"{json.dumps(k)} = {_toml(v)}" for k, v in content.items()) + "}"
    return json.dumps(content) if isinstance(content, str) else str(content)


TYPED: dict[str, tuple[str, ...]] = {
    "--rate": ("50", "0.1", "0", "1e-3", "1e6", "1e15", "nan"),
    "--method": ("filter", "smoother", "ekf", "kalman", "predictive-coding", "x"),
    "--with": ("encoders", "encoders,vision", "vision", "touch", ",", "x"),
    "--without": ("vision", "encoders", "touch", "encoders,vision,touch", ""),
    "--precision": ("model", "fixed", "auto", "x"),
    "--bias": ("on", "off", "auto"),
    "--touch": ("literal", "likelihood"),
    "--step": ("explicit", "implicit"),
    "--preset": ("paper", "default"),
    "--delay": ("off", "auto", "camera=0.05", "camera=-1", "joints=3600", "camera=1e300", "=", "x=1,x=2"),
    "--clock-offset": ("auto", "0.1", "-1e300", "1e999"),
}
"""Options of estimate, and what may be typed behind them."""


def typed(draw: Draw) -> list[str]:
    """Some options of `estimate`."""
    out: list[str] = []
    for _ in range(draw.random.randint(0, 2)):
        name = draw.of(tuple(TYPED))
        content = draw.of(TYPED[name]) if draw.random.random() < 0.9 else str(value(draw, 2))[:400].replace("\0", "")
        out += [name, content]
    return out


def write(draw: Draw, path: Path) -> list[str]:
    """Write a robot.toml to `path`; returns further command-line options."""
    path.write_bytes(toml(draw).encode("utf-8", "replace"))
    return typed(draw)
