"""Measurements of all senses: encoder rows by joint name,
sightings by track, and counts of what was left out.
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from ...body_model import BodyModel
from ...errors import EvidenceError, LogError, ModelError, UsageError
from ...settings import EstimationSettings
from ...types import Array, Features, Finding, Health, Series
from . import posture, touch, track
from .long_arrays import index_true_rows
from .reading_units import find_joint_unit
from .records import Encoders, Evidence, Sense, build_health
from .track import find_ascending_times, find_longest_gap

SENSES: tuple[tuple[str, Sense], ...] = (
    ("vision", track.read_tracks),
    ("vision", posture.read_postures),
    ("touch", touch.read_touch),
)
"""Senses other than encoders, each with the group it belongs to, in the order of gathering."""


def gather_measurements(
    features: Features, body: BodyModel, settings: EstimationSettings
) -> Evidence:
    """Gather the measurements that the settings ask for."""
    groups = [(group, sense(features, body)) for group, sense in SENSES]
    wanted = choose_senses(
        [name for group, found in groups if group == "vision" for name in found], body, settings
    )
    joints = features.joints
    encoders = None
    used = {"encoders": Health(0, 0)}
    read = np.empty((0, len(body.joints)))
    if joints is not None:
        read = joints.values[:, find_joint_columns(joints, body.joints)]
        encoders, used["encoders"] = _select_encoder_rows(joints, read, body.joints, wanted)
    measured = {name: one for _, found in groups for name, one in found.items() if name in wanted}
    used |= {name: one.health for name, one in measured.items()}
    sightings = tuple(one.sighting for one in measured.values())
    unit, size = find_joint_unit(joints) if "encoders" not in body.senses else ("rad", 1.0)
    return Evidence(
        encoders, sightings, used, (), read=read, joints=body.joints, unit=unit, rad_per_unit=size
    )


def require_measurements(
    evidence: Evidence, features: Features, body: BodyModel, settings: EstimationSettings
) -> Evidence:
    """Keep the senses with measurements; EvidenceError where a named one, or each, lacks them."""
    used = evidence.used
    encoders = evidence.encoders
    apart = [
        text
        for reason, text in touch.REASONS_WITHOUT_WEIGHT.items()
        if "touch" in used and reason in used["touch"].rejected
    ]
    read = set(features.joints.names if features.joints is not None else ())
    members = {name: {"encoders"} for name in read.difference(list_unread_joints(evidence))}
    members["vision"] = used.keys() - {"encoders", "touch"}
    for name in settings.senses or ():
        kept = any(used[member].used for member in members.get(name, {name}) if member in used)
        if not kept and not (name == "touch" and apart):
            raise EvidenceError(
                f"{name}: requested, but without measurements ({_describe_counts(used)}; tracks: "
                f"{', '.join(features.tracks) or 'none'}); leave it out of the senses, or "
                "name its topic"
            )
    # touches out of time or of place are a result: they stay, with their small weights
    sightings = tuple(
        s for s in evidence.sightings if used[s.name].used or (s.name == "touch" and len(s.t))
    )
    if not sightings and (encoders is None or not np.isfinite(encoders.values).any()):
        raise EvidenceError(
            f"no sense has measurements: {_describe_counts(used)}; give a log with joints or "
            "an effector"
        )
    unused = {
        name
        for name, one in used.items()
        if one.seen and not one.used and name not in (settings.senses or ())
    }
    unused -= set() if read & choose_senses((), body, settings) else {"encoders"}
    outcome = {"touch": " or ".join(apart)} if apart else {}
    texts = (
        f"{n}: nothing usable ({_describe_health(used[n])}), {outcome.get(n, 'left out')}"
        for n in used
        if n in unused
    )
    findings = tuple(Finding("warning", text) for text in texts)
    return replace(evidence, sightings=sightings, findings=(*evidence.findings, *findings))


def list_unread_joints(evidence: Evidence) -> list[str]:
    """Joints without any encoder reading."""
    if evidence.encoders is None:
        return list(evidence.joints)
    columns = zip(evidence.joints, evidence.encoders.values.T, strict=True)
    return [name for name, column in columns if not np.isfinite(column).any()]


def choose_senses(visual: Iterable[str], body: BodyModel, settings: EstimationSettings) -> set[str]:
    """Joints, tracks of `visual` and touch that the
    settings select; UsageError for an unknown name.
    """
    groups = {"encoders": list(body.joints), "vision": list(visual), "touch": ["touch"]}
    surface = () if body.surface is None else (one.sense for one in body.surface.cameras)
    singles = {*body.joints, *body.senses, *surface, *groups["vision"]}
    for name in (*(settings.senses or ()), *settings.without):
        if name not in groups and name not in singles:
            raise UsageError(
                f"senses: {name!r} found, possible: {', '.join([*groups, *sorted(singles)])}"
            )

    def expand_groups(names: Iterable[str]) -> set[str]:
        return {single for name in names for single in groups.get(name, [name])}

    asked = groups if settings.senses is None else settings.senses
    return expand_groups(asked) - expand_groups(settings.without)


def _select_encoder_rows(
    joints: Series, read: Array, names: tuple[str, ...], wanted: set[str]
) -> tuple[Encoders, Health]:
    """The encoder rows of the joints `names` (M,),
    with values read (N,M); NaN for those not `wanted`.
    """
    known = np.isfinite(read)
    # rows that hold only joints of other topics are no readings of these
    ours = index_true_rows(np.asarray(known.any(axis=1) | ~np.isfinite(joints.values).any(axis=1)))
    t = joints.t[ours]
    source = joints.source_ns[ours]
    values = read[ours].astype(float)
    known = known[ours]
    rising = find_ascending_times(t)
    broken = ~known.any(axis=1)
    used = [name in wanted for name in names]
    known = known & used
    values[~known] = np.nan
    keep = index_true_rows(rising & ~broken)
    reasons = {"time runs backwards": (~rising).sum(), "not a number": (rising & broken).sum()}
    reasons |= {f"without {names[j]}": (~known[keep, j]).sum() for j in np.flatnonzero(used)}
    found = Encoders(t[keep], values[keep], source[keep])
    return found, build_health(
        len(t), known[keep].any(axis=1).sum(), reasons, find_longest_gap(found.t)
    )


def find_joint_columns(joints: Series, names: tuple[str, ...]) -> list[int]:
    """Column numbers of joints in a series; ModelError for a missing joint."""
    missing = [name for name in names if name not in joints.names]
    if missing:
        raise ModelError(
            f"joints: the body model knows {', '.join(names)}, but the log has "
            f"{', '.join(joints.names)}: "
            f"{', '.join(missing)} missing; fit a body from a log of this robot"
        )
    return [joints.names.index(name) for name in names]


def _describe_counts(used: Mapping[str, Health]) -> str:
    return (
        "; ".join(f"{name}: {_describe_health(one)}" for name, one in used.items())
        or "no sense known to the body"
    )


def _describe_health(found: Health) -> str:
    return ", ".join(
        [f"{found.used} of {found.seen} used", *(f"{n} {why}" for why, n in found.rejected.items())]
    )


def read_given_start(settings: EstimationSettings, names: tuple[str, ...]) -> Array | None:
    """Initial mean (M,) rad as set; UsageError for another number of angles."""
    if settings.start is not None and len(settings.start) != len(names):
        raise UsageError(
            f"start: {len(settings.start)} angles given, the body has {len(names)} joints"
        )
    return None if settings.start is None else np.array(settings.start, float)


def choose_initial_angles(evidence: Evidence, settings: EstimationSettings) -> Array:
    """Initial mean (M,) rad: as set, or each joint's
    first sound reading, else its first one, used or not.
    """
    names = evidence.joints
    if (given := read_given_start(settings, names)) is not None:
        return given
    known = np.isfinite(evidence.read)
    if unknown := [name for j, name in enumerate(names) if not known[:, j].any()]:
        raise LogError(
            f"joints: no reading of {', '.join(unknown)}; type in robot.toml [estimate] start = "
            f"[{', '.join(['0.0'] * len(names))}], the angles in rad of {', '.join(names)}"
        )
    sound = evidence.read[:0] if evidence.encoders is None else evidence.encoders.values
    readings: Array = np.concatenate([sound, evidence.read])
    return np.asarray(readings[np.isfinite(readings).argmax(axis=0), np.arange(len(names))])
