"""bodylog reproduce."""

from collections.abc import Callable
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING

import click

from .options import FOLDER, PATH

if TYPE_CHECKING:
    from bodylog.experiments import Claim, Setting
    from bodylog.experiments.readings import Reading

    NumbersType = click.ParamType[tuple[float, ...]]
else:
    NumbersType = click.ParamType
    """Generic in new versions of click only."""


class Numbers(NumbersType):
    """Numbers between two bounds, separated by commas."""

    name = "NUMBERS"

    def __init__(self, low: float, high: float) -> None:
        """Both bounds are possible."""
        self.low = low
        self.high = high

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, ...]:
        """Ascending, each once."""
        try:
            found = sorted({float(part) for part in str(value).split(",")})
        except ValueError:
            found = []
        if not found or not all(self.low <= one <= self.high for one in found):
            self.fail(
                f"{value!r}: numbers from {self.low:g} to {self.high:g} are expected, as 0,0.1,0.3",
                param,
                ctx,
            )
        return tuple(found)


@click.command(epilog="Example: bodylog reproduce E1 E3 -o out --seeds 10 --jobs 2")
@click.argument("experiments", metavar="[E1 ...]", nargs=-1)
@click.option(
    "-o",
    "--output",
    "out",
    type=FOLDER,
    required=True,
    help="The folder for the page and its parts.",
)
@click.option(
    "--seeds",
    type=click.IntRange(min=1),
    default=10,
    show_default=True,
    help="How often each is run.",
)
@click.option(
    "--jobs", type=click.IntRange(min=1), default=2, show_default=True, help="Runs at a time."
)
@click.option(
    "--reading",
    "constants",
    multiple=True,
    metavar="CONSTANT=VALUE",
    help="Judge in this reading alone, as sigma_n=noise; repeatable.",
)
@click.option(
    "--asynchrony", type=Numbers(0.0, 5.0), help="rubber-hand: delay of the seen hand, s."
)
@click.option(
    "--displacement",
    type=Numbers(0.01, 5.0),
    help="rubber-hand: how far aside, in the recorded 16 cm.",
)
@click.option(
    "--noise", type=Numbers(0.0, 3.0), help="rubber-hand: noise added to the encoders, rad."
)
@click.option(
    "--data", type=PATH, help="real: the folder with real robots' measurements (docs/real.md)."
)
@click.option(
    "--json", "as_json", is_flag=True, help="Print the claims as JSON on standard output."
)
def reproduce(
    experiments: tuple[str, ...],
    out: Path,
    seeds: int,
    jobs: int,
    constants: tuple[str, ...],
    data: Path | None,
    as_json: bool,
    **swept: tuple[float, ...] | None,
) -> None:
    """Run the paper's experiments and judge its claims.

    The logs are simulated; the page is out/index.html.

    Data, E1 to E6, Rubber-hand, PixelAI, Baselines and Errata; all when none is named. Real needs
    --data. What the paper leaves open is read in several ways (docs/paper.md). What a run left in
    the folder is not run again.
    """
    from dataclasses import asdict

    from bodylog.experiments import Reproduction
    from bodylog.experiments import run_reproduction as run
    from bodylog.pipeline import Result

    from .output import print_json, print_line, result_entry

    wish = Reproduction(
        out,
        experiments,
        seeds,
        jobs,
        reading=_parse_typed_reading(constants),
        setting=_rubber_hand_setting(swept),
        data=data,
    )
    claims = run(wish, _progress_printer())
    if as_json:
        one = result_entry(Result(out / "index.html"), list(experiments))
        print_json([one | {"claims": [asdict(claim) for claim in claims]}])
    else:
        _print_claims_table(claims)
        print_line(f"wrote {out / 'index.html'}", err=True)


def _parse_typed_reading(constants: tuple[str, ...]) -> "Reading | None":
    """The reading typed, if any."""
    from bodylog.experiments import readings

    return readings.parse_reading(",".join(constants)) if constants else None


def _rubber_hand_setting(swept: dict[str, tuple[float, ...] | None]) -> "Setting":
    """The values that the rubber hand sweeps: typed ones or the defaults."""
    from dataclasses import replace

    from bodylog.experiments import Setting

    return replace(Setting(), **{name: found for name, found in swept.items() if found is not None})


def _progress_printer() -> "Callable[[str, int, int], None]":
    """A line for each run that is done, with the minutes since the first run started."""
    started = monotonic()

    def tell(what: str, done: int, total: int) -> None:
        click.echo(f"[{done}/{total}] {what}, {(monotonic() - started) / 60:.1f} min", err=True)

    return tell


def _print_claims_table(claims: "tuple[Claim, ...]") -> None:
    from bodylog.experiments.tables import KINDS

    for kind, title in KINDS.items():
        found = [claim for claim in claims if claim.kind == kind]
        if found:
            click.echo(f"{title}:")
        for claim in found:
            # the centre's, or what is run here beside what others have
            figures = [one.median for one in claim.outcomes.values()] or [float("nan")]
            figure = figures[-1 if kind in ("comparison", "erratum") else 0]
            click.echo(
                f"  {claim.id:<13} {figure:>9.3g} {claim.bound:>8}  {claim.text}: {claim.verdict}"
            )
            for text in (str(claim.counts), *claim.reasons):
                click.echo(f"{'':>17}{text}")
