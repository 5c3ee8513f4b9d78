"""What is imported is declared in pyproject.toml, and what is declared is imported."""

import ast
import re
import sys
import tomllib
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS = PROJECT["optional-dependencies"]
DISTRIBUTIONS = {
    "PIL": "pillow",
    "aiohttp": "fsspec",  # of its extra http
    "cv2": "opencv-python-headless",
    "google": "protobuf",
    "mcap_protobuf": "mcap-protobuf-support",
    "mcap_ros2": "mcap-ros2-support",
    "pybag": "pybag-sdk",
    "rerun": "rerun-sdk",
    "rerun_cli": "rerun-sdk",
    "ruamel": "ruamel.yaml",
    "sklearn": "scikit-learn",
    "xdist": "pytest-xdist",
}
"""Modules whose distribution has another name."""

OURS = {"bodylog", "bodylog_cli", "tests", "docs", "fixtures"}
OURS_ALONE = {"test", "bench", "docs"}
"""Extras for developers: test tools, the peers of the benchmarks, and what builds the site."""

COMMANDS = {"ipykernel", "mypy", "ruff", "build", "pytest-xdist", "rosbags-image", "setuptools", "uv"}
"""Test tools that are run, or found by their framework, and not imported."""


def _declared(*extras):
    """Distributions of the dependencies and of these extras."""
    listed = [*PROJECT["dependencies"], *(word for extra in extras for word in EXTRAS[extra])]
    return {re.match(r"[\w.-]+", word).group() for word in listed}


def _called(node):
    """The last part of the name of what a call calls."""
    return getattr(node.func, "attr", getattr(node.func, "id", ""))


@cache
def _modules_of(path):
    """What a file imports, wherever in it."""
    modules = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            modules |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level:
            modules.add(node.module.split(".")[0])
        elif isinstance(node, ast.Call) and _called(node) in ("import_module", "importorskip", "require_module"):
            modules |= {arg.value.split(".")[0] for arg in node.args[:1] if isinstance(arg, ast.Constant)}
    return modules


def _imported(*folders):
    """Distributions of what the files of these folders import, wherever in a file."""
    paths = (path for folder in folders for path in (ROOT / folder).rglob("*.py"))
    third = set().union(*map(_modules_of, paths)) - set(sys.stdlib_module_names) - OURS
    return {DISTRIBUTIONS.get(module, module) for module in third}


def test_package_imports_are_dependencies_or_extras():
    assert _imported("bodylog", "cli") == _declared(*(set(EXTRAS) - OURS_ALONE - {"all"}))


def test_imports_of_tests_are_declared():
    assert not _imported("tests", "docs") - _declared(*(set(EXTRAS) - {"all"}))
    assert not _declared("test") - _declared() - _imported("tests") - COMMANDS
    assert not _declared("bench") - _declared() - _imported("tests/benchmarks")


def test_extra_all_has_every_extra_except_tests():
    (listed,) = EXTRAS["all"]
    assert set(re.search(r"\[(.*)\]", listed).group(1).split(",")) == set(EXTRAS) - OURS_ALONE - {"all"}


def test_dependencies_bound_only_the_lowest_version():
    words = [*PROJECT["dependencies"], *(word for extra in set(EXTRAS) - {"all"} for word in EXTRAS[extra])]
    assert not [word for word in words if not re.fullmatch(r"[\w.\[\]-]+>=[\d.]+", word)]


def test_wheel_has_every_package():
    listed = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"])
    there = {path.parent.relative_to(ROOT) for path in (ROOT / "bodylog").rglob("__init__.py")}
    assert listed == {".".join(path.parts) for path in there} | {"bodylog_cli"}
