"""bodylog features, and colours as its other name."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .options import OUT, PATH, Common, common_options, log_argument

if TYPE_CHECKING:
    from bodylog.views import FeatureCandidates


@click.command(epilog="Example: bodylog features run.bag -o sheet.png")
@log_argument
@click.option(
    "-o",
    "--output",
    "out",
    type=OUT,
    help="A contact sheet (.png): images with every candidate outlined.",
)
@click.option(
    "--effector", metavar="U,V", help="Where the effector is in the first picture, in px."
)
@click.option(
    "--body", type=PATH, help="A body of the robot's own surface, whose corners are shown."
)
@common_options
def features(
    log: Path,
    out: Path | None,
    effector: str | None,
    body: Path | None,
    common: Common,
    as_json: bool,
) -> int:
    """Find tags and colours that move with the joints.

    For each: how often it is seen, how much of its motion
    the joints explain, and the line for robot.toml.
    """
    from bodylog import views
    from bodylog.pipeline import Result

    from .output import exit_code_of_findings, print_findings, print_json, result_entry

    place = _parse_place(effector)
    found = views.find_feature_candidates(log, out, common.settings(), place, body)
    print_findings(found.findings)
    if as_json:
        one = result_entry(Result(out, findings=found.findings), log)
        print_json([one | {"candidates": found.candidates, "images": found.images}])
    else:
        _print_candidates(found)
    return exit_code_of_findings(found.findings)


colours = click.Command(
    "colours",
    callback=features.callback,
    params=[*features.params],
    help="The same as features.",
    epilog="Example: bodylog colours run.bag -o sheet.png",
)
"""The name that this command had when it proposed colours alone."""


def _print_candidates(found: "FeatureCandidates") -> None:
    from .output import print_line

    rows = [
        ("", "seen", "moves by", "joints explain", ""),
        *(_candidate_row(one) for one in found.candidates),
    ]
    widths = [max(len(row[column]) for row in rows) for column in range(4)]
    print_line(
        f"# {found.images} images looked at; moves by: standard deviation of its place; -: "
        "not computed"
    )
    for name, *figures, verdict in rows:
        cells = "  ".join(
            f"{text:>{width}}" for text, width in zip(figures, widths[1:], strict=True)
        )
        print_line(f"{name:<{widths[0]}}  {cells}  {verdict}".rstrip())
    print_line("# paste one of these lines under [features] in robot.toml")
    for one in found.candidates:
        mark = ", the arm's" if one["arm"] else ""
        print_line(f"{one['line']}  # {one['name']}{mark}")


def _candidate_row(one: dict[str, Any]) -> tuple[str, ...]:
    also = one["why_not"] or "also moves as the joints do"
    explained = "-" if one["explained"] is None else f"{one['explained']:.0%}"
    figures = f"{one['seen']:.0%}", f"{one['strays_px']:.0f} px", explained
    return one["name"], *figures, "the arm's" if one["arm"] else also


def _parse_place(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    try:
        u, v = (float(part) for part in text.split(","))
    except ValueError:
        raise click.BadParameter(
            f"{text!r}; it must be U,V in px, e.g. 160,120", param_hint="--effector"
        ) from None
    return u, v
