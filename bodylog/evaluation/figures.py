"""Figures that bounds may name beside scores: faults by kind and joint, delays, shares used."""

from collections.abc import Iterator, Mapping, Sequence

from ..fault_kinds import ENCODER_OFFSET, FORMS, Fault, FaultKind
from ..types import Estimate, Score

SCORED_KINDS = (ENCODER_OFFSET, *(kind for (_, kind), form in FORMS.items() if form.scored))
"""Kinds that are scored by 0 where they are not found."""
KINDS_NEEDING_IMAGES = (
    ENCODER_OFFSET,
    *(kind for (_, kind), form in FORMS.items() if form.needs_images),
)
"""Kinds found only with images, by methods that look for them; otherwise NaN."""
CAMERA = "camera"
"""Name of the first camera, whose tracks are named plainly."""
MEASURED_DELAYS = "delay_measured"
"""Key of an estimate's settings: {camera: seconds,
std_error, doubt (why it is not applied, or ""), evident}.
"""
LEAST_OFFSETS = "least_offsets"
"""Key of an estimate's settings by the robot's surface: {joint: smallest offset, in `unit`, that it
would show, or None where it shows none}."""
MISFIT = "misfit"
"""Key of an estimate's settings where the log does not
fit the body: text, share off, explanation or None.
"""


def list_figures(found: Estimate) -> tuple[Score, ...]:
    """Figures beside the scores: 0 for a fault or delay that was not found."""
    return (*_fault_figures(found), *_delay_figures(found), *_used_share_figures(found))


def _fault_figures(found: Estimate) -> Iterator[Score]:
    """The largest size per kind and joint or track; 1 for
    faults without a size, NaN where none can be found.
    """
    yield Score("faults", float(len(found.faults)), "1")
    tracks = [name for name in found.used if name not in ("encoders", "touch")]
    sought = found.can.repairs and any(found.used[name].used for name in tracks)
    faults = [fault for fault in found.faults if fault.kind != FaultKind.DISPLACED]
    for name in dict.fromkeys(
        (*found.joints.names, *tracks, *(n for f in faults for n in f.names))
    ):
        joint = name in found.joints.names
        others = (f.kind for f in faults if name in f.names)
        for kind in dict.fromkeys((*SCORED_KINDS, *others)):
            own = [f for f in found.faults if name in f.names and kind in _scored_kinds(f)]
            unit = own[0].unit if own else "rad" if joint else "px"
            form = FORMS.get(("encoders", FaultKind(kind))) if kind != ENCODER_OFFSET else None
            unit = form.unit or unit if joint and form is not None else unit
            open_ = not own and kind in KINDS_NEEDING_IMAGES and not sought
            yield Score(
                f"fault/{kind}/{name}", float("nan") if open_ else _greatest_fault_size(own), unit
            )
    cameras = [name.rpartition("/")[0] or CAMERA for name in tracks]
    displaced = FaultKind.DISPLACED
    for name in dict.fromkeys(cameras):
        own = [fault for fault in found.faults if (fault.kind, fault.name) == (displaced, name)]
        unit = own[0].unit if own else FORMS["vision", displaced].unit
        yield Score(f"fault/{displaced}/{name}", _greatest_fault_size(own), unit)


def _greatest_fault_size(faults: Sequence[Fault]) -> float:
    sizes = [abs(fault.size) or 1.0 for fault in faults]
    return float("nan") if any(size != size for size in sizes) else max(sizes, default=0.0)


def _scored_kinds(fault: Fault) -> tuple[str, ...]:
    """What a fault counts as in scores."""
    return (fault.kind, ENCODER_OFFSET) if fault.form.offset else (fault.kind,)


def list_delays(found: Estimate) -> Iterator[Score]:
    """Delay ± standard error of each camera where one was
    measured, applied or not; else the one that is applied.
    """
    applied, measured = (found.settings.get(key, {}) for key in ("delay", MEASURED_DELAYS))
    for name, one in measured.items() if isinstance(measured, Mapping) else ():
        yield Score(f"delay/{name}", float(one["seconds"]), "s", float(one["std_error"]))
    for name, late in applied.items() if isinstance(applied, Mapping) else ():
        if name not in measured and name != "joints":
            yield Score(f"delay/{name}", float(late), "s")


def doubtful_delays(found: Estimate) -> Iterator[tuple[str, float, float, str]]:
    """Yield cameras whose delay (s) ± standard error is evident, but not applied, and why."""
    measured = found.settings.get(MEASURED_DELAYS, {})
    for name, one in measured.items() if isinstance(measured, Mapping) else ():
        if one["evident"] and one["doubt"]:
            yield name, float(one["seconds"]), float(one["std_error"]), str(one["doubt"])


def _delay_figures(found: Estimate) -> Iterator[Score]:
    """Delay of each camera that is applied or in doubt, s."""
    applied = found.settings.get("delay", {})
    doubtful = {name: late for name, late, *_ in doubtful_delays(found)}
    known = {**(applied if isinstance(applied, Mapping) else {}), **doubtful}
    cameras = [
        name.rpartition("/")[0] or "camera"
        for name in found.used
        if name not in ("encoders", "touch")
    ]
    for name in dict.fromkeys((*cameras, *known)):
        yield Score(f"delay/{name}", float(known.get(name, 0.0)), "s")


def _used_share_figures(found: Estimate) -> Iterator[Score]:
    """Share of each sense's measurements that was used."""
    for sense, health in sorted(found.used.items()):
        yield Score(f"used_share/{sense}", health.used / health.seen if health.seen else 0.0, "1")
