"""bodylog calibration, and offsets as its view of the joints alone."""

from pathlib import Path

import click

from .options import OUT, PATH

_BODY = click.argument("body", metavar="BODY.npz", type=PATH)
_URDF = click.option("--urdf", type=PATH, metavar="ROBOT.urdf", help="The URDF to correct.")
_JSON = click.option(
    "--json", "as_json", is_flag=True, help="Print the result as JSON on standard output."
)


@click.command(epilog="Example: bodylog calibration body.npz --urdf robot.urdf -o calibrated.urdf")
@_BODY
@click.option(
    "-o", "--output", "out", type=OUT, help="Write it: .yaml, .json, or .urdf with --urdf."
)
@_URDF
@click.option(
    "--camera-info", type=OUT, metavar="DIR", help="Write each lens as DIR/CAMERA.yaml for ROS."
)
@click.option(
    "--next",
    "count",
    type=click.IntRange(1, 100),
    metavar="N",
    help="Propose N postures to record next.",
)
@click.option(
    "--among", type=PATH, metavar="POSES.csv", help="Choose them among these, not within limits."
)
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

    The body must be learned with a URDF. Each value
    has its standard deviation, in mm, degrees and px.
    """
    from bodylog.pipeline import Result
    from bodylog.robot import calibration, next_postures

    from .output import print_findings, print_json, print_line, result_entry

    found = calibration.load_calibration(body)
    values = calibration.calibration_as_values(found)
    proposal = (
        None if count is None else next_postures.propose_next_postures(body, count, urdf, among)
    )
    written = calibration.write_lenses(body, found, camera_info) if camera_info is not None else ()
    if out is not None:
        calibration.write_calibration(found, out, urdf, values)
    if as_json:
        further = {} if proposal is None else {"next": next_postures.postures_as_values(proposal)}
        print_json(
            [
                result_entry(Result(out, findings=found.findings), body)
                | {"calibration": values}
                | further
            ]
        )
        return 0
    for text in (
        calibration.calibration_lines(found)
        if proposal is None
        else next_postures.posture_lines(proposal)
    ):
        print_line(text)
    print_findings(found.findings)
    _report_written(out, *written, scales=bool(found.scales))
    return 0


@click.command(epilog="Example: bodylog offsets body.npz --urdf robot.urdf -o corrected.urdf")
@_BODY
@click.option(
    "-o", "--output", "out", type=OUT, help="Write them: .yaml, .json, or .urdf with --urdf."
)
@_URDF
@_JSON
def offsets(body: Path, out: Path | None, urdf: Path | None, as_json: bool) -> int:
    """Print how far each joint's zero is off.

    The joints of `bodylog calibration`; scales are printed where they were unknown.
    """
    from bodylog.body.kinematic.offsets import offset_tables
    from bodylog.pipeline import Result
    from bodylog.robot import calibration

    from .output import print_json, print_line, result_entry

    found = calibration.load_calibration(body)
    values = offset_tables(found.zeros, found.scales)
    if out is not None:
        calibration.write_calibration(calibration.without_cameras(found), out, urdf, values)
    if as_json:
        print_json([result_entry(Result(out), body) | values])
        return 0
    for text in calibration.zero_lines((*found.zeros, *found.scales)):
        print_line(text)
    _report_written(out, scales=bool(found.scales))
    return 0


def _report_written(*paths: Path | None, scales: bool) -> None:
    """Print the files written, and what a URDF of them cannot hold."""
    from .output import print_line

    for path in paths:
        if path is None:
            continue
        print_line(f"wrote {path}", err=True)
        if path.suffix == ".urdf" and scales:
            print_line("a URDF has no place for joints' scales: it holds the zeros alone", err=True)
