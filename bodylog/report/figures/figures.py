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
from ...sources import group_of
from ...types import Array, Estimate, Features, Recording, Series
from .canvas import INK, open_figure, printable_label
from .panels import (
    draw_belief,
    draw_deviation,
    draw_errors,
    draw_events,
    draw_free_energy,
    draw_pixels,
    draw_signals,
    draw_skin,
    draw_trajectories,
    seen_tracks,
)
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
