"""A small reproduction, made once: one experiment, one seed, a short exploration."""

import pytest

from bodylog.experiments import Reproduction, run_reproduction


@pytest.fixture(scope="session")
def small(tmp_path_factory):
    """E2 in one reading."""
    pytest.importorskip("pybullet", reason="PyBullet is not installed: pip install 'bodylog[sim]'")
    pytest.importorskip("matplotlib", reason="figures need matplotlib: pip install 'bodylog[report]'")
    calls = []
    out = tmp_path_factory.mktemp("out")
    wish = Reproduction(out, ("E2",), seeds=1, jobs=1, exploration=8.0, reading={"speed": "4"})
    claims = run_reproduction(wish, lambda *text: calls.append(text))
    return wish, claims, calls
