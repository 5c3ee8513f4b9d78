"""The table of experiments is complete."""

from pathlib import Path

from bodylog.experiments import EXPERIMENTS
from bodylog.experiments.table import TIMED

ROOT = Path(__file__).parents[2]


def test_every_experiment_has_its_file_and_every_file_its_line():
    folder = ROOT / "bodylog" / "experiments"
    files = {path.stem for path in folder.glob("*.py") if "EXPERIMENT = " in path.read_text()}
    listed = {experiment.run.__module__.rpartition(".")[2] for experiment in EXPERIMENTS.values()}
    assert files == listed
    assert all(name == experiment.name for name, experiment in EXPERIMENTS.items())
    assert set(TIMED) <= set(EXPERIMENTS)


def test_the_paper_has_six_experiments():
    assert {f"E{i}" for i in range(1, 7)} <= set(EXPERIMENTS)


def test_the_page_on_the_paper_names_every_experiment():
    page = (ROOT / "docs" / "paper.md").read_text()
    assert all(name in page for name in EXPERIMENTS)
