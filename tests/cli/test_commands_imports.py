"""What `bodylog info` and `import bodylog.logs` need not import is not imported: it takes longer than the work."""

import subprocess
import sys
from pathlib import Path

import pytest

LOG = Path(__file__).parents[2] / "fixtures" / "containers" / "zstd.mcap"
ARM = Path(__file__).parents[2] / "fixtures" / "arm" / "reach.mcap"
HEAVY = ("cv2", "scipy", "numba", "matplotlib", "rich", "numpy.ma", "concurrent.futures", "logging", "hashlib", "shutil",
         "rosbags", "mcap", "ruamel", "threadpoolctl", "simplejpeg", "fsspec", "bodylog.pipeline")  # fmt: skip
INFO = f"""
import sys, bodylog_cli
assert bodylog_cli.run_command(["info", {str(LOG)!r}]) == 0
"""
READ = f"""
import sys, bodylog.logs
assert "numpy" not in sys.modules
with bodylog.logs.open({str(LOG)!r}) as log:
    log.read({{topic.name: [] for topic in log.topics}})
"""


@pytest.mark.parametrize("script", [INFO, READ])
def test_import_loads_no_heavy_module(script):
    assert not _heavy(script) - _heavy("import numpy, sys")  # NumPy 1 imports some of these


def _heavy(script):
    ask = f"print(*[name for name in {HEAVY!r} if name in sys.modules], file=sys.stderr)"
    command = [sys.executable, "-c", f"{script}\n{ask}"]
    return set(subprocess.run(command, capture_output=True, text=True, check=True, cwd="/").stderr.split())


@pytest.mark.parametrize("command", ["doctor", "extract", "convert", "fit"])
def test_commands_that_estimate_nothing_import_no_numba(tmp_path, command):
    log = ARM.with_name("explore.mcap") if command == "fit" else ARM
    typed = [command, str(log), *(() if command == "doctor" else ("-o", str(tmp_path / "out.mcap")))]
    script = f"import sys, bodylog_cli\nassert not bodylog_cli.run_command({typed!r})\nsys.exit('numba' in sys.modules)"
    subprocess.run([sys.executable, "-c", script], capture_output=True, check=True, cwd="/")


def test_command_imports_only_its_own_module():
    script = f"{INFO}print(*[name for name in sys.modules if name.startswith('bodylog_cli.')], file=sys.stderr)"
    command = [sys.executable, "-c", script]
    found = subprocess.run(command, capture_output=True, text=True, check=True, cwd="/").stderr.split()
    shared = {f"bodylog_cli.{name}" for name in ("commands", "options", "output", "places", "setting_options")}
    assert set(found) == shared | {"bodylog_cli.info"}
