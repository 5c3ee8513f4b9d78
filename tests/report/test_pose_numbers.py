"""Still poses have numbers in place of times, and nothing is drawn between them."""

from dataclasses import replace

import numpy as np

from bodylog.report.figures import figures
from bodylog.report.figures.pose_numbers import number_poses
from bodylog.types import Fault, FaultKind
from tests.changed_recordings import change_recording

from .pages import plotted, report
from .records import UNSEEN, estimate, recording, series

TIMES = np.array([3.0, 7.0, 7.5, 3600.0])


def still():
    """A log of four poses at odd times."""
    values = np.arange(12.0).reshape(4, 3)
    names = recording().signals.joints.names
    joints = series(TIMES, values, names, "rad")
    log = recording(poses=True, truth=None, skin=None, frames=None, start_ns=10**9)
    log = change_recording(log, joints=joints)
    found = replace(
        estimate(),
        joints=series(TIMES, values + 0.001, names, "rad"),
        rate=series(TIMES, 0 * values, names, "rad/s"),
        cov=np.tile(1e-6 * np.eye(3), (4, 1, 1)),
        free_energy=np.zeros(4),
        errors={
            f"board.{k}": series(TIMES[k:], np.full((4 - k, 2), k), ("u", "v"), "1") for k in (0, 1)
        },
        predicted={},
        predicted_cov={},
        faults=(Fault("encoders", names[0], FaultKind.OFFSET, 3.0, 0.1, "rad"),),
        settings={"motion": "none"},
    )
    return log, UNSEEN, found


def test_times_become_numbers_of_poses():
    log, _, found = number_poses(*still())
    np.testing.assert_array_equal(log.signals.joints.t, [1, 2, 3, 4])
    np.testing.assert_array_equal(found.errors["board.1"].t, [2, 3, 4])
    assert found.faults[0].since == 1.0 and log.duration_s == 4.0


def test_page_of_still_poses_has_no_lines_no_date_and_one_panel_a_board(tmp_path):
    log, seen, found = number_poses(*still())
    page = report(tmp_path / "r.html", recording=log, features=seen, estimate=found)
    titles = [panel["title"] for panel in plotted(page)["panels"]]
    joints = [f"{name} minus its reading, mrad" for name in log.signals.joints.names]
    assert titles == [*joints, "board: prediction error, standard deviations"]
    kinds = {trace["kind"] for panel in plotted(page)["panels"] for trace in panel["traces"]}
    assert kinds == {"dots", "whiskers"} and plotted(page)["marks"] == []
    assert "UTC" not in page and "4 still poses" in page and "Pose by pose" in page


def test_figures_of_still_poses_have_points_alone(tmp_path, monkeypatch):
    drawn = []
    before = figures._replace_lines_by_points
    monkeypatch.setattr(figures, "_replace_lines_by_points", lambda ax: drawn.append((before(ax), ax)))
    log, _, found = number_poses(*still())
    figures.estimate_figure(found, None, log.signals.joints, tmp_path / "e.png")
    axes = [ax for _, ax in drawn]
    assert len(axes) == 6  # three joints, two senses, free energy
    assert all(line.get_linestyle() == "None" for ax in axes for line in ax.get_lines() if len(line.get_xdata()) > 2)
    assert not any("FillBetween" in type(one).__name__ for ax in axes for one in ax.get_children())
    assert (axes[-1].get_xlabel(), (tmp_path / "e.png").is_file()) == ("pose", True)
