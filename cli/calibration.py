"""bodylog calibration, and offsets as its view of the joints alone."""

from pathlib import Path

import click

from .options import OUT, PATH

_BODY = click.argument("body", metavar="BODY.npz", type=PATH)
_URDF = click.option("--urdf", type=PATH, metavar="ROBOT.urdf", help="The URDF to correct.")
_JSON = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON on standard output.")


@click.command(epilog="Example: bodylog calibration body.npz --urdf robot.urdf -o calibrated.urdf")
@_BODY
@click.option("-o", "--output", "out", type=OUT, help="Write it: .yaml, .json, or .urdf with --urdf.")
@_URDF
@click.option("--camera-info", type=OUT, metavar="DIR", help="Write each lens as DIR/CAMERA.yaml for ROS.")
@click.option("--next", "count", type=click.IntRange(1, 100), metavar="N", help="Propose N postures to record next.")
@click.option("--among", type=PATH, metavar="POSES.csv", help="Choose them among these, not within limits.")
@_JSON
def calibration(
    body: Path,
    out: Path | None,
    urdf: Path | None,
    camera_info: Path | None,
    count: int | None,
    among: Path | None,
    as_json: bool,
) -> int:
    """Print camera and marker poses, lenses, and zeros.

    The body must be learned with a URDF. Each value has its standard deviation, in mm, degrees and px.
    """
    from bodylog import calibration, next_postures
    from bodylog.pipeline import Result

    from .output import entry, line, print_json, warn

    found = calibration.load(body)
    values = calibration.table(found)
    proposal = None if count is None else next_postures.proposed(body, count, urdf, among)
    written = calibration.write_lenses(body, found, camera_info) if camera_info is not None else ()
    if out is not None:
        calibration.write(found, out, urdf, values)
    if as_json:
        further = {} if proposal is None else {"next": next_postures.table(proposal)}
        print_json([entry(Result(out, findings=found.findings), body) | {"calibration": values} | further])
        return 0
    for text in calibration.lines(found) if proposal is None else next_postures.lines(proposal):
        line(text)
    warn(found.findings)
    _report_written(out, *written, scales=bool(found.scales))
    return 0


@click.command(epilog="Example: bodylog offsets body.npz --urdf robot.urdf -o corrected.urdf")
@_BODY
@click.option("-o", "--output", "out", type=OUT, help="Write them: .yaml, .json, or .urdf with --urdf.")
@_URDF
@_JSON
def offsets(body: Path, out: Path | None, urdf: Path | None, as_json: bool) -> int:
    """Print how far each joint's zero is off.

    The joints of `bodylog calibration`; scales are printed where they were unknown.
    """
    from bodylog import calibration
    from bodylog.body.kinematic.offsets import tables
    from bodylog.pipeline import Result

    from .output import entry, line, print_json

    found = calibration.load(body)
    values = tables(found.zeros, found.scales)
    if out is not None:
        calibration.write(calibration.without_cameras(found), out, urdf, values)
    if as_json:
        print_json([entry(Result(out), body) | values])
        return 0
    for text in calibration.zero_lines((*found.zeros, *found.scales)):
        line(text)
    _report_written(out, scales=bool(found.scales))
    return 0


def _report_written(*paths: Path | None, scales: bool) -> None:
    """Print the files written, and what a URDF of them cannot hold."""
    from .output import line

    for path in paths:
        if path is None:
            continue
        line(f"wrote {path}", err=True)
        if path.suffix == ".urdf" and scales:
            line("a URDF has no place for joints' scales: it holds the zeros alone", err=True)
