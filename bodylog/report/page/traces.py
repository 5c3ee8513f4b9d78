"""The page's plots: panels of traces over one time axis."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...overlay_style import OTHER, measurement_ink
from ...sources import group_of
from ...types import Array, Estimate, Features, Recording, Series

JOINTS = 24
TRACKS = 12
COLUMNS = 32
EVENTS = 2000
"""Most joints, tracks, lines of one panel, and touches or strokes drawn."""

_INKS = 8


@dataclass(frozen=True, eq=False)
class PlotTrace:
    """One line, dashes, dots, stems, or band or whiskers (y to high)
    of colour `ink` of the style sheet: t (n,) s · y, high (n,).
    """

    name: str
    ink: str
    t: Array
    y: Array
    kind: str = "line"
    high: Array | None = None


@dataclass(frozen=True)
class SpanRow:
    """Spans of time (s) drawn as bars in one row of a panel."""

    name: str
    ink: str
    spans: tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Panel:
    """Traces or rows under one title; `half` as wide as the
    page; y from `limits`, or at least from `floor`, shaded.
    """

    title: str
    traces: tuple[PlotTrace, ...] = ()
    rows: tuple[SpanRow, ...] = ()
    half: bool = False
    limits: tuple[float, float] | None = None
    floor: float | None = None
    shade: tuple[float, float] | None = None


def list_panels(recording: Recording, features: Features, estimate: Estimate) -> tuple[Panel, ...]:
    """All panels with content, in reading order."""
    if recording.signals.poses:
        return tuple(_pose_panels(recording, estimate))
    drawn = [
        *_belief_panels(recording, estimate),
        *_track_panels(features, estimate),
        *_touch_panels(recording, features),
    ]
    return tuple(
        panel
        for panel in drawn
        if panel.rows or any(np.isfinite(trace.y).any() for trace in panel.traces)
    )


def _pose_panels(recording: Recording, estimate: Estimate) -> Iterator[Panel]:
    """Of still poses: each joint's belief minus its reading, and the errors of each sense; points
    of one board share a panel.
    """
    for m, name in enumerate(estimate.joints.names[:JOINTS]):
        t = estimate.joints.t
        encoder = _line_trace(recording.signals.joints, name, "encoder", "encoder")
        read = np.interp(t, encoder[0].t, encoder[0].y) if encoder else np.zeros(len(t))
        off = 1e3 * (estimate.joints.values[:, m] - read)
        spread = 2e3 * np.sqrt(np.maximum(estimate.cov[:, m, m], 0.0))
        bars = PlotTrace("2σ", "belief", t, off - spread, "whiskers", off + spread)
        what = "minus its reading, mrad" if encoder else "mrad"
        dots = PlotTrace("belief", "belief", t, off, "dots")
        yield Panel(f"{name} {what}", (bars, dots), half=True)
    groups = dict[str, list[Series]]()
    for sense, errors in estimate.errors.items():
        groups.setdefault(group_of(sense), []).append(errors)
    for sense, each in groups.items():
        rows = np.concatenate([errors.values for errors in each])
        t = np.concatenate([errors.t for errors in each])
        order = np.argsort(t, kind="stable")
        names = enumerate(each[0].names[:COLUMNS])
        traces = [
            PlotTrace(name, f"c{d % _INKS}", t[order], rows[order, d], "dots") for d, name in names
        ]
        title = f"{sense}: prediction error, standard deviations"
        yield Panel(title, tuple(traces), shade=(-2.0, 2.0))


def _belief_panels(recording: Recording, estimate: Estimate) -> Iterator[Panel]:
    for m in range(len(estimate.joints.names[:JOINTS])):
        yield from _joint_panels(recording, estimate, m)
    for sense, errors in estimate.errors.items():
        yield Panel(
            f"{sense}: prediction error, standard deviations",
            _column_traces(errors, "dots"),
            shade=(-2.0, 2.0),
        )
    yield Panel(
        "free energy, nats",
        (PlotTrace("free energy", "c0", estimate.joints.t, estimate.free_energy),),
    )
    if estimate.bias is not None:
        yield Panel(
            f"encoder offset, {estimate.bias.unit}", _offset_traces(estimate, estimate.bias)
        )


def _offset_traces(estimate: Estimate, offsets: Series) -> tuple[PlotTrace, ...]:
    """The offsets of joints that faults name, or of all
    where none is named: a cause has one story on the page.
    """
    faults = (fault for fault in estimate.faults if fault.sense == "encoders")
    named = {joint for fault in faults for joint in fault.names} & set(offsets.names)
    return tuple(trace for trace in _column_traces(offsets) if trace.name in named or not named)


def _joint_panels(recording: Recording, estimate: Estimate, m: int) -> Iterator[Panel]:
    """The belief about one joint with its encoder, and
    the errors of both where there is a ground truth.
    """
    name = estimate.joints.names[m]
    t = estimate.joints.t
    mean = estimate.joints.values[:, m]
    spread = 2.0 * np.sqrt(np.maximum(estimate.cov[:, m, m], 0.0))
    encoder = _line_trace(recording.signals.joints, name, "encoder", "encoder")
    truth = _line_trace(recording.signals.truth, name, "truth", "truth")
    belief = (
        PlotTrace("2σ", "belief", t, mean - spread, "band", mean + spread),
        PlotTrace("belief", "belief", t, mean),
    )
    yield Panel(f"{name}, rad", (*encoder, *belief, *truth), half=bool(truth))
    for real in truth:
        off = tuple(
            PlotTrace(x.name, x.ink, x.t, x.y - np.interp(x.t, real.t, real.y))
            for x in (*encoder, belief[1])
        )
        band = PlotTrace("2σ", "belief", t, -spread, "band", spread)
        yield Panel(f"{name} minus truth, rad", (*off[:-1], band, off[-1]), half=True)


def _track_panels(features: Features, estimate: Estimate) -> Iterator[Panel]:
    for name, track in list(features.tracks.items())[:TRACKS]:
        ink = name.rpartition("/")[2] if measurement_ink(name) is not OTHER else "other"
        for d, axis in enumerate(track.names):
            expected = _line_trace(estimate.predicted.get(name), axis, "predicted", "predicted")
            band = _band_trace(estimate.predicted.get(name), axis)
            seen = PlotTrace("measured", ink, track.t, track.values[:, d], "dots")
            yield Panel(
                f"{name} {axis}, {track.unit}", (*band, *expected, seen), half=len(track.names) == 2
            )


def _touch_panels(recording: Recording, features: Features) -> Iterator[Panel]:
    if recording.signals.skin is not None and recording.signals.skin.values.size:
        strongest = np.fmax.reduce(recording.signals.skin.values, axis=1)
        yield Panel(
            "skin, 0..1",
            (PlotTrace("strongest cell", "felt", recording.signals.skin.t, strongest),),
        )
    touches = features.touches or ()
    strokes = tuple((x.start, x.end) for x in features.strokes)
    if touches or strokes:
        felt = SpanRow("felt", "felt", tuple((x.onset, x.offset) for x in touches[:EVENTS]))
        seen = SpanRow("seen", "seen", strokes[:EVENTS])
        yield Panel("touches felt, strokes seen", rows=(felt, seen), limits=(0.0, 2.0))
    if features.synchrony and touches:
        onset = np.array([touches[pair.touch].onset for pair in features.synchrony])
        weight = np.array([pair.weight for pair in features.synchrony])
        delay = np.array([pair.delay for pair in features.synchrony])
        yield Panel(
            "synchrony, 0..1",
            (PlotTrace("weight", "c4", onset, weight, "stems"),),
            limits=(0.0, 1.0),
            half=True,
        )
        yield Panel(
            "seen minus felt, s",
            (PlotTrace("delay", "c4", onset, delay, "stems"),),
            floor=0.0,
            half=True,
        )


def _column_traces(series: Series, kind: str = "line") -> tuple[PlotTrace, ...]:
    names = enumerate(series.names[:COLUMNS])
    return tuple(
        PlotTrace(name, f"c{d % _INKS}", series.t, series.values[:, d], kind) for d, name in names
    )


def _line_trace(series: Series | None, column: str, name: str, ink: str) -> tuple[PlotTrace, ...]:
    """The column as a trace, or () without it."""
    if series is None or column not in series.names or not len(series.t):
        return ()
    kind = "dashes" if ink == "truth" else "line"
    return (PlotTrace(name, ink, series.t, series.values[:, series.names.index(column)], kind),)


def _band_trace(series: Series | None, column: str) -> tuple[PlotTrace, ...]:
    """The column's 2-sigma band, or () without standard deviations."""
    if series is None or series.std is None or column not in series.names or not len(series.t):
        return ()
    d = series.names.index(column)
    low, high = (series.values[:, d] + k * series.std[:, d] for k in (-2.0, 2.0))
    return (PlotTrace("2σ", "predicted", series.t, low, "band", high),)
