"""bodylog info."""

from pathlib import Path
from typing import Any

import click

from .options import ANYWHERE, Common, common_options, episodic


@click.command(epilog="Example: bodylog info run.bag --json")
@click.argument("logs", metavar="LOG|BODY.npz...", type=ANYWHERE, nargs=-1, required=True)
@episodic("logs")
@common_options
def info(logs: "tuple[Path | str, ...]", common: Common, as_json: bool) -> int:
    """What is in a log (topics, types, counts, rates, clocks, which topic plays which role) or a body model."""
    from bodylog import info as inventory

    from .output import data, each

    chosen = common.settings()
    found, code = each(logs, lambda log: inventory.info(log, chosen))
    if as_json:
        data(list(found.values()))
    else:
        for one in found.values():
            _print(one)
    return code or (3 if any(f["severity"] == "lost" for one in found.values() for f in one["findings"]) else 0)


def _print(one: dict[str, Any]) -> None:
    from .output import body, line

    if one["format"] == "body":
        body(one)
        return
    line(f"{one['path']}: {one['format']}, {one['duration_s']:.3f} s from {one['start_ns']} ns")
    width = max((len(topic["topic"]) for topic in one["topics"]), default=0)
    for topic in one["topics"]:
        rate = "" if topic["rate_hz"] is None else f"{topic['rate_hz']:.2f} Hz"
        line(f"  {topic['topic']:<{width}}  {topic['messages']:>8}  {rate:>12}  {topic['type']}")
    for role, topic in one["roles"].items():
        line(f"  {role}: {topic}")
    if one["joints"]:
        unit = "" if one["unit"] in (None, "rad") else f" (unit: {one['unit']})"
        line(f"  joint names: {', '.join(one['joints'])}{unit}")
    for finding in one["findings"]:
        line(f"  {finding['severity']}: {finding['text']}")
