"""Seen and predicted positions as foxglove_msgs/ImageAnnotations, drawn over the image."""

from collections.abc import Mapping

import numpy as np

from ..logs.encode import cdr
from ..logs.encode.cdr import CdrField, Payloads
from ..overlay_style import CORNERS, PREDICTED, ellipse_corners, measurement_ink
from ..types import Array, Series

_PREDICTED = (*PREDICTED.image, 1.0)
_CLEAR = (0.0, 0.0, 0.0, 0.0)
_LINE_LOOP = 2
_Circle = tuple[tuple[float, ...], float, Array]
"""Colour, diameter (px), centre (n,2) px."""


def draw_image_annotations(
    seen: Mapping[str, Series],
    predicted: Mapping[str, Series],
    cov: Mapping[str, Array],
    start_ns: int,
) -> tuple[Array, Payloads]:
    """Log times (n,) of all frames, and one ImageAnnotations for each: a circle per feature seen or
    predicted, and the prediction's 2-sigma ellipse."""
    tracks = [*seen.values(), *predicted.values()]
    times, first = np.unique(
        np.concatenate([track.source_ns for track in tracks]), return_index=True
    )
    stamp = start_ns + np.rint(np.concatenate([track.t for track in tracks])[first] * 1e9).astype(
        np.int64
    )
    circles: list[_Circle] = [
        ((*measurement_ink(name).image, 1.0), 16.0, _values_at_log_times(times, track))
        for name, track in seen.items()
    ]
    circles += [
        (_PREDICTED, 8.0, _values_at_log_times(times, track)) for track in predicted.values()
    ]
    loops = [
        _values_at_log_times(times, series, _ellipse_corners(series, cov[name]))
        for name, series in predicted.items()
        if name in cov
    ]
    return times, _serialise_by_layout(stamp, circles, loops)


def _values_at_log_times(times: Array, track: Series, values: Array | None = None) -> Array:
    """A track's values (n,D) at the common log times; NaN where it has none."""
    values = track.values if values is None else values
    out = np.full((len(times), values.shape[1]), np.nan)
    out[np.searchsorted(times, track.source_ns)] = values
    return out


def _ellipse_corners(series: Series, cov: Array) -> Array:
    """Corners (K,2*CORNERS) px of the 2-sigma ellipses
    of cov (K,2,2) px² around the predictions.
    """
    return ellipse_corners(series.values, cov).reshape(len(cov), -1)


def _serialise_by_layout(stamp: Array, circles: list[_Circle], loops: list[Array]) -> Payloads:
    """One serialisation per group of frames that
    show the same parts, and so have the same layout.
    """
    shown = np.column_stack(
        [np.isfinite(values).all(1) for values in [*(c[2] for c in circles), *loops]]
    )
    packed = np.packbits(shown, axis=1)
    # as one text each: sorting rows of bits is slow
    kind_of = packed.view(f"S{packed.shape[1]}")[:, 0]
    parts = []
    for rows in (np.flatnonzero(kind_of == number) for number in np.unique(kind_of)):
        kind = shown[rows[0]]
        round_parts = [c for c, there in zip(circles, kind, strict=False) if there]
        loop_parts = [
            loop for loop, there in zip(loops, kind[len(circles) :], strict=True) if there
        ]
        fields: list[CdrField] = [("uint32", len(round_parts))]
        for colour, diameter, centre in round_parts:
            fields += _circle_fields(stamp[rows], centre[rows], diameter, colour)
        fields.append(("uint32", len(loop_parts)))
        for loop in loop_parts:
            fields += _loop_fields(stamp[rows], loop[rows])
        fields.append(("uint32", 0))
        parts.append((rows, cdr.serialise_messages(len(rows), fields)))
    return cdr.merge_payloads(parts, len(stamp))


def _circle_fields(
    stamp: Array, centre: Array, diameter: float, colour: tuple[float, ...]
) -> list[CdrField]:
    shape = [diameter, 2.0, *_CLEAR, *colour]
    return [*cdr.cdr_time_field(stamp), ("float64*", centre), ("float64*", np.array([shape]))]


def _loop_fields(stamp: Array, corners: Array) -> list[CdrField]:
    return [
        *cdr.cdr_time_field(stamp),
        ("uint8", _LINE_LOOP),
        ("uint32", CORNERS),
        ("float64*", corners),
        ("float64*", np.array([_PREDICTED])),
        ("uint32", 0),
        ("float64*", np.array([[*_CLEAR, 1.5]])),
    ]
