"""Hostile URDFs: invalid trees, joints that follow one another, numbers and texts of any kind."""

from pathlib import Path
from xml.sax.saxutils import quoteattr

from .grammar import FLOATS, TEXTS, Draw


def write(draw: Draw, path: Path) -> None:
    """An arm of some joints with hostile links, kinds, origins, axes, limits and followers."""
    count = draw.of((2, 3, 7, 40, 900)) if draw.hostile() else 3
    parts = [f"<link name={_name(draw, f'link{k}')}/>" for k in range(count + 1)]
    parts += [_joint(draw, k, count) for k in range(count)]
    if draw.hostile():
        draw.random.shuffle(parts)
    text = f"<robot name={_name(draw, 'arm')}>{''.join(parts)}</robot>"
    if draw.hostile(0.5):
        odd = ("<!DOCTYPE r [<!ENTITY a 'x'>]>" + text, text[:-9], "<a>" * 5000, text * 2, "", "\0", "<robot/>")
        text = draw.of(odd)
    path.write_text(text, encoding="utf-8", errors="replace")


def _joint(draw: Draw, number: int, count: int) -> str:
    parent, child = number, number + 1
    if draw.hostile():
        parent, child = draw.random.randint(0, count + 1), draw.random.randint(0, count + 1)
    kind = draw.of(("fixed", "prismatic", "continuous", "floating", "x", "")) if draw.hostile() else "revolute"
    inner = f'<parent link="link{parent}"/><child link="link{child}"/>'
    inner += f"<origin xyz={_three(draw, '0 0 0.2')} rpy={_three(draw, '0 0 0')}/><axis xyz={_three(draw, '0 1 0')}/>"
    inner += f"<limit lower={_number(draw, '-3')} upper={_number(draw, '3')}/>"
    if draw.hostile(2.0):
        inner += f'<mimic joint="joint_{draw.random.randint(0, count)}" multiplier={_number(draw, "1")}/>'
    return f'<joint name={_name(draw, f"joint_{number}")} type="{kind}">{inner}</joint>'


def _name(draw: Draw, usual: str) -> str:
    return quoteattr("".join(c for c in draw.text(usual) if c.isprintable()))


def _three(draw: Draw, usual: str) -> str:
    if not draw.hostile():
        return quoteattr(usual)
    return quoteattr(draw.of(("", "1", "a b c", "1 2 3 4", " ".join(str(draw.of(FLOATS)) for _ in range(3)))))


def _number(draw: Draw, usual: str) -> str:
    if not draw.hostile():
        return quoteattr(usual)
    return quoteattr("".join(c for c in draw.of((*map(str, FLOATS), *TEXTS)) if c.isprintable()))
