"""The environments in which the tests of numbers run as on other processors."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests import every_processor
from tests.every_processor import PROFILES, Outcome


def test_profile_may_be_skipped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cpu = tmp_path / "cpuinfo"
    cpu.write_text("model name : x\nflags : fpu avx2 fma avx512f\nbugs : none\n")
    monkeypatch.setattr(every_processor, "CPU", cpu)
    assert every_processor.lacking(PROFILES["haswell"]) == []
    assert every_processor.lacking(PROFILES["skylakex"]) == ["avx512bw", "avx512dq", "avx512vl"]


@pytest.mark.parametrize("name", PROFILES)
def test_numpy_takes_the_environment_without_a_warning(name: str) -> None:
    code = "import numpy; print(numpy.ones(3).sum())"
    command = [sys.executable, "-W", "error", "-c", code]
    surroundings = every_processor.environment(PROFILES[name])
    done = subprocess.run(command, env=surroundings, capture_output=True, text=True)
    assert done.stdout == "3.0\n" and not done.stderr


def test_profiles_of_equal_rounding_must_give_the_same_bytes() -> None:
    own = Outcome("a", "b", np.zeros((2, 3)))
    other = Outcome("a", "c", np.full((2, 3), 1e-9))
    far = Outcome("a", "c", np.full((2, 3), 1e-4))
    assert not every_processor.differs("zen", {"haswell": own, "zen": own})
    assert "rounds alike" in every_processor.differs("zen", {"haswell": own, "zen": other})
    assert not every_processor.differs("old", {"haswell": own, "old": other})
    assert "WRONG" in every_processor.differs("old", {"haswell": own, "old": far})
