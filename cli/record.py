"""bodylog record."""

from pathlib import Path
from typing import Any

import click

from bodylog import choices

from .options import out_option, require_finite_option
from .setting_options import NearestChoice

_VARIANTS = tuple(
    dict.fromkeys(variant for variants in choices.VARIANTS.values() for variant in variants)
)
_ERRORS = "\n".join(f"  {name:<11}{meaning}" for name, meaning in choices.HARDWARE.items())
_HELP = f"""Simulate a robot into a log with its true angles.

PyBullet simulates it without a screen; the same seed gives the same bytes.
SCENARIO is one of {", ".join(choices.VARIANTS)}.

\b
--hardware takes errors of real joints and encoders, 0 where left out:
{_ERRORS}
"""


@click.command(
    help=_HELP, epilog="Example: bodylog record babble -o explore.mcap --seed 1 --duration 40"
)
@click.argument("scenario", type=NearestChoice(tuple(choices.VARIANTS)), metavar="SCENARIO")
@out_option("The log to write (.mcap).")
@click.option("--seed", type=int, default=0, show_default=True, help="Same seed, same bytes.")
@click.option(
    "--duration",
    type=click.FloatRange(0, min_open=True),
    callback=require_finite_option,
    metavar="S",
    help="Default: the scenario's.",
)
@click.option("--image", type=NearestChoice(choices.IMAGES), default="jpeg", show_default=True)
@click.option("--size", metavar="WxH", default="640x480", show_default=True, help="Picture size.")
@click.option(
    "--noise",
    type=click.FloatRange(0),
    callback=require_finite_option,
    metavar="RAD",
    help="Standard deviation of the encoders.",
)
@click.option("--full", is_flag=True, help="babble: move every joint.")
@click.option("--arm", type=NearestChoice(choices.ARMS), default="ur5", show_default=True)
@click.option(
    "--variant", type=NearestChoice(_VARIANTS), help="Variant of the scenario. Default: its first."
)
@click.option(
    "--place",
    type=NearestChoice(choices.PLACES),
    help="rubber-hand: place of the hand. Default: right.",
)
@click.option("--marker", is_flag=True, help="A blue ball on the wrist as a second feature.")
@click.option(
    "--cameras", type=int, default=1, show_default=True, help="2: one at the side as well."
)
@click.option("--turning", is_flag=True, help="The head with its camera turns: one more joint.")
@click.option("--feature", type=NearestChoice(choices.FEATURES), default="ball", show_default=True)
@click.option(
    "--feature-size",
    type=click.FloatRange(0, min_open=True),
    callback=require_finite_option,
    metavar="M",
    help="Diameter of the ball (default 0.05) or side of the tag (0.08).",
)
@click.option(
    "--clutter", is_flag=True, help="Things of the feature's colour, a foreign tag, furniture."
)
@click.option("--split-joints", is_flag=True, help="Arm, head and gripper on topics of their own.")
@click.option("--camera", type=NearestChoice(choices.CAMERAS), default="head", show_default=True)
@click.option(
    "--scene",
    type=NearestChoice(choices.SCENES),
    default="plain",
    show_default=True,
    help="bare: no feature; links and wall, or stones before a wrist, have a texture.",
)
@click.option(
    "--hardware",
    default="",
    metavar="NAME=SIZE,...",
    help="Errors of real joints and encoders (see below).",
)
@click.option(
    "--json", "as_json", is_flag=True, help="Print the result as JSON on standard output."
)
def record(scenario: str, out: Path, size: str, as_json: bool, **options: Any) -> int:
    """Simulate a robot into a log with its true angles."""
    from bodylog import pipeline

    from .output import print_result, show_progress

    with show_progress("record") as tick:
        result = pipeline.record(
            scenario, out, size=_parse_image_size(size), progress=tick, **options
        )
    return print_result(result, scenario, as_json)


def _parse_image_size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    if not (
        width.isdigit()
        and height.isdigit()
        and 16 <= int(width) <= 4096
        and 16 <= int(height) <= 4096
    ):
        raise click.BadParameter(
            f"{text!r}; it must be WIDTHxHEIGHT, e.g. 640x480", param_hint="--size"
        )
    return int(width), int(height)
