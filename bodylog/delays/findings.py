"""Whether a log's images are late against its joints:
by a body, or by one learned from the log itself.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice
from math import ceil
from pathlib import Path
from typing import Any

from ..body_model import BodyModel
from ..checks import require_same_camera, require_same_size
from ..errors import InputError
from ..estimation.timing import correction
from ..estimation.timing.delay_profile import Delay
from ..features.defaults import features_of_body, search_again_without_default
from ..features.observed import add_recorded_joints, moving_features
from ..recording import recording
from ..recording.tidy import cut_to_window
from ..settings import Settings
from ..types import Fault, Features, Finding, LazyImage, Recording, Score
from . import camera_delay
from .flow import measure_flow_delays
from .flow_delay import MIN_EVIDENCE_NATS

MAX_DURATION_S = 60.0
"""s in the middle of a log that are used: a delay is known to milliseconds after 20 s of motion."""
MAX_IMAGES = 600
"""Most images of each camera that are searched, evenly spread."""
MOST_FLOW_IMAGES = 6000
"""Most images of each camera between which flow is measured:
all of a minute at 100 Hz, as motion needs neighbours.
"""


@dataclass(frozen=True, eq=False)
class ExaminedDelays:
    """Delays of cameras with standard errors (s) as scores, what was found about them, and what
    differs from the logs that a body was learned from.

    changes: what each camera weighed about that, by which several logs are judged together.
    row_shares {name of a delay: (s of delay per s of row time, row time (s) of that delay and its
    standard error)}.
    """

    scores: tuple[Score, ...] = ()
    findings: tuple[Finding, ...] = ()
    faults: tuple[Fault, ...] = ()
    changes: Mapping[str, Any] = field(default_factory=dict)
    row_shares: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)


def measure_image_delays(log: Path, body: BodyModel | None, settings: Settings) -> ExaminedDelays:
    """Measure the delay of each camera's timestamps
    relative to the encoders; nothing with `delay` off.

    With a body, InputError where its cameras are not those
    of the log; without one, a finding says what is missing.
    """
    if settings.time.delay == "off":
        return ExaminedDelays()
    try:
        by_marker = _examine_by_body(log, body, settings)
    except InputError as problem:
        if body is not None:
            raise
        text = str(problem).removeprefix(f"{log}: ").partition("; ")[0]
        by_marker = ExaminedDelays(
            (), (Finding("info", f"{log}: camera delays are not measured: {text}"),)
        )
    if body is not None or by_marker.scores:
        return by_marker
    by_flow = _examine_by_flow(log, settings)
    return by_flow if by_flow.scores else ExaminedDelays((), by_marker.findings or by_flow.findings)


def _examine_by_flow(log: Path, settings: Settings) -> ExaminedDelays:
    """Delays by the motion of the whole picture; a
    finding for each camera of which it does not tell one.
    """
    read = middle_of_recording(
        recording.read_recording(log, settings, settings.input.strict),
        MAX_DURATION_S,
        MOST_FLOW_IMAGES,
    )
    measured = list(measure_flow_delays(read))
    expected = _given_delays(settings, tuple(one.camera for one in measured))
    rest: dict[str, Delay] = {}
    unclear = list[Finding]()
    for one in measured:
        if one.found is None:
            unclear.append(
                Finding(
                    "info", f"{log}: {one.camera}: too few images or joints for a delay by flow"
                )
            )
        elif one.found.certain:
            late = one.found.delay
            rest[one.camera] = replace(late, seconds=late.seconds - expected.get(one.camera, 0.0))
        else:
            why = f"{one.found.nats:.0f} nats of evidence, {MIN_EVIDENCE_NATS:.0f} are needed"
            text = f"{log}: {one.camera}: no delay by the picture's motion: {why}"
            unclear.append(Finding("info", text))
    delay_findings = [
        replace(one, text=f"{log}: {one.text}")
        for one in _delay_difference_findings(rest, expected, "by the picture's motion")
    ]
    return ExaminedDelays(tuple(_delay_scores(rest, expected)), (*delay_findings, *unclear))


def _examine_by_body(log: Path, body: BodyModel | None, settings: Settings) -> ExaminedDelays:
    settings = settings if body is None else features_of_body(body, settings)
    read, features = _middle_observed(log, settings, body is None)
    if (
        features.joints is None
        or features.poses
        or (read.cameras.frames is None and not features.tracks)
    ):
        text = f"{log}: camera delays are not measured: it has no moving joints with images"
        return ExaminedDelays((), () if body is None else (Finding("info", text),))
    names = correction.list_track_cameras(
        [*features.tracks, *(() if body is None else body.senses)]
    )
    expected = {
        **({} if body is None else correction.read_learned_delays(body)),
        **_given_delays(settings, names),
    }
    timely = correction.shift_features(features, expected)
    if body is None:
        found, unclear = camera_delay.measure_log_delays(timely, read.facts.settings)
    else:
        require_same_camera(log, body.provenance.get("cameras", ()), read, features)
        require_same_size(log, body, features, settings)
        every = correction.measure_camera_delays(timely, body)
        found = {name: one for name, one in every.items() if not one.doubt}
        unclear = {name: one for name, one in every.items() if one.doubt}
    by = "by the body learned from this log" if body is None else "by the body given"
    some = (
        *_delay_difference_findings(found, expected, by),
        *_unmeasured_findings(names, found, unclear, expected, body is None),
    )
    texts = [replace(one, text=f"{log}: {one.text}") for one in some]
    return ExaminedDelays(tuple(_delay_scores({**found, **unclear}, expected)), tuple(texts))


def _given_delays(settings: Settings, names: tuple[str, ...]) -> dict[str, float]:
    """Delays (s) that the settings give."""
    return correction.select_fixed_delays(settings.time.delay, names)


def _delay_scores(found: Mapping[str, Delay], expected: Mapping[str, float]) -> Iterator[Score]:
    for name, rest in found.items():
        yield Score(f"delay/{name}", expected.get(name, 0.0) + rest.seconds, "s", rest.std_error)
        yield Score(f"std/delay/{name}", rest.std_error, "s")


def _delay_difference_findings(
    found: Mapping[str, Delay], expected: Mapping[str, float], by: str
) -> Iterator[Finding]:
    """A warning for each delay that differs from the expected one (s), else information."""
    for name, rest in found.items():
        known = expected.get(name, 0.0)
        text = f"{name}: {correction.describe_delay(known + rest.seconds, rest.std_error)}, {by}"
        if not correction.is_significant(rest):
            yield Finding(
                "info", f"{text}; {f'{known:g} s is expected' if known else 'not significant'}"
            )
        elif name in expected:
            yield Finding(
                "warning",
                f"{text}, not {known:g} s; type --delay {name}={known + rest.seconds:.4f}",
            )
        else:
            yield Finding("warning", f"{text}; fit and estimate measure and correct it")


def _unmeasured_findings(
    names: tuple[str, ...],
    found: Mapping[str, Delay],
    unclear: Mapping[str, Delay],
    expected: Mapping[str, float],
    alone: bool,
) -> Iterator[Finding]:
    """Information on each camera without a delay; `alone`: there was no body."""
    advice = "; with a body: bodylog doctor LOG --body BODY.npz" if alone else ""
    for name in (name for name in names if name not in found):
        why = "its images and the joints move too little, or not together"
        if name in unclear:
            late = expected.get(name, 0.0) + unclear[name].seconds
            text = correction.describe_delay(late, unclear[name].std_error)
            why = f"perhaps {text}, but {unclear[name].doubt or 'the body is no better with that'}"
        yield Finding("info", f"{name}: delay not measured: {why}{advice}")


def _middle_observed(log: Path, settings: Settings, guess: bool) -> tuple[Recording, Features]:
    """The middle of a log and what perception finds in it; `guess`: as pipeline.observe."""
    read = middle_of_recording(
        recording.read_recording(log, settings, settings.input.strict), MAX_DURATION_S, MAX_IMAGES
    )
    look = partial(moving_features, progress=None)
    found = look(read, settings)
    if guess:
        read, found = search_again_without_default(log, read, found, settings, look)
    return read, add_recorded_joints(read, found)


def middle_of_recording(read: Recording, longest_s: float, most_images: int) -> Recording:
    """The middle of a recording, at most longest_s, with at most most_images of each camera."""
    spare = max(0.0, 0.5 * (read.duration_s - longest_s))
    begin = spare
    end = read.duration_s - spare
    films = {"": read.cameras.frames, **read.cameras.views}
    counts = {
        name: _count_images(read, name) * min(1.0, longest_s / max(read.duration_s, longest_s))
        for name in films
    }
    few = {
        name: partial(_thin_frames, film, begin, end, max(1, ceil(counts[name] / most_images)))
        for name, film in films.items()
        if film is not None
    }
    cameras = replace(read.cameras, frames=few.pop("", None), views=few)
    signals = replace(
        read.signals,
        joints=None
        if read.signals.joints is None
        else cut_to_window(read.signals.joints, read.start_ns, (begin, end)),
        reference=None
        if read.signals.reference is None
        else cut_to_window(read.signals.reference, read.start_ns, (begin, end)),
    )
    return replace(read, signals=signals, cameras=cameras)


def _count_images(read: Recording, camera: str) -> int:
    """Images of a camera by its name, "" the first."""
    source = read.facts.roles.get(f"camera/{camera}".strip("/"), "")
    health = read.facts.health.get(source)
    return 0 if health is None else health.used


def _thin_frames(
    film: Callable[[], Iterator[LazyImage]], begin: float, end: float, every: int
) -> Iterator[LazyImage]:
    """Every `every`-th frame from begin to end (s)."""
    inside = (frame for frame in film() if begin <= frame.t <= end)
    return islice(inside, 0, None, every)
