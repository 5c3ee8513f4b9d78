"""bodylog colours."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from .options import OUT, Common, common_options, log_argument

if TYPE_CHECKING:
    from bodylog.present import Colours


@click.command(epilog="Example: bodylog colours run.bag -o colours.png")
@log_argument
@click.option("-o", "--output", "out", type=OUT, help="A contact sheet (.png) of what each range finds.")
@click.option("--effector", metavar="U,V", help="Where the effector is in the first picture, in px.")
@common_options
def colours(log: Path, out: Path | None, effector: str | None, common: Common, as_json: bool) -> int:
    """Propose colour ranges from a log: the saturated blob that moves with the joints is the effector."""
    from bodylog import present
    from bodylog.pipeline import Result

    from .output import as_data, data, lost, talk

    found = present.colours(log, out, common.settings(), _place(effector))
    talk(found.findings)
    if as_json:
        data(as_data(Result(out, findings=found.findings)) | {"proposals": found.proposals})
    else:
        _print(found)
    return lost(found.findings)


def _print(found: "Colours") -> None:
    click.echo("# the likeliest effector first; paste what is right under [colours]")
    for one in found.proposals:
        ranges = f"{{low = {list(one['low'])}, high = {list(one['high'])}}}"
        said = f"{one['name']}: in {one['seen']:.0%} of the pictures, strays {one['strays']:.0f} px"
        click.echo(f"effector = {ranges}  # {said}, joints explain {one['joints']:.0%}")


def _place(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    try:
        u, v = (float(part) for part in text.split(","))
    except ValueError:
        raise click.BadParameter(f"{text!r}; it must be U,V in px, e.g. 160,120", param_hint="--effector") from None
    return u, v
