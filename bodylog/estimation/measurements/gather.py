"""Measurements of all senses: encoder rows by joint name, sightings by track, and counts of what was left out."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ...body_model import BodyModel
from ...errors import EvidenceError, LogError, ModelError, UsageError
from ...settings import Estimation
from ...types import Array, Features, Finding, Health, Series
from .contract import Sense
from .long_arrays import any_of_row, rows
from .records import Encoders, Evidence, Sighting
from .touch import Touch
from .track import Track, ascending, gap

SENSES: Mapping[str, Sense] = {
    "track": Track(),
    "touch": Touch(),
}
"""Senses other than encoders, in the order of gathering."""
FIRST = "camera"
"""Name of the first camera, whose tracks have no prefix."""


def gather(features: Features, body: BodyModel, settings: Estimation, whole: bool = True) -> Evidence:
    """Gather the measurements that the settings ask for; `whole`: all frames of one touch count as one sighting."""
    visual = [name for sense in SENSES.values() if sense.group == "vision" for name in sense.names(features, body)]
    wanted, joints = chosen(visual, body, settings), features.joints
    encoders, used = _encoders(joints, body.joints, wanted)
    sightings = list[Sighting]()
    for sense in SENSES.values():
        for name in (name for name in sense.names(features, body) if name in wanted):
            found = sense.read(name, features, body, whole)
            sightings.append(found.sighting)
            used[name] = found.health
    read = np.empty((0, len(body.joints))) if joints is None else joints.values[:, columns(joints, body.joints)]
    return Evidence(encoders, tuple(sightings), _first(joints, body.joints), used, (), read=read, joints=body.joints)


def sound(evidence: Evidence, features: Features, body: BodyModel, settings: Estimation) -> Evidence:
    """Keep the senses with measurements; EvidenceError where a named one, or every one, has none."""
    used, encoders = evidence.used, evidence.encoders
    findings = _check(
        used, settings.senses or (), features, silent(body.joints, encoders), chosen((), body, settings)
    )
    # touches out of time are a result: they stay, with their small weights
    kept = tuple(s for s in evidence.sightings if used[s.name].used or (s.name == "touch" and len(s.t)))
    if not kept and (encoders is None or not np.isfinite(encoders.values).any()):
        raise EvidenceError(f"no sense has measurements: {_counts(used)}; give a log with joints or an effector")
    return replace(evidence, sightings=kept, findings=(*evidence.findings, *findings))


def silent(names: tuple[str, ...], encoders: Encoders | None) -> list[str]:
    """Joints without any encoder reading."""
    return [n for j, n in enumerate(names) if encoders is None or not np.isfinite(encoders.values[:, j]).any()]


def chosen(visual: Iterable[str], body: BodyModel, settings: Estimation) -> set[str]:
    """Joints, tracks of `visual` and touch that the settings select; UsageError for an unknown name."""
    groups = {"encoders": list(body.joints), "vision": list(visual), "touch": ["touch"]}
    singles = {*body.joints, *body.senses, *groups["vision"]}
    for name in (*(settings.senses or ()), *settings.without):
        if name not in groups and name not in singles:
            raise UsageError(f"senses: {name!r} found, possible: {', '.join([*groups, *sorted(singles)])}")

    def spread(names: Iterable[str]) -> set[str]:
        return {single for name in names for single in groups.get(name, [name])}

    return spread(groups if settings.senses is None else settings.senses) - spread(settings.without)


def _encoders(
    joints: Series | None, names: tuple[str, ...], wanted: set[str]
) -> tuple[Encoders | None, dict[str, Health]]:
    if joints is None:
        return None, {"encoders": Health(0, 0)}
    values = joints.values[:, columns(joints, names)].astype(float)
    known = np.isfinite(values)
    # rows that hold only joints of other topics are no readings of these
    ours = rows(any_of_row(known) | ~any_of_row(np.isfinite(joints.values)))
    t, source, values, known = joints.t[ours], joints.source_ns[ours], values[ours], known[ours]
    rising, broken = ascending(t), ~any_of_row(known)
    used = [name in wanted for name in names]
    known = known & used
    values[~known] = np.nan
    keep = rows(rising & ~broken)
    reasons = {"time runs backwards": int((~rising).sum()), "not a number": int((rising & broken).sum())}
    for index in np.flatnonzero(used):
        reasons[f"without {names[index]}"] = int((~known[keep, index]).sum())
    use = int(any_of_row(known[keep]).sum())
    health = Health(len(t), use, {reason: count for reason, count in reasons.items() if count}, gap(t[keep]))
    return Encoders(t[keep], values[keep], source[keep]), {"encoders": health}


def camera(track: str) -> str:
    """Name of a track's camera."""
    return track.rpartition("/")[0] or FIRST


def columns(joints: Series, names: tuple[str, ...]) -> list[int]:
    """Column numbers of joints in a series; ModelError for a missing joint."""
    missing = [name for name in names if name not in joints.names]
    if missing:
        raise ModelError(
            f"joints: the body model knows {', '.join(names)}, but the log has {', '.join(joints.names)}: "
            f"{', '.join(missing)} missing; fit a body from a log of this robot"
        )
    return [joints.names.index(name) for name in names]


def _first(joints: Series | None, names: tuple[str, ...]) -> Array:
    """First finite reading (M,) of each joint, used or not: the initial belief."""
    first = np.full(len(names), np.nan)
    if joints is not None:
        for index, column in enumerate(joints.values[:, columns(joints, names)].T):
            known = np.isfinite(column)
            first[index] = column[known.argmax()] if known.any() else np.nan
    return first


def _check(
    used: Mapping[str, Health], named: tuple[str, ...], features: Features, silent: Sequence[str], wanted: set[str]
) -> tuple[Finding, ...]:
    """EvidenceError for a named sense or joint without measurements; a warning for others."""
    visual = {name for name in used if name not in ("encoders", "touch")}
    late = "touch" in used and "not synchronous" in used["touch"].rejected
    for name in named:
        joint = features.joints is not None and name in features.joints.names
        members = visual if name == "vision" else {"encoders"} if joint and name not in silent else {name}
        kept = any(used[member].used for member in members if member in used)
        if not kept and not (name == "touch" and late):
            raise EvidenceError(
                f"{name}: requested, but without measurements ({_counts(used)}; tracks: "
                f"{', '.join(features.tracks) or 'none'}); leave it out of the senses, or name its topic"
            )
    empty = [name for name, health in used.items() if health.seen and not health.used and name not in named]
    if not wanted.intersection(features.joints.names if features.joints is not None else ()):
        empty = [name for name in empty if name != "encoders"]
    outcome = {name: "not synchronous with the images" if name == "touch" and late else "left out" for name in empty}
    texts = (f"{name}: nothing usable ({_words(used[name])}), {outcome[name]}" for name in empty)
    return tuple(Finding("warning", text) for text in texts)


def _counts(used: Mapping[str, Health]) -> str:
    return "; ".join(f"{name}: {_words(health)}" for name, health in used.items()) or "no sense known to the body"


def _words(health: Health) -> str:
    reasons = ", ".join(f"{count} {reason}" for reason, count in health.rejected.items())
    return f"{health.used} of {health.seen} used" + (f", {reasons}" if reasons else "")


def start(evidence: Evidence, settings: Estimation, names: tuple[str, ...]) -> Array:
    """Initial mean (M,) rad: as set, or the first readings."""
    if settings.start is not None:
        if len(settings.start) != len(names):
            raise UsageError(f"start: {len(settings.start)} angles given, the body has {len(names)} joints")
        return np.array(settings.start, float)
    if np.isnan(evidence.first).any():
        unknown = ", ".join(name for name, angle in zip(names, evidence.first, strict=True) if np.isnan(angle))
        raise LogError(
            f"joints: no reading of {unknown}; type in robot.toml [estimate] start = "
            f"[{', '.join(['0.0'] * len(names))}], the angles in rad of {', '.join(names)}"
        )
    return evidence.first
