"""What a person looks at: figures, the page on a log, a viewer's layout, the colours a log offers."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .pipeline import Progress, Result, distinct, judge, observe, topic_of
from .settings import Settings, plain
from .types import Estimate, Features, Finding, Recording

if TYPE_CHECKING:
    from .report.overlay import Picture


def plot(source: Path, out: Path, settings: Settings, progress: Progress | None = None) -> Result:
    """Draw a body model (.npz), or any log: joints, pixels, skin, events and trajectories over time."""
    from .report import figures

    distinct(source, out)
    if source.suffix == ".npz":
        from .body import model

        figures.body_figure(model.load(source), out)
        return Result(out)
    read, features = observe(source, settings, progress)
    figures.recording_figure(read, features, out)
    health = {**read.health, **features.health}
    return Result(out, (), health, (*read.findings, *features.findings), plain(settings))


def report(log: Path, out: Path, settings: Settings, figures: Path | None = None) -> Result:
    """One page on an annotated log; with `figures`, the same as pictures in that folder."""
    from .logs import annotated
    from .report import html, overlay

    distinct(log, out)
    read, features = observe(log, settings)
    found = annotated.read_estimate(log, read.start_ns)
    shown = overlay.pictures(read, features, found)
    html.write(out, found, features, read, judge(found, read), shown, annotated.read_metadata(log))
    if figures is not None:
        _figures(figures, read, features, found, shown)
    return Result(out, judge(found, read), found.used, read.findings)


def layout(log: Path, out: Path, settings: Settings) -> Result:
    """A viewer's layout for an annotated log."""
    from .logs import annotated, recording
    from .report import layout as viewer

    distinct(log, out)
    read = recording.read(log, settings, settings.input.strict)
    viewer.write(out, topic_of(read, "camera"), annotated.read_estimate(log, read.start_ns))
    return Result(out)


@dataclass(frozen=True, eq=False)
class Colours:
    """Colour ranges a log offers, the likeliest effector first, as plain values."""

    proposals: list[dict[str, Any]]
    findings: tuple[Finding, ...]


def colours(log: Path, out: Path | None, settings: Settings, effector: tuple[float, float] | None) -> Colours:
    """Ranges of the saturated blobs in a log; `out` becomes a contact sheet (PNG) of what they find."""
    from .logs import recording
    from .perception import palette
    from .report import overlay

    read = recording.read(log, settings, settings.input.strict)
    proposals, sheet = palette.propose(read, effector)
    if out is not None:
        overlay.write(sheet, out)
    return Colours([asdict(one) for one in proposals], read.findings)


def _figures(
    folder: Path, read: Recording, features: Features, found: Estimate, shown: "Sequence[Picture]"
) -> None:
    from .report import figures, overlay

    folder.mkdir(parents=True, exist_ok=True)
    figures.recording_figure(read, features, folder / "recording.png")
    figures.estimate_figure(found, read.truth, read.joints, folder / "estimate.png")
    if shown:
        overlay.overlay_sheet(shown, folder / "overlay.png")
