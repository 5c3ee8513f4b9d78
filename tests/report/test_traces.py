"""Panels of the report: a fault has one story."""

import numpy as np
import pytest

from bodylog.report.page.traces import list_panels
from tests.report import records


@pytest.mark.parametrize(
    ("named", "drawn"),
    [
        (records.JOINTS[0], {records.JOINTS[0]}),
        (f"{records.JOINTS[0]} or {records.JOINTS[1]}", set(records.JOINTS[:2])),
        (None, set(records.JOINTS)),
    ],
)
def test_offsets_are_drawn_of_the_joints_that_faults_name(named, drawn):
    found = records.estimate()
    faults = () if named is None else (records.Fault("encoders", named, records.FaultKind.DRIFTING, 8.0, 0.3, "rad"),)
    offsets = records.series(found.joints.t, np.full(found.joints.values.shape, 0.1), records.JOINTS, "rad")
    found = records.estimate(faults=faults, bias=offsets)
    (panel,) = [one for one in list_panels(records.recording(), records.features(), found) if "offset" in one.title]
    assert {trace.name for trace in panel.traces} == drawn
