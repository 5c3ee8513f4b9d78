"""Draw the picture of docs/datasets.md from what `bodylog doctor DATASET --urdf ROBOT.urdf -o DIR`
left in DIR (the argument): the verdict, images of two episodes, and small multiples."""

import base64
import io
import json
import sys
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from bodylog.dataset.outputs import read_evidence

OUT = Path(__file__).parent / "dataset_report.png"
STRIPS = 2
"""Episodes whose images are shown: those with most warnings, the first ones of equals."""
CURVES = 12
"""Joints that are shown, those that move most."""
COLUMNS = 6
WIDTH_CHARS = 150
COLOURS = 160
INK = "#20262e"
BLUE = "#1f77d0"
ORANGE = "#e07b1f"

Evidence = Mapping[str, Mapping[str, Any]]


def main(folder: Path) -> None:
    """Read the examination in a folder and write the picture."""
    lines = (folder / "results.jsonl").read_text(encoding="utf-8").splitlines()
    rows = [json.loads(line) for line in lines]
    evidence = read_evidence(folder, rows)
    whole = json.loads((folder / "dataset.json").read_text(encoding="utf-8"))
    matplotlib.rcParams.update({"font.size": 8, "axes.titlesize": 8, "text.parse_math": False})
    figure = Figure(figsize=(10.0, 9.0), dpi=100)
    grid = figure.add_gridspec(
        5, 1, height_ratios=[2.0, 1.25, 1.25, 1.6, 2.6], hspace=0.28,
        left=0.06, right=0.985, top=0.985, bottom=0.02,
    )  # fmt: skip
    write_verdict(figure.add_subplot(grid[0]), whole["verdict"])
    worst = sorted(rows, key=lambda row: -sum(level != "info" for level, _ in row["findings"]))
    for number, row in enumerate(worst[:STRIPS]):
        draw_strip(figure.add_subplot(grid[1 + number]), row["name"], evidence)
    cells = grid[1 + STRIPS].subgridspec(1, 3, wspace=0.2)
    draw_cameras([figure.add_subplot(cell) for cell in cells], evidence)
    cells = grid[2 + STRIPS].subgridspec(CURVES // COLUMNS, COLUMNS, hspace=0.4, wspace=0.28)
    draw_joints([figure.add_subplot(cell) for cell in cells], evidence)
    data = io.BytesIO()
    figure.savefig(data, format="png", metadata={"Software": None})
    picture = Image.open(data).convert("RGB").quantize(COLOURS, Image.Quantize.MAXCOVERAGE)
    picture.save(OUT, optimize=True)


def write_verdict(axes: Axes, verdict: Sequence[str]) -> None:
    """The verdict's sentences, the first as the heading."""
    axes.axis("off")
    first, *rest = verdict
    axes.text(0, 1, first, size=13, weight="bold", color=INK, va="top", transform=axes.transAxes)
    wrapped = [
        textwrap.fill(sentence, WIDTH_CHARS, subsequent_indent="     ") for sentence in rest
    ]
    text = "\n".join(wrapped)
    axes.text(0, 0.8, text, size=8.5, color=INK, va="top", linespacing=1.45, transform=axes.transAxes)


def draw_strip(axes: Axes, name: str, evidence: Evidence) -> None:
    """The images of an episode's first camera, side by side."""
    axes.axis("off")
    camera, about = next(iter(evidence[name]["cameras"].items()))
    shown = [
        cv2.imdecode(np.frombuffer(base64.b64decode(text), np.uint8), cv2.IMREAD_GRAYSCALE)
        for text in about["thumbnails"]
    ]
    gap = np.full((shown[0].shape[0], 6), 255, np.uint8)
    joined = np.hstack([part for one in shown for part in (one, gap)])
    axes.imshow(joined, cmap="gray", vmin=0, vmax=255)
    axes.text(-0.01, 0.5, f"{name}\n{camera}", ha="right", va="center", size=7, rotation=90,
              transform=axes.transAxes)  # fmt: skip


def draw_cameras(panels: Sequence[Axes], evidence: Evidence) -> None:
    """Delay, shutter and repeated frames of the first camera in each episode, with 2σ bars."""
    names = list(evidence)
    camera = next(iter(evidence[names[0]]["cameras"]))
    draw_figures(
        panels[0], f"delay of {camera} [ms]", evidence,
        [(f"delay/{camera}", BLUE, "by the robot's surface"), (f"flow/delay/{camera}", ORANGE, "by flow")],
    )  # fmt: skip
    panels[0].legend(fontsize=6.5, frameon=False, loc="upper right", ncols=2)
    draw_figures(panels[1], f"rolling shutter of {camera} [ms]", evidence,
                 [(f"row_time/{camera}", BLUE, "")])  # fmt: skip
    shares = [100.0 * evidence[name]["figures"][f"repeated/{camera}"][0] for name in names]
    panels[2].bar(range(len(names)), shares, color=BLUE, width=0.6)
    panels[2].set_ylim(0, 100)
    label_episodes(panels[2], f"repeated frames of {camera} [%]", names)


def draw_figures(
    axes: Axes, title: str, evidence: Evidence, figures: Sequence[tuple[str, str, str]]
) -> None:
    """Figures (name, colour, label) in ms of each episode, side by side."""
    for place, (figure, colour, label) in enumerate(figures):
        known = [one["figures"].get(figure) for one in evidence.values()]
        at = [k + 0.25 * place for k, one in enumerate(known) if one is not None]
        values = np.array([(one[0], one[1] or 0.0) for one in known if one is not None]).T
        axes.errorbar(at, 1e3 * values[0], 2e3 * values[1], fmt="o", ms=3.5, lw=1.2,
                      color=colour, label=label)  # fmt: skip
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.22 * (high - low))
    label_episodes(axes, title, list(evidence))


def label_episodes(axes: Axes, title: str, names: Sequence[str]) -> None:
    """The panel's title and the episodes' names."""
    axes.set_title(title, loc="left", weight="bold")
    axes.set_xticks(range(len(names)), names, size=6.5)
    axes.tick_params(axis="y", labelsize=6.5, length=2)
    axes.grid(axis="y", color="#e6e8eb")
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def draw_joints(panels: Sequence[Axes], evidence: Evidence) -> None:
    """The curves of the joints that move most, a line an episode, from start to end."""
    first = next(iter(evidence.values()))["joints"]
    spans = {
        joint: np.median([np.ptp(one["joints"]["curves"][k]) for one in evidence.values()])
        for k, joint in enumerate(first["names"])
    }
    for axes, joint in zip(panels, sorted(spans, key=lambda name: -spans[name]), strict=False):
        column = first["names"].index(joint)
        for one in evidence.values():
            curve = np.array(one["joints"]["curves"][column], float)
            axes.plot(np.linspace(0, 1, len(curve)), curve, lw=0.8, color=BLUE, alpha=0.6)
        axes.set_title(f"{joint} [{first['unit']}]", loc="left", size=6.5, pad=3)
        axes.set_xticks([])
        axes.tick_params(axis="y", labelsize=6, length=2)
        axes.spines[["top", "right"]].set_visible(False)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
