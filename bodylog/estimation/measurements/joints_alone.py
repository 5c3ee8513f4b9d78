"""Joints without a learned body: a body of encoders alone, and remarks on the quality of their readings."""

from collections.abc import Iterator, Sequence

import numpy as np

from ...body_model import BodyModel, Noise, TouchConstants
from ...errors import UsageError
from ...types import Finding, Series
from .track import ascending
from .wording import listed

STEP = 2.0 * np.pi / 4096.0
"""rad: the step of a 12-bit encoder, assumed for one that never moves."""


def joints_body(joints: Series, wanted: tuple[str, ...] | None) -> BodyModel:
    """A body of all joints with readings, or those wanted, without other senses; UsageError for an unknown joint."""
    mute = _mute(joints)
    known = [name for name in joints.names if name not in mute]
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
    yield from (Finding("warning", f"joints: {text}") for text in _stamps(joints))
    share = (np.diff(joints.values, axis=0) == 0.0).mean(axis=0) if len(joints.t) > 1 else np.zeros(len(joints.names))
    if often := [f"{joints.names[j]} {share[j]:.0%}" for j in np.argsort(-share, kind="stable") if share[j] > 0.5]:
        yield Finding("info", f"joints: readings that repeat the one before: {listed(often)}, as at rest or in steps")
    if mute := _mute(joints):
        yield Finding("warning", f"joints: {', '.join(mute)}: no reading is a number")


def _mute(joints: Series) -> list[str]:
    return [name for name, y in zip(joints.names, joints.values.T, strict=True) if not np.isfinite(y).any()]


def _stamps(joints: Series) -> Iterator[str]:
    t, rising = joints.t, ascending(joints.t)
    steps, lasting = np.diff(t), np.diff(t[rising])
    if (same := steps == 0.0).any():
        yield f"{same.sum()} of {len(t)} stamps repeat the one before, first at {t[1:][same][0]:.3f} s"
    if (back := steps < 0.0).any():
        left = f"{(~rising).sum()} readings left out"
        yield f"stamps run backwards {back.sum()} times, first at {t[1:][back][0]:.3f} s; {left}"
    # longer than twenty usual steps, and half a second
    if len(lasting) and (pause := lasting > max(20.0 * np.median(lasting), 0.5)).any():
        pauses = zip(t[rising][:-1][pause], lasting[pause], strict=True)
        yield f"no reading from {listed([f'{at:.3f} s for {long:.2f} s' for at, long in pauses], ' times')}"
