"""Real robots' poses: missing files are named; others are judged on the published split."""

from pathlib import Path

import pytest

from bodylog.errors import UsageError
from bodylog.experiments import Reproduction, run_reproduction
from bodylog.experiments.claims import OWN_HOLDS
from bodylog.experiments.real import EXPERIMENT, ROBOTS, digest_tables, has_all_files, measure_nao
from bodylog.experiments.records import ExperimentReadings

REAL = Path(__file__).parents[3] / "shared" / "real"
DOCS = Path(__file__).parents[2] / "docs" / "real.md"


def test_folder_without_measurements_is_refused_before_running(tmp_path):
    with pytest.raises(
        UsageError, match=r"no robot's measurements in it; possible: nao/left_train\.csv.*docs/real\.md"
    ):
        run_reproduction(Reproduction(tmp_path / "out", ("Real",), data=tmp_path))
    assert not (tmp_path / "out").exists()


def test_page_states_the_source_of_each_robots_files():
    text = DOCS.read_text()
    assert all(name in text for robot in ROBOTS.values() for name in robot.files)


def test_missing_robot_is_in_the_table_without_a_claim():
    trial = {"figures": {"NAO ours": 1.7, "NAO published": 2.13}, "panels": [], "said": {"Panda": "not in here"}}
    claims = EXPERIMENT.claims([trial], ExperimentReadings(({},)))
    assert [claim.id for claim in claims] == ["Real.1"] and claims[0].verdict == OWN_HOLDS
    assert list(claims[0].outcomes) == ["published", "ours"] and claims[0].shared and claims[0].differences
    assert ("Panda", "not judged: not in here") in EXPERIMENT.tables([trial])[0].rows


@pytest.fixture
def measured():
    if not has_all_files(REAL, ROBOTS["NAO"]):
        pytest.skip("the measured poses (../shared/real) are not at hand")
    return REAL


def test_fingerprint_changes_with_the_files(measured, tmp_path):
    for name in ROBOTS["NAO"].files:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes((measured / name).read_bytes())
    before = digest_tables(tmp_path)
    (tmp_path / "nao" / "nao.urdf").write_text("<robot/>")
    assert digest_tables(tmp_path) != before


@pytest.mark.soak
def test_nao_prediction_beats_its_published_calibration(measured, tmp_path):
    found = measure_nao(measured, tmp_path)
    assert found["published"] == pytest.approx(2.13, abs=0.01)
    assert found["ours"] < 1.9 < found["published"] < found["ours, process alone"]
