"""Joints without a learned body: a body of encoders alone, and remarks on the quality of their readings."""

from collections.abc import Iterator, Sequence

import numpy as np

from ...body_model import BodyModel, Noise, TouchConstants
from ...errors import UsageError
from ...types import Finding, Series
from .track import ascending

STEP = 2.0 * np.pi / 4096.0
"""rad: the step of a 12-bit encoder, assumed for one that never moves."""
NAMED = 3
"""Joints or times named in one remark."""


def joints_body(joints: Series, wanted: tuple[str, ...] | None) -> BodyModel:
    """A body of all joints with readings, or those wanted, without other senses; UsageError for an unknown joint."""
    known = [name for name, y in zip(joints.names, joints.values.T, strict=True) if np.isfinite(y).any()]
    if unknown := [name for name in wanted or () if name not in known]:
        raise UsageError(f"[body] joints: found {unknown[0]!r}, possible: {', '.join(known)}; type: bodylog info LOG")
    names = tuple(wanted or known)
    # joints that never move keep this process noise, 1 rad²/s³; others learn theirs
    noise = Noise((STEP**2 / 12.0,) * len(names), {}, (1.0,) * len(names))
    return BodyModel(names, {}, noise, TouchConstants(1.0, 0.005), {})


def no_body_findings(cameras: Sequence[str]) -> Iterator[Finding]:
    """Yield the remark that no body is used, and which cameras are ignored."""
    unused = f"; images of {', '.join(cameras)} are not used: type --body body.npz, which fit writes" if cameras else ""
    text = f"no --body: encoders alone, which do not show constant offsets{unused}"
    yield Finding("warning" if cameras else "info", text)


def reading_findings(joints: Series) -> Iterator[Finding]:
    """Yield remarks on stamps and readings: steps back, repeats, gaps, joints without readings."""
    yield from _stamps(joints)
    columns = dict(zip(joints.names, joints.values.T, strict=True)) if len(joints.t) > 1 else {}
    share = {name: float(np.mean(np.diff(y) == 0.0)) for name, y in columns.items()}
    if often := {name: part for name, part in share.items() if part > 0.5}:
        most = sorted(often, key=lambda name: -often[name])
        some = ", ".join(f"{name} {often[name]:.0%}" for name in most[:NAMED])
        more = f" and {len(most) - NAMED} more" if len(most) > NAMED else ""
        yield Finding("info", f"joints: readings that repeat the one before: {some}{more}, as at rest or in steps")
    mute = [name for name, y in zip(joints.names, joints.values.T, strict=True) if not np.isfinite(y).any()]
    if mute:
        yield Finding("warning", f"joints: {', '.join(mute)}: no reading is a number")


def _stamps(joints: Series) -> Iterator[Finding]:
    t, rising = joints.t, ascending(joints.t)
    steps, sound = np.diff(t), t[rising]
    if (same := steps == 0.0).any():
        at = float(t[1:][same][0])
        yield Finding("warning", f"joints: {same.sum()} of {len(t)} stamps repeat the one before, first at {at:.3f} s")
    if (back := steps < 0.0).any():
        at, left = float(t[1:][back][0]), f"{(~rising).sum()} readings left out"
        yield Finding("warning", f"joints: stamps run backwards {back.sum()} times, first at {at:.3f} s; {left}")
    lasting = np.diff(sound)
    # longer than twenty usual steps, and half a second
    pauses = np.flatnonzero(lasting > max(20.0 * np.median(lasting), 0.5)) if len(lasting) else ()
    if len(pauses):
        some = ", ".join(f"{sound[k]:.3f} s for {lasting[k]:.2f} s" for k in pauses[:NAMED])
        more = f" and {len(pauses) - NAMED} times more" if len(pauses) > NAMED else ""
        yield Finding("warning", f"joints: no reading from {some}{more}")
