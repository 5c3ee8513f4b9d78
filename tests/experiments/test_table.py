"""The table of experiments is complete."""

from pathlib import Path

from bodylog.experiments import EXPERIMENTS

ROOT = Path(__file__).parents[2]


def test_experiments_table_matches_the_files():
    folder = ROOT / "bodylog" / "experiments"
    files = {path.stem for path in folder.glob("*.py") if "EXPERIMENT = " in path.read_text()}
    listed = {experiment.run.__module__.rpartition(".")[2] for experiment in EXPERIMENTS.values()}
    assert files == listed
    assert all(name == experiment.name for name, experiment in EXPERIMENTS.items())


def test_experiments_table_has_six_of_the_paper():
    assert {f"E{i}" for i in range(1, 7)} <= set(EXPERIMENTS)


def test_paper_page_names_every_experiment():
    page = (ROOT / "docs" / "paper.md").read_text()
    assert all(name in page for name in EXPERIMENTS)
