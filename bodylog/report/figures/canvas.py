"""A blank matplotlib figure, saved atomically, without
a display, and with the same bytes for the same drawing.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ...errors import UsageError
from ...io.atomic_files import replace_atomically
from ...io.extras import require_module
from ...overlay_style import MEASURED

FORMATS = {
    ".png": {"format": "png", "metadata": {"Software": None}},
    ".svg": {"format": "svg", "metadata": {"Date": None, "Creator": None}},
}
"""Suffix -> arguments for matplotlib that leave out dates and version stamps."""

INK = "#20262e"
FELT = "#e07b1f"
SEEN = "#7a52c7"
LINES = ("#1f77d0", "#d1495b", "#2a9d68", "#b5862a", "#7a52c7", "#159aa8", "#d267b0", "#6b7280")

_STYLE = {
    "svg.hashsalt": "bodylog",
    "text.parse_math": False,  # names from a log are text, even with dollar signs
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#8a929c",
    "axes.titlesize": 9,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e6e8eb",
    "legend.frameon": False,
    "legend.fontsize": 8,
    "lines.linewidth": 1.1,
    "savefig.dpi": 130,
}


@contextmanager
def open_figure(out: Path, width: float, height: float, more: Sequence[str] = ()) -> Iterator[Any]:
    """An empty Figure of width x height inches, written to `out` at the end, and beside it with the
    suffixes `more`; UsageError: no matplotlib, suffix.
    """
    _require_known_format(out)
    matplotlib = _import_matplotlib()
    with matplotlib.rc_context():
        matplotlib.rcdefaults()  # independent of the user's matplotlibrc: same input, same bytes
        matplotlib.rcParams.update(_STYLE)
        drawing = matplotlib.figure.Figure(figsize=(width, height), layout="constrained")
        matplotlib.backends.backend_agg.FigureCanvasAgg(drawing)
        yield drawing
        for path in (out, *(out.with_suffix(suffix) for suffix in more)):
            with replace_atomically(path) as beside:
                _save_figure(drawing, beside, path.suffix.lower())
            # what was laid out once stays; it takes half of the time
            drawing.set_layout_engine("none")


def printable_label(name: str, longest: int = 40) -> str:
    """A name from a log as one printable line that matplotlib shows in a legend."""
    clean = "".join(c if c.isprintable() else " " for c in name)
    short = clean if len(clean) <= longest else clean[: longest - 1] + "…"
    return f" {short}" if short.startswith("_") else short


def line_colour(name: str, index: int) -> str:
    """The colour of a track by its name, of any other line by its index."""
    return MEASURED[name].plot if name in MEASURED else LINES[index % len(LINES)]


def _require_known_format(out: Path) -> None:
    if out.suffix.lower() not in FORMATS:
        better = " or ".join(str(out.with_suffix(suffix)) for suffix in FORMATS)
        raise UsageError(f"{out}: '{out.suffix}' is not a format for figures; type: {better}")


def _import_matplotlib() -> Any:
    require_module("matplotlib.backends.backend_agg")
    require_module("matplotlib.figure")
    return require_module("matplotlib")


def _save_figure(drawing: Any, path: Path, suffix: str) -> None:
    import warnings

    with warnings.catch_warnings():
        # a name in a script the font lacks is drawn as boxes, without a warning
        warnings.filterwarnings(
            "ignore", message="(Glyph|Matplotlib currently does not support)", category=UserWarning
        )
        drawing.savefig(path, **FORMATS[suffix])
