"""What building the package asks for."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SETUPTOOLS = "import setup; setup.build_meta.get_requires_for_build_wheel = lambda config_settings: ['more']\n"
"""The backend, beside a setuptools that asks for one more package, and need not read the whole project for that."""


@pytest.mark.parametrize("hook", ["get_requires_for_build_wheel", "get_requires_for_build_editable"])
@pytest.mark.parametrize(
    ("programs", "environment", "wanted"),
    [
        ([], {}, ["more", "ziglang"]),
        ([], {"CC": ""}, ["more", "ziglang"]),
        (["ld"], {}, ["more", "ziglang"]),
        (["cc"], {}, ["more"]),
        (["gcc"], {}, ["more"]),
        (["clang"], {}, ["more"]),
        ([], {"CC": "icx -m64"}, ["more"]),
    ],
)
def test_backend_asks_for_a_compiler_where_there_is_none(tmp_path, hook, programs, environment, wanted):
    for name in programs:
        (tmp_path / name).touch(0o755)
    command = [sys.executable, "-c", f"{SETUPTOOLS}print(setup.{hook}())"]
    surroundings = {"PATH": str(tmp_path), **environment}
    printed = subprocess.run(command, cwd=ROOT, env=surroundings, capture_output=True, text=True, check=True).stdout
    assert printed.strip() == str(wanted)
