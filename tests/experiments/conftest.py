"""A small reproduction, made once: one experiment, one seed, small pictures, a short exploration."""

import pytest

from bodylog.experiments import Reproduction, reproduce


@pytest.fixture(scope="session")
def small(tmp_path_factory):
    pytest.importorskip("pybullet", reason="PyBullet is not installed: pip install 'bodylog[sim]'")
    pytest.importorskip("matplotlib", reason="figures need matplotlib: pip install 'bodylog[report]'")
    told = []
    wish = Reproduction(tmp_path_factory.mktemp("out"), ("E2",), seeds=1, jobs=1, size=(160, 120), exploration=8.0)
    claims = reproduce(wish, lambda *said: told.append(said))
    return wish, claims, told
