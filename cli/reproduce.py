"""bodylog reproduce."""

from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING

import click

from .options import FOLDER

if TYPE_CHECKING:
    from collections.abc import Callable

    from bodylog.experiments import Claim


@click.command(epilog="Example: bodylog reproduce E1 E3 -o out --seeds 10 --jobs 2")
@click.argument("experiments", metavar="[E1 ...]", nargs=-1)
@click.option("-o", "--output", "out", type=FOLDER, required=True, help="The folder for the page and its parts.")
@click.option("--seeds", type=click.IntRange(min=1), default=10, show_default=True, help="How often each is run.")
@click.option("--jobs", type=click.IntRange(min=1), default=2, show_default=True, help="Runs at a time.")
@click.option("--json", "as_json", is_flag=True, help="Print the claims as JSON on standard output.")
def reproduce(experiments: tuple[str, ...], out: Path, seeds: int, jobs: int, as_json: bool) -> None:
    """The paper's experiments from simulated logs, its claims judged, on one page (out/index.html).

    E1 to E6, PixelAI and Errata; all when none is named. What a run left in the folder is not run again.
    """
    from dataclasses import asdict

    from bodylog.experiments import Reproduction
    from bodylog.experiments import reproduce as run
    from bodylog.pipeline import Result

    from .output import as_data, data, line

    claims = run(Reproduction(out, experiments, seeds, jobs), _teller())
    if as_json:
        data(as_data(Result(out / "index.html")) | {"claims": [asdict(claim) for claim in claims]})
    else:
        _table(claims)
        line(f"wrote {out / 'index.html'}", err=True)


def _teller() -> "Callable[[str, int, int], None]":
    """A line for each run that is done, with the minutes since the first began."""
    begun = monotonic()

    def tell(what: str, done: int, total: int) -> None:
        click.echo(f"[{done}/{total}] {what}, {(monotonic() - begun) / 60:.1f} min", err=True)

    return tell


def _table(claims: "tuple[Claim, ...]") -> None:
    for claim in claims:
        figures = " ".join(f"{claim.spread[side][0]:>9.3g}" for side in ("printed", "ours"))
        click.echo(f"{claim.verdict:<9} {claim.experiment:<7} {figures} {claim.bound:>8}  {claim.text}")
