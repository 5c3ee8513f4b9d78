"""The reprojection sheet: each board or marker in the image
plane, as measured, by kinematics alone and with the process.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import degrees, isfinite
from types import MappingProxyType
from typing import Any

import numpy as np

from ...overlay_style import PREDICTED, measurement_ink
from ...sources import group_of
from ...types import TRACK_AXES, Array, Estimate, Features, Series
from ..page.tables import escape_text, html_table
from .canvas import LINES, printable_label

TRACKS = 12
POINTS = 300
"""Most boards and markers that are drawn, and points of each."""
NO_SIZES: Mapping[str, tuple[int, int]] = MappingProxyType({})
_ZEROS = 64
_ALONE = LINES[4]
_BOTH = PREDICTED.plot
_RULE = "#6b7280"
_WIDTH = 460.0
_HEIGHT = 345.0
_SIDE = 345.0
_LONG = 0.06
"""Length of a large residual as drawn, as a share of the tracks' extent."""


@dataclass(frozen=True, eq=False)
class ReprojectionSheet:
    """One board or marker: measured, expected by kinematics alone and with the process, each (N,2)
    in `unit` along two axes; `both` is NaN for points of a board that are no sense. plane (2,2):
    the image's first and last corner, px; None where its size is unknown.
    """

    name: str
    measured: Array
    kinematics: Array
    both: Array
    plane: Array | None = None
    axes: tuple[str, str] = ("u", "v")
    unit: str = "px"

    def some(self) -> "ReprojectionSheet":
        """At most POINTS of it, evenly spaced."""
        rows = np.unique(
            np.linspace(0, len(self.measured) - 1, min(len(self.measured), POINTS))
            .round()
            .astype(int)
        )
        return replace(
            self,
            measured=self.measured[rows],
            kinematics=self.kinematics[rows],
            both=self.both[rows],
        )

    @property
    def limits(self) -> tuple[Array, Array]:
        """The corners of what is drawn of the image plane, px: the image, or where points were."""
        if self.plane is not None:
            return self.plane[0], self.plane[1]
        low = self.measured.min(axis=0)
        high = self.measured.max(axis=0)
        margin = np.maximum(0.08 * (high - low), 1.0 if self.unit == "px" else 1e-3)
        return low - margin, high + margin

    @property
    def errors(self) -> tuple[float, float]:
        """RMS residual of kinematics alone, and with the process."""
        return _rms_length(self.measured - self.kinematics), _rms_length(self.measured - self.both)

    @property
    def magnified(self) -> float:
        """Magnification of drawn residuals: 1, 2, 5, 10, …"""
        low, high = self.limits
        extent = float((high - low).max())
        size = max(
            float(np.quantile(np.linalg.norm(self.measured - self.kinematics, axis=1), 0.9)), 1e-6
        )
        most = max(_LONG * extent / size, 1.0)
        power = 10.0 ** np.floor(np.log10(most))
        return float(power * max(step for step in (1, 2, 5) if step * power <= most))


@dataclass(frozen=True)
class JointZero:
    """One joint's zero: value ± std in `unit` (rad or m);
    value is None where it is not identifiable, and why.
    """

    joint: str
    value: float | None
    std: float
    unit: str = "rad"
    confused: tuple[str, ...] = ()

    @property
    def shown(self) -> tuple[str, str]:
        """Value ± std in degrees and rad, or in mm and m; or why it is not identifiable."""
        if self.value is None:
            return f"not identifiable: {' and '.join(self.confused) or 'not seen'}", ""
        factor, unit = (degrees(1.0), "°") if self.unit == "rad" else (1e3, " mm")
        return (
            f"{factor * self.value:+.2f}{unit} ± {factor * self.std:.2f}{unit}",
            f"{self.value:+.5f} ± {self.std:.5f} {self.unit}",
        )


def build_sheets(
    features: Features, estimate: Estimate, sizes: Mapping[str, tuple[int, int]] = NO_SIZES
) -> tuple[ReprojectionSheet, ...]:
    """For every board or marker that kinematics predicts: measurements and predictions.

    sizes: (width, height) px of images by camera, "" the first.
    """
    parts = dict[str, list[Array]]()
    for name, alone in estimate.kinematic.items():
        track = features.tracks.get(name)
        if track is None or not len(track.t):
            continue
        measured = values_at_times(track, alone.t)
        axes = alone.values.shape[1]
        both = np.full(alone.values.shape, np.nan)
        if name in estimate.predicted:
            both = values_at_times(estimate.predicted[name], alone.t)
        rows = np.concatenate([measured, alone.values, both[:, :axes]], axis=1)
        rows = rows[np.isfinite(rows[:, : 2 * axes]).all(axis=1)]
        if len(rows):
            parts.setdefault(group_of(name), []).append(rows)
    return merge_rows(parts, sizes)


def merge_rows(
    parts: Mapping[str, Sequence[Array]], sizes: Mapping[str, tuple[int, int]]
) -> tuple[ReprojectionSheet, ...]:
    """A sheet for each board or marker from its tracks' rows (N,3D): measured, by kinematics alone
    and with the process; of a point in space along the two axes that it moves most. sizes: (width,
    height) px of images by camera, "" the first.
    """
    found = []
    for name, each in parts.items():
        measured, alone, both = np.split(np.concatenate(each), 3, axis=1)
        names, unit = TRACK_AXES[measured.shape[1]]
        first, second = sorted(np.argsort(-np.ptp(measured, axis=0), kind="stable")[:2].tolist())
        size = sizes.get(name.rpartition("/")[0])
        plane = None if size is None else np.array([[0.0, 0.0], size]) - 0.5
        drawn = [first, second]
        axes = (names[first], names[second])
        found.append(
            ReprojectionSheet(
                name, measured[:, drawn], alone[:, drawn], both[:, drawn], plane, axes, unit
            )
        )
    return tuple(found)


def values_at_times(series: Series, t: Array) -> Array:
    """The rows (N,D) of a series at times t (N,), NaN where it has none; its times ascend."""
    found = np.full((len(t), series.values.shape[1]), np.nan)
    if len(series.t):
        rows = np.clip(np.searchsorted(series.t, t - 1e-6), 0, len(series.t) - 1)
        there = np.abs(series.t[rows] - t) < 1e-6
        found[there] = series.values[rows[there]]
    return found


def parse_zeros(entries: Any) -> tuple[JointZero, ...]:
    """The zeros in a file's mapping {joint: {value, std,
    unit, confused_with}}; invalid entries are left out.
    """
    found = []
    for joint, one in list(entries.items())[:_ZEROS] if isinstance(entries, Mapping) else ():
        value, std = (
            (one.get("value"), one.get("std")) if isinstance(one, Mapping) else (None, None)
        )
        if (
            isinstance(std, int | float)
            and isfinite(std)
            and (value is None or _is_finite_number(value))
        ):
            others = one.get("confused_with")
            names = tuple(str(name) for name in others[:4]) if isinstance(others, list) else ()
            known = None if value is None else float(value)
            found.append(
                JointZero(
                    str(joint), known, float(std), "m" if one.get("unit") == "m" else "rad", names
                )
            )
    return tuple(found)


def render_section(drawn: Sequence[ReprojectionSheet], offsets: Sequence[JointZero]) -> str:
    """The sheets as part of a page, every name escaped; "" where there is nothing to show."""
    body = "\n".join(_render_sheet_figure(sheet.some()) for sheet in drawn[:TRACKS])
    left = (
        f'<p class="soft">Drawn: the first {TRACKS} of {len(drawn)} boards and markers.</p>'
        if len(drawn) > TRACKS
        else ""
    )
    key = (
        "dot: measured · violet: by kinematics alone · yellow: with the process; arrows lead from "
        "measured to expected"
    )
    shown = f'<h2>Reprojection</h2>\n<p class="soft">{key}</p>\n<div>\n{body}\n</div>{left}'
    rows = [(zero.joint, *zero.shown) for zero in offsets]
    listed = html_table("Zeros of the joints", ("joint", "offset", ""), rows)
    return "\n".join(part for part in (shown if drawn else "", listed) if part)


def _render_sheet_figure(sheet: ReprojectionSheet) -> str:
    times = sheet.magnified
    text = f"{sheet.name}: {_errors_text(sheet)} (RMS distance); arrows {times:g} ×"
    width = _WIDTH + _SIDE + 10
    low, high = sheet.limits
    wide, tall = high - low
    # below and above a wide image nothing is drawn
    left_out = max(0.0, _HEIGHT - max(_WIDTH * tall / wide, 0.75 * _SIDE))
    box = f"0 {0.5 * left_out:.0f} {width:g} {_HEIGHT - left_out:.0f}"
    return (
        f'<figure><svg viewBox="{box}" width="{width:g}" role="img">'
        f"<title>{escape_text(text)}</title>{''.join(_render_image_plane(sheet, times))}{''.join(_render_residuals(sheet))}</svg>"
        f"<figcaption>{escape_text(text)}</figcaption></figure>"
    )


def _render_image_plane(sheet: ReprojectionSheet, times: float) -> Iterator[str]:
    """The image plane with magnified residuals."""
    low, high = sheet.limits
    span = high - low
    scale = float(min((_WIDTH - 2) / span[0], (_HEIGHT - 2) / span[1]))
    corner = 0.5 * (np.array([_WIDTH, _HEIGHT]) - scale * span)
    places = (sheet.measured - low) * scale + corner
    x, y = corner
    wide, tall = scale * span
    yield (
        f'<rect x="{x:.1f}" y="{y:.1f}" width="{wide:.1f}" height="{tall:.1f}" fill="none" '
        f'stroke="{_RULE}" stroke-opacity="0.4"/>'
    )
    for expected, ink in ((sheet.kinematics, _ALONE), (sheet.both, _BOTH)):
        ends = places + times * scale * (expected - sheet.measured)
        known = np.isfinite(ends).all(axis=1)
        lines = "".join(map(_svg_arrow, places[known], ends[known]))
        yield f'<path d="{lines}" stroke="{ink}" fill="none"/>'
    ink = measurement_ink(sheet.name).plot
    yield from (f'<circle cx="{x:.1f}" cy="{y:.1f}" r="1.6" fill="{ink}"/>' for x, y in places)


def _render_residuals(sheet: ReprojectionSheet) -> Iterator[str]:
    """Residuals around zero with a ring at a round distance."""
    left = [sheet.kinematics - sheet.measured, sheet.both - sheet.measured]
    reach = _residual_reach_px(sheet)
    scale = 0.45 * _SIDE / reach
    centre = np.array([_WIDTH + 10 + _SIDE / 2, _HEIGHT / 2])
    ring = 10.0 ** np.floor(np.log10(reach))
    x, y = centre
    yield (
        f'<circle cx="{x:g}" cy="{y:g}" r="{ring * scale:.1f}" fill="none" stroke="{_RULE}" '
        'stroke-opacity="0.5"/>'
    )
    yield (
        f'<text x="{x + ring * scale:.1f}" y="{y - 4:g}" font-size="11" fill="{_RULE}">{ring:g} '
        f"{sheet.unit}</text>"
    )
    for part, ink in zip(left, (_ALONE, _BOTH), strict=True):
        near = part[np.linalg.norm(part, axis=1) <= reach]  # false for NaN
        dots = (centre + scale * one for one in near)
        yield from (
            f'<circle cx="{u:.1f}" cy="{v:.1f}" r="1.8" fill="{ink}" fill-opacity="0.6"/>'
            for u, v in dots
        )


def _svg_arrow(start: Array, end: Array) -> str:
    """A path from start to end with a head at its end."""
    line = end - start
    length = max(float(np.linalg.norm(line)), 1e-9)
    back = line / length * min(4.0, 0.5 * length)
    across = 0.5 * np.array([-back[1], back[0]])
    points = (start, end, end - back + across, end, end - back - across)
    marks = zip("MLLML", points, strict=True)
    return "".join(f"{mark}{place[0]:.1f} {place[1]:.1f}" for mark, place in marks)


def _errors_text(sheet: ReprojectionSheet) -> str:
    alone, both = sheet.errors
    process = f", {both:.2f} {sheet.unit} with the process" if isfinite(both) else ""
    return f"{alone:.2f} {sheet.unit} by kinematics alone{process}"


def draw_image_plane(sheet: ReprojectionSheet, ax: Any) -> None:
    """The image plane of one track with magnified residuals, in a figure."""
    some = sheet.some()
    times = sheet.magnified
    for expected, ink, what in (
        (some.kinematics, _ALONE, "kinematics"),
        (some.both, _BOTH, "with process"),
    ):
        off = times * (expected - some.measured)
        known = np.isfinite(off).all(axis=1)
        if not known.any():
            continue
        arrows = {"angles": "xy", "scale_units": "xy", "scale": 1, "width": 0.003}
        ax.quiver(*some.measured[known].T, *off[known].T, color=ink, label=what, **arrows)
    ax.plot(*some.measured.T, ".", color=measurement_ink(sheet.name).plot, ms=2, label="measured")
    ax.set(
        aspect="equal",
        title=f"{printable_label(sheet.name)}: arrows {times:g} ×",
        **_axis_labels(sheet),
    )
    low, high = sheet.limits
    upright = (high[1], low[1]) if sheet.unit == "px" else (low[1], high[1])
    ax.set(xlim=(low[0], high[0]), ylim=upright)
    ax.legend(loc="best")


def _axis_labels(sheet: ReprojectionSheet) -> dict[str, str]:
    unit = {"px": "pixels"}.get(sheet.unit, sheet.unit)
    labels = (f"{axis}, {unit}" for axis in sheet.axes)
    return dict(zip(("xlabel", "ylabel"), labels, strict=True))


def draw_residuals(sheet: ReprojectionSheet, ax: Any) -> None:
    """The residuals of one track in a figure."""
    alone, both = sheet.errors
    for expected, ink, what in (
        (sheet.kinematics, _ALONE, f"kinematics: {alone:.2f} {sheet.unit} RMS"),
        (sheet.both, _BOTH, f"with process: {both:.2f}"),
    ):
        if not np.isfinite(expected).any():
            continue
        ax.plot(*(expected - sheet.measured).T, ".", color=ink, ms=3, alpha=0.6, label=what)
    reach = _residual_reach_px(sheet)
    ax.set(aspect="equal", title="expected minus measured", **_axis_labels(sheet))
    ax.set(xlim=(-reach, reach), ylim=(reach, -reach) if sheet.unit == "px" else (-reach, reach))
    ax.legend(loc="best")


def draw_zero_offsets(found: Sequence[JointZero], ax: Any) -> None:
    """Each joint's zero with its standard deviation, in a
    figure; the name alone where it is not identifiable.
    """
    for row, zero in enumerate(found):
        factor = degrees(1.0) if zero.unit == "rad" else 1e3
        if zero.value is None:
            ax.text(0.0, row, " not identifiable", va="center", color=_RULE, fontsize=8)
        else:
            ax.errorbar(
                factor * zero.value, row, xerr=factor * zero.std, fmt="o", color=LINES[0], capsize=3
            )
    ax.axvline(0.0, color=_RULE, lw=0.8)
    ax.set_yticks(range(len(found)), [printable_label(zero.joint, 22) for zero in found])
    ax.set_ylim(len(found) - 0.5, -0.5)
    ax.set(title="zeros of the joints ± σ", xlabel="offset, degrees (mm of joints that slide)")


def _is_finite_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value)


def _residual_reach_px(sheet: ReprojectionSheet) -> float:
    """px around zero that hold nearly all residuals; the first of a log are far off."""
    left = np.concatenate([sheet.kinematics - sheet.measured, sheet.both - sheet.measured])
    return max(1.1 * float(np.nanquantile(np.linalg.norm(left, axis=1), 0.98)), 1e-3)


def _rms_length(left: Array) -> float:
    square = np.square(left).sum(axis=1)
    known = np.isfinite(square)
    return float(np.sqrt(square[known].mean())) if known.any() else float("nan")
