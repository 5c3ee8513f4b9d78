"""bodylog offsets."""

from pathlib import Path

import click

from .options import OUT, PATH


@click.command(epilog="Example: bodylog offsets body.npz --urdf robot.urdf -o corrected.urdf")
@click.argument("body", metavar="BODY.npz", type=PATH)
@click.option("-o", "--output", "out", type=OUT, help="Write them: .yaml, .json, or .urdf with --urdf.")
@click.option("--urdf", type=PATH, metavar="ROBOT.urdf", help="The URDF to correct.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON on standard output.")
def offsets(body: Path, out: Path | None, urdf: Path | None, as_json: bool) -> int:
    """Print how far each joint's zero is off.

    The body must be learned with a URDF; joint scales are printed where they were unknown.
    """
    from bodylog import calibration
    from bodylog.pipeline import Result

    from .output import entry, line, print_json

    found, scales = calibration.zeros(body)
    if out is not None:
        calibration.write(found, scales, out, urdf)
    if as_json:
        print_json([entry(Result(out), body) | calibration.tables(found, scales)])
        return 0
    width = max(len(one.joint) for one in found)
    for one in (*found, *scales):
        shown = one.shown if one.identifiable else f"not identifiable: {' and '.join(one.confused) or 'not seen'}"
        line(f"{one.joint:<{width}}  {'scale ' if one.noun == 'scale' else ''}{shown}")
    if out is not None:
        line(f"wrote {out}", err=True)
        if out.suffix == ".urdf" and scales:
            line("a URDF has no place for joints' scales: it holds the zeros alone", err=True)
    return 0
