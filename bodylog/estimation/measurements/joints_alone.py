"""Joints without a learned body: a body of encoders alone, and remarks on the quality of their readings."""

from collections.abc import Iterator, Sequence

import numpy as np

from ...body_model import BodyModel, Noise, TouchConstants
from ...errors import UsageError
from ...types import Finding, Series
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
    """Yield remarks on readings: gaps, repeats, joints without readings."""
    t, steps = joints.t, np.diff(joints.t)
    # longer than twenty usual steps, and half a second
    if len(steps) and (pause := steps > max(20.0 * np.median(steps), 0.5)).any():
        pauses = [f"{at:.3f} s for {long:.2f} s" for at, long in zip(t[:-1][pause], steps[pause], strict=True)]
        yield Finding("warning", f"joints: no reading from {listed(pauses, ' times')}")
    share = (np.diff(joints.values, axis=0) == 0.0).mean(axis=0) if len(t) > 1 else np.zeros(len(joints.names))
    if often := [f"{joints.names[j]} {share[j]:.0%}" for j in np.argsort(-share, kind="stable") if share[j] > 0.5]:
        yield Finding("info", f"joints: readings that repeat the one before: {listed(often)}, as at rest or in steps")
    if mute := _mute(joints):
        yield Finding("warning", f"joints: {', '.join(mute)}: no reading is a number")


def _mute(joints: Series) -> list[str]:
    return [name for name, y in zip(joints.names, joints.values.T, strict=True) if not np.isfinite(y).any()]
