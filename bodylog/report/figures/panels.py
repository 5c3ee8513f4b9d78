"""The panels of the figures: each draws one thing on one axes, times in s."""

from typing import Any

import numpy as np

from ...overlay_style import BELIEF, TRUTH
from ...types import Array, Estimate, Features, Series, Stroke
from ..page.decimate import extreme_indices, thin_band, thin_curve
from .canvas import FELT, INK, LINES, SEEN, line_colour, printable_label

_POINTS = 3000
_COLUMNS = 1200
_CROWD = 24
_STYLES = ("-", "--", ":")


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
        start, end = np.array([x.start_px for x in strokes]), np.array([x.end_px for x in strokes])
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
