"""Static figures, PNG or SVG by suffix: a recording (the
paper's figure 3), a body (3b), an estimate (figure 4).
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...body_model import BodyModel, ForwardModel
from ...errors import LogError, ModelError
from ...overlay_style import BELIEF, TRUTH
from ...sources import group_of
from ...types import Array, Estimate, Features, Recording, Series, Stroke
from ..page.decimate import extreme_indices, thin_band, thin_curve
from .canvas import FELT, INK, LINES, SEEN, line_colour, open_figure, printable_label
from .reprojection import (
    NO_SIZES,
    JointZero,
    ReprojectionSheet,
    draw_image_plane,
    draw_residuals,
    draw_zero_offsets,
)
from .reprojection import TRACKS as SHEETS

Panel = Callable[[Any], None]
TIME_AXIS = "time, s"
POSE_AXIS = "pose"
_ROWS = 24
_GRID = 61
_POINTS = 3000
_COLUMNS = 1200
_CROWD = 24
_STYLES = ("-", "--", ":")


def recording_figure(recording: Recording, features: Features, out: Path) -> None:
    """Draw a log as the paper's figure 3: joints, pixels,
    skin, events, trajectories; absent ones are left out.
    """
    panels = _recording_panels(recording, features)
    if recording.signals.poses:
        panels = [partial(_draw_separate_rows, draw) for draw in panels]
    tracks = {name: one for name, one in seen_tracks(features).items() if one.unit == "px"}
    if not panels:
        raise LogError("no joints, tracks, skin or events to draw; type: bodylog info LOG")
    with open_figure(out, 11.0 if tracks else 8.0, 0.6 + 1.75 * len(panels)) as drawing:
        grid = drawing.add_gridspec(
            len(panels), 2 if tracks else 1, width_ratios=(5, 3) if tracks else (1,)
        )
        drawing.suptitle(
            printable_label(recording.facts.name, 80), x=0.01, ha="left", weight="bold"
        )
        label = POSE_AXIS if recording.signals.poses else TIME_AXIS
        _stack_panels(drawing, grid, panels, recording.duration_s, label=label)
        if tracks:
            ax = drawing.add_subplot(grid[:, 1])
            draw_trajectories(tracks, features.strokes, ax)
            if recording.signals.poses:
                _replace_lines_by_points(ax)


def _draw_separate_rows(draw: Panel, ax: Any) -> None:
    """Draw a panel of still poses."""
    draw(ax)
    _replace_lines_by_points(ax)


def _replace_lines_by_points(ax: Any) -> None:
    """Points in place of lines and bands: nothing lies between still poses."""
    for line in ax.get_lines():
        if line.get_linestyle() in ("-", "--") and len(line.get_xdata()) > 2:
            line.set(linestyle="none", marker=".", markersize=4)
    for band in ax.findobj(lambda one: type(one).__name__ == "FillBetweenPolyCollection"):
        band.remove()


def body_figure(
    body: BodyModel,
    out: Path,
    sheets: Sequence[ReprojectionSheet] = (),
    zeros: Sequence[JointZero] = (),
    sizes: Mapping[str, tuple[int, int]] = NO_SIZES,
) -> None:
    """Draw each output's mean and standard deviation over
    the two joints that moved most, with its samples.

    With a URDF, also the reprojection of every track and the joints' zeros. sizes: (width, height)
    px of images by camera; where a mean is outside its image, nothing is drawn.
    """
    if len(body.joints) < 2:
        raise ModelError(
            f"body of {len(body.joints)} joint: a surface needs two; type: bodylog fit LOG "
            "--joints a,b"
        )
    # one point stands for a board
    first = {group_of(sense): sense for sense in sorted(body.senses, reverse=True)}.values()
    rows = [
        (sense, model, d)
        for sense, model in body.senses.items()
        if sense in first
        for d in range(len(model.outputs))
    ][:_ROWS]
    if not rows:
        raise ModelError("body model without a sense: nothing to draw; type: bodylog info body.npz")
    below = _kinematic_panels(sheets, zeros)
    with open_figure(out, 9.0, 0.4 + 3.1 * (len(rows) + -(-len(below) // 2))) as drawing:
        grid = drawing.add_gridspec(len(rows) + -(-len(below) // 2), 2)
        for k, draw in enumerate(below):
            draw(drawing.add_subplot(grid[len(rows) + k // 2, k % 2]))
        for row, (sense, model, d) in enumerate(rows):
            _draw_output_surface(
                drawing,
                grid[row, :],
                body.joints,
                f"{printable_label(sense)} {printable_label(model.outputs[d])}",
                model,
                d,
                sizes.get(sense.rpartition("/")[0]),
            )


def reprojection_figure(
    sheets: Sequence[ReprojectionSheet], zeros: Sequence[JointZero], out: Path
) -> None:
    """Draw each track's residuals in the image plane, of
    kinematics alone and with the process, and the zeros.
    """
    panels = _kinematic_panels(sheets, zeros)
    with open_figure(out, 9.0, 0.4 + 3.6 * -(-len(panels) // 2)) as drawing:
        grid = drawing.add_gridspec(-(-len(panels) // 2), 2)
        for k, draw in enumerate(panels):
            draw(drawing.add_subplot(grid[k // 2, k % 2]))


def _kinematic_panels(
    sheets: Sequence[ReprojectionSheet], zeros: Sequence[JointZero]
) -> list[Panel]:
    """Two panels for every track, and one for the zeros where there are any."""
    panels = [
        partial(draw, sheet)
        for sheet in sheets[:SHEETS]
        for draw in (draw_image_plane, draw_residuals)
    ]
    return [*panels, *([partial(draw_zero_offsets, zeros)] if zeros else [])]


def estimate_figure(
    estimate: Estimate, truth: Series | None, recorded: Series | None, out: Path
) -> None:
    """Draw each joint's belief with its 2-sigma band, truth
    and encoder, its error; sense errors; free energy.
    """
    names = estimate.joints.names[:_ROWS]
    panels: list[Panel] = [
        partial(draw_belief, estimate, m, truth, recorded) for m in range(len(names))
    ]
    panels += [
        partial(draw_errors, sense, residuals)
        for sense, residuals in estimate.errors.items()
        if len(residuals.t)
    ]
    panels.append(partial(draw_free_energy, estimate))
    real = truth if truth is not None and set(names) & set(truth.names) else None
    still = estimate.settings.get("motion") == "none"
    if still:
        panels = [partial(_draw_separate_rows, draw) for draw in panels]
    label = POSE_AXIS if still else TIME_AXIS
    with open_figure(out, 13.0 if real else 9.0, 0.6 + 1.75 * len(panels)) as drawing:
        grid = drawing.add_gridspec(len(panels), 2 if real else 1)
        axes = _stack_panels(drawing, grid, panels, None, aside=len(names), label=label)
        drawing.suptitle(
            f"{printable_label(estimate.method)}: belief with its 2σ band",
            x=0.01,
            ha="left",
            weight="bold",
        )
        for m, name in enumerate(names):
            if real and name in real.names:
                draw_deviation(
                    estimate, m, real, recorded, drawing.add_subplot(grid[m, 1], sharex=axes[0])
                )


def _recording_panels(recording: Recording, features: Features) -> list[Panel]:
    panels: list[Panel] = []
    if recording.signals.joints is not None and len(recording.signals.joints.t):
        panels.append(partial(draw_signals, recording.signals.joints, "joints, rad"))
    if seen_tracks(features):
        panels.append(partial(draw_pixels, features))
    if recording.signals.skin is not None and len(recording.signals.skin.t):
        panels.append(partial(draw_skin, recording.signals.skin))
    if features.touches or features.strokes:
        panels.append(partial(draw_events, features))
    return panels


def _stack_panels(
    drawing: Any,
    grid: Any,
    panels: list[Panel],
    duration: float | None,
    aside: int | None = None,
    label: str = TIME_AXIS,
) -> list[Any]:
    """One panel below the other on one axis, of times or of poses' numbers; the
    first `aside` (None: all) leave the right column free.
    """
    axes: list[Any] = []
    for row, draw in enumerate(panels):
        cell = grid[row, 0] if aside is None or row < aside else grid[row, :]
        ax = drawing.add_subplot(cell, sharex=axes[0] if axes else None)
        draw(ax)
        ax.tick_params(labelbottom=row == len(panels) - 1)
        axes.append(ax)
    axes[-1].set_xlabel(label)
    axes[0].set_xlim(0.0, duration) if duration else axes[0].margins(x=0.01)
    drawing.align_ylabels(axes)
    return axes


def _draw_output_surface(
    drawing: Any,
    row: Any,
    joints: tuple[str, ...],
    title: str,
    model: ForwardModel,
    d: int,
    size: tuple[int, int] | None,
) -> None:
    samples = getattr(model, "samples", None)
    first, second, x = _posture_lattice(samples, len(joints))
    # by line, to bound the memory
    means, _, variances = zip(*(model.predict(line) for line in x), strict=True)
    mean = np.stack(means)
    outside = np.zeros(mean.shape[:2], bool)
    if size is not None and model.outputs == ("u", "v"):
        middle = 0.5 * np.array(size)
        outside[:] = (np.abs(mean - middle) > middle).any(axis=-1)
    drawn = {
        "mean": np.ma.masked_where(outside, mean[..., d]),
        "standard deviation": np.ma.masked_where(outside, np.sqrt(np.stack(variances)[..., d])),
    }
    for cell, (what, values), cmap in zip(
        row.subgridspec(1, 2), drawn.items(), ("viridis", "magma"), strict=True
    ):
        ax = drawing.add_subplot(cell)
        ax.grid(False)
        filled = ax.contourf(x[0, :, first], x[:, 0, second], values, levels=24, cmap=cmap)
        drawing.colorbar(filled, ax=ax, pad=0.01)
        if samples is not None:
            ax.plot(
                samples[:, first], samples[:, second], ".", color="white", mec=INK, mew=0.4, ms=4
            )
        ax.set(
            title=f"{title}: {what}",
            xlabel=f"{printable_label(joints[first])}, rad",
            ylabel=f"{printable_label(joints[second])}, rad",
        )


def _posture_lattice(samples: Array | None, joints: int) -> tuple[int, int, Array]:
    """The two joints that moved most, and x (G,G,M) over
    them with the others at their median; ±π without samples.
    """
    if samples is None or not len(samples):
        low = np.full(joints, -np.pi)
        high = np.full(joints, np.pi)
        middle = np.zeros(joints)
    else:
        low = samples.min(axis=0)
        high = samples.max(axis=0)
        middle = np.median(samples, axis=0)
    margin = np.maximum(0.1 * (high - low), 1e-3)
    first, second = sorted(np.argsort(low - high, kind="stable")[:2])
    x = np.broadcast_to(middle, (_GRID, _GRID, joints)).copy()
    x[:, :, first] = np.linspace(low[first] - margin[first], high[first] + margin[first], _GRID)
    x[:, :, second] = np.linspace(
        low[second] - margin[second], high[second] + margin[second], _GRID
    )[:, None]
    return int(first), int(second), x


def seen_tracks(features: Features) -> dict[str, Series]:
    """The tracks that were seen at least once."""
    return {
        name: track
        for name, track in features.tracks.items()
        if np.isfinite(track.values).all(axis=1).any()
    }


def draw_signals(series: Series, unit: str, ax: Any) -> None:
    """Every column of a signal as a line."""
    for d, name in enumerate(series.names):
        ax.plot(
            *thin_curve(series.t, series.values[:, d], _POINTS),
            color=LINES[d % len(LINES)],
            label=printable_label(name),
        )
    ax.set_ylabel(unit)
    _draw_axes_legend(ax)


def draw_pixels(features: Features, ax: Any) -> None:
    """u (solid) and v (dashed), or x, y and z (dotted), of
    every track, on the spans of the strokes.
    """
    tracks = seen_tracks(features)
    for i, (name, track) in enumerate(tracks.items()):
        for axis, column, style in zip(track.names, track.values.T, _STYLES, strict=False):
            line = thin_curve(track.t, column, _POINTS)
            label = f"{printable_label(name)} {axis}"
            ax.plot(*line, style, color=line_colour(name, i), label=label)
    spans = [(x.start, x.end - x.start) for x in features.strokes]
    ax.broken_barh(spans, (0, 1), transform=ax.get_xaxis_transform(), color=SEEN, alpha=0.10, lw=0)
    units = dict.fromkeys(
        "pixels" if track.unit == "px" else track.unit for track in tracks.values()
    )
    ax.set_ylabel(", ".join(units))
    _draw_axes_legend(ax)


def draw_skin(skin: Series, ax: Any) -> None:
    """Every cell's reading: lines of a few cells, a heat map of many."""
    cells = skin.values.shape[1]
    if cells < 5:
        return draw_signals(skin, "skin, 0..1", ax)
    edges, highest = _bin_peaks(skin)
    # clipping a signalling NaN warns
    shown = np.where(np.isnan(highest.T), np.nan, np.clip(highest.T, 0, 1))
    image = ax.pcolormesh(
        edges, np.arange(cells + 1) - 0.5, shown, cmap="magma_r", vmin=0, vmax=1, rasterized=True
    )
    ax.figure.colorbar(image, ax=ax, pad=0.01, label="proximity")
    ax.set_ylabel("skin cell")
    ax.grid(False)


def _bin_peaks(skin: Series) -> tuple[Array, Array]:
    """Edges (B+1,) s and the highest reading of every cell
    in each bin (B,cells): no touch is lost to thinning.
    """
    starts = np.unique(
        np.linspace(0, len(skin.t), min(_COLUMNS, len(skin.t)), endpoint=False).astype(int)
    )
    edges = np.append(skin.t[starts], skin.t[-1])
    return np.maximum.accumulate(edges), np.fmax.reduceat(skin.values, starts, axis=0)


def draw_events(features: Features, ax: Any) -> None:
    """Touches felt below strokes seen, pairs joined and weighed."""
    from matplotlib.collections import LineCollection

    touches = features.touches or ()
    ax.broken_barh([(x.onset, x.offset - x.onset) for x in touches], (0.1, 0.8), color=FELT)
    ax.broken_barh([(x.start, x.end - x.start) for x in features.strokes], (1.1, 0.8), color=SEEN)
    pairs = [
        (touches[x.touch].onset, x.delay, x.weight)
        for x in features.synchrony
        if np.isfinite(x.delay)
    ]
    lines = [((felt, 0.9), (felt + delay, 1.1)) for felt, delay, _ in pairs]
    if pairs:
        ax.add_collection(
            LineCollection(lines, colors=INK, alpha=[0.25 + 0.75 * weight for *_, weight in pairs])
        )
    for felt, delay, weight in pairs if len(pairs) <= _CROWD else ():
        ax.annotate(f"{weight:.2f}", (felt + delay, 1.95), fontsize=6, color=INK)
    ax.set_ylim(-0.1, 2.4)
    ax.set_yticks([0.5, 1.5], ["felt", "seen"])
    ax.set_ylabel("touch")


def draw_trajectories(tracks: dict[str, Series], strokes: tuple[Stroke, ...], ax: Any) -> None:
    """Tracks in the image plane, v down, with the starts and ends of tracks and strokes."""
    for i, (name, track) in enumerate(tracks.items()):
        seen = track.values[np.isfinite(track.values).all(axis=1)]
        keep = np.union1d(
            extreme_indices(track.values[:, 0], _POINTS),
            extreme_indices(track.values[:, 1], _POINTS),
        )
        ax.plot(
            *track.values[keep].T,
            color=line_colour(name, i),
            alpha=0.7,
            label=printable_label(name),
        )
        ax.plot(*seen[0], "o", color=line_colour(name, i), mec=INK, ms=7, label="_")
        ax.plot(*seen[-1], "s", color=line_colour(name, i), mec=INK, ms=7, label="_")
    if strokes:
        start = np.array([x.start_px for x in strokes])
        end = np.array([x.end_px for x in strokes])
        ax.quiver(
            *start.T,
            *(end - start).T,
            angles="xy",
            scale_units="xy",
            scale=1,
            width=0.008,
            color=SEEN,
            zorder=3,
        )
    ax.set(aspect="equal", anchor="N", xlabel="u, pixels", ylabel="v, pixels")
    ax.invert_yaxis()
    for mark, what in (("o", "start"), ("s", "end")):
        ax.plot([], [], mark, color="white", mec=INK, label=what)
    _draw_axes_legend(ax, room=34)


def draw_belief(
    estimate: Estimate, m: int, truth: Series | None, recorded: Series | None, ax: Any
) -> None:
    """One joint: belief, 2-sigma band, encoder, truth, faults."""
    name = estimate.joints.names[m]
    t = estimate.joints.t
    mean = estimate.joints.values[:, m]
    spread = 2.0 * np.sqrt(estimate.cov[:, m, m])
    _draw_other_series(ax, recorded, name, {"color": "#b8bec6", "lw": 0.7}, "encoder")
    ax.fill_between(
        *thin_band(t, mean - spread, mean + spread, _POINTS),
        color=BELIEF.plot,
        alpha=0.25,
        lw=0,
        zorder=2,
    )
    ax.plot(*thin_curve(t, mean, _POINTS), color=BELIEF.plot, label="belief")
    _draw_other_series(ax, truth, name, {"color": TRUTH.plot, "lw": 0.9, "ls": "--"}, "truth")
    for fault in estimate.faults:
        if fault.name == name:
            ax.axvline(
                fault.since,
                color=LINES[1],
                ls=":",
                label=printable_label(f"{fault.kind} since {fault.since:.1f} s"),
            )
    ax.set_ylabel(f"{printable_label(name, 22)}, rad")
    _draw_axes_legend(ax)


def draw_deviation(
    estimate: Estimate, m: int, truth: Series, recorded: Series | None, ax: Any
) -> None:
    """Belief and encoder minus truth, mrad, on the 2-sigma band of the belief."""
    name = estimate.joints.names[m]
    t = estimate.joints.t
    real = truth.values[:, truth.names.index(name)]
    spread = 2e3 * np.sqrt(estimate.cov[:, m, m])
    if recorded is not None and name in recorded.names:
        off = 1e3 * (
            recorded.values[:, recorded.names.index(name)] - np.interp(recorded.t, truth.t, real)
        )
        ax.plot(*thin_curve(recorded.t, off, _POINTS), color="#c9ced5", lw=0.7, label="encoder")
    ax.fill_between(
        *thin_band(t, -spread, spread, _POINTS), color=BELIEF.plot, alpha=0.25, lw=0, zorder=2
    )
    off = 1e3 * (estimate.joints.values[:, m] - np.interp(t, truth.t, real))
    ax.plot(*thin_curve(t, off, _POINTS), color=BELIEF.plot, label="belief")
    ax.set_ylabel("off truth, mrad")
    ax.tick_params(labelbottom=False)
    _draw_axes_legend(ax)


def _draw_other_series(
    ax: Any, series: Series | None, name: str, style: dict[str, Any], what: str
) -> None:
    if series is not None and name in series.names:
        ax.plot(
            *thin_curve(series.t, series.values[:, series.names.index(name)], _POINTS),
            label=what,
            **style,
        )


def draw_errors(sense: str, errors: Series, ax: Any) -> None:
    """One sense's prediction errors in standard deviations."""
    ax.axhspan(-2, 2, color="#eef1f4", lw=0)
    for d, name in enumerate(errors.names):
        line = thin_curve(errors.t, errors.values[:, d], _POINTS)
        ax.plot(*line, ".", ms=2, color=LINES[d % len(LINES)], label=printable_label(name))
    ax.set_ylabel(f"{printable_label(sense, 22)} error, σ")
    _draw_axes_legend(ax)


def draw_free_energy(estimate: Estimate, ax: Any) -> None:
    """Free energy over time."""
    ax.plot(*thin_curve(estimate.joints.t, estimate.free_energy, _POINTS), color=INK)
    ax.set_ylabel("free energy, nats")


def _draw_axes_legend(ax: Any, room: int = 75) -> None:
    """The names above the axes, as many in a row as there is room for."""
    handles, names = ax.get_legend_handles_labels()
    if handles:
        columns = max(1, room // (max(map(len, names[:8])) + 6))
        ax.legend(
            handles[:8],
            names[:8],
            loc="lower right",
            bbox_to_anchor=(1, 1),
            borderaxespad=0.1,
            ncols=columns,
        )
