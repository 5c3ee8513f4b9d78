"""Panels as plain JSON values: arrays thinned to a budget of points, quantised and in base64."""

import base64
import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from ...types import Array, Estimate, Features
from .decimate import extreme_indices, thin_band
from .traces import EVENTS, Panel, PlotTrace

POINT_BUDGET = 130_000
"""Points kept on a whole page; each costs 11 characters, of a band 16."""

_MOST = 4000
_LEAST = 60
_TICKS = 2**32 - 1
_DANGEROUS = str.maketrans({"<": "\\u003c", ">": "\\u003e", "&": "\\u0026"})


def most_points(panels: Sequence[Panel]) -> int:
    """How many points each trace may keep so that the page stays within its budget."""
    return min(
        _MOST, max(_LEAST, POINT_BUDGET // max(1, sum(len(panel.traces) for panel in panels)))
    )


def panels_as_json(
    panels: Sequence[Panel], marks: Sequence[dict[str, Any]], duration: float, unit: str = "s"
) -> dict[str, Any]:
    """{span (2,) s · unit · marks over every panel · panels} with every number finite.

    Without a unit t is the number of a pose, and duration the number of poses.
    """
    span = _time_span(duration, panels) if unit else [0.5, duration + 0.5]
    points = most_points(panels)
    return {
        "span": span,
        "unit": unit,
        "marks": list(marks),
        "panels": [_panel_as_json(panel, span, points) for panel in panels],
    }


def background_marks(features: Features, estimate: Estimate) -> list[dict[str, Any]]:
    """Marks in the background of every panel: touches, strokes, and the start of each fault."""
    felt = [(x.onset, x.offset, "felt") for x in (features.touches or ())[:EVENTS]]
    seen = [(x.start, x.end, "seen") for x in features.strokes[:EVENTS]]
    faults = [(x.since, x.since, "fault") for x in estimate.faults[:EVENTS]]
    finite = [mark for mark in (*felt, *seen, *faults) if np.isfinite(mark[:2]).all()]
    return [{"from": round(a, 4), "to": round(b, 4), "ink": ink} for a, b, ink in finite]


def embed_json(values: Any) -> str:
    """JSON without characters that HTML treats as tags, entities or line ends; deterministic."""
    text = json.dumps(
        values, ensure_ascii=True, allow_nan=False, sort_keys=True, separators=(",", ":")
    )
    return text.translate(_DANGEROUS)


def _time_span(duration: float, panels: Sequence[Panel]) -> list[float]:
    ends = [trace.t[[0, -1]] for panel in panels for trace in panel.traces if len(trace.t)]
    low = min([0.0, *(float(pair[0]) for pair in ends)])
    high = max([duration, *(float(pair[1]) for pair in ends)])
    return [low, high if high > low else low + 1.0]


def _panel_as_json(panel: Panel, span: list[float], points: int) -> dict[str, Any]:
    rows = [
        {"name": x.name, "ink": x.ink, "spans": [[round(t, 4) for t in s] for s in x.spans]}
        for x in panel.rows
    ]
    traces = [_trace_as_json(trace, span, points) for trace in panel.traces if len(trace.t)]
    look = {"half": panel.half, "limits": panel.limits, "floor": panel.floor, "shade": panel.shade}
    return look | {"title": panel.title, "rows": rows, "traces": traces}


def _trace_as_json(trace: PlotTrace, span: list[float], points: int) -> dict[str, Any]:
    """The thinned trace: t as uint32 shares of the span and y as float32, both little endian."""
    look = {"name": trace.name, "ink": trace.ink, "kind": trace.kind}
    if trace.high is not None:
        t, low, high = thin_band(trace.t, trace.y, trace.high, points)
        return look | {
            "t": _encode_times(t, span),
            "y": _encode_floats(low),
            "high": _encode_floats(high),
        }
    keep = extreme_indices(trace.y, points)
    return look | {"t": _encode_times(trace.t[keep], span), "y": _encode_floats(trace.y[keep])}


def _encode_times(t: Array, span: list[float]) -> str:
    share = np.clip((t - span[0]) / (span[1] - span[0]), 0.0, 1.0)
    return base64.b64encode(np.rint(share * _TICKS).astype("<u4").tobytes()).decode()


def _encode_floats(y: Array) -> str:
    drawable = np.abs(y) < float(np.finfo(np.float32).max)  # values beyond float32 become gaps
    return base64.b64encode(np.where(drawable, y, np.nan).astype("<f4").tobytes()).decode()
