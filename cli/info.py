"""bodylog info."""

from pathlib import Path
from typing import Any

import click

from .options import ANYWHERE, Common, common_options, episode_option


@click.command(epilog="Example: bodylog info run.bag --json")
@click.argument("logs", metavar="LOG|BODY.npz...", type=ANYWHERE, nargs=-1, required=True)
@episode_option("logs")
@common_options
def info(logs: "tuple[Path | str, ...]", common: Common, as_json: bool) -> int:
    """Show what is in a log or a body model.

    A log: topics, types, counts, rates, clocks, and the role of each topic. Logs may be URLs.
    """
    from bodylog import info as inventory

    from .output import collect_results, print_json

    chosen = common.settings()
    found, code = collect_results(logs, lambda log: inventory.describe_file(log, chosen))
    if as_json:
        print_json([_info_entry(path, one) for path, one in found.items()])
    else:
        for one in found.values():
            _print_description(one)
    return code or (
        3 if any(f["severity"] == "lost" for one in found.values() for f in one["findings"]) else 0
    )


def _info_entry(path: str, one: dict[str, Any]) -> dict[str, Any]:
    """One of the envelope's results: what info finds stands under "log" or "body"."""
    from bodylog.pipeline import Result

    from .output import result_entry

    kind = "body" if one["format"] == "body" else "log"
    return result_entry(Result(None), path) | {"findings": one["findings"], kind: one}


def _print_description(one: dict[str, Any]) -> None:
    from .output import print_line

    if one["format"] == "body":
        from .body_text import show_body

        show_body(one)
        return
    print_line(
        f"{one['path']}: {one['format']}, {one['duration_s']:.3f} s from {one['start_ns']} ns"
    )
    width = max((len(topic["topic"]) for topic in one["topics"]), default=0)
    for topic in one["topics"]:
        rate = "" if topic["rate_hz"] is None else f"{topic['rate_hz']:.2f} Hz"
        print_line(
            f"  {topic['topic']:<{width}}  {topic['messages']:>8}  {rate:>12}  {topic['type']}"
        )
    for role, topic in one["roles"].items():
        print_line(f"  {role}: {topic}")
    if one["joints"]:
        unit = "" if one["unit"] in (None, "rad") else f" (unit: {one['unit']})"
        print_line(f"  joint names: {', '.join(one['joints'])}{unit}")
    for finding in one["findings"]:
        print_line(f"  {finding['severity']}: {finding['text']}")
