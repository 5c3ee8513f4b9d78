"""From nothing: what `bodylog info` takes on a small log, and `import bodylog.logs`, each in a fresh process."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from bodylog.sim import record_scenario
from tests.benchmarks.goals import at_most
from tests.benchmarks.timing import side_by_side

_LIMIT_S = 0.15


def main() -> None:
    """CPU seconds of fresh processes, bytecode and files in the page cache, as for whoever types a second command."""
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "small.mcap"
        record_scenario("reach", log, duration=10.0, size=(320, 240))
        shell = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
        shell |= {"PYTHONPYCACHEPREFIX": str(Path(folder) / "bytecode"), "OPENBLAS_NUM_THREADS": "1"}
        read = f"import bodylog.logs as logs\nwith logs.open({str(log)!r}) as log: log['/joint_states'].position"
        commands = {
            "python -c pass": ["-c", "pass"],
            "import numpy": ["-c", "import numpy"],
            "import bodylog.logs": ["-c", "import bodylog.logs"],
            "open a log and read the joints' positions": ["-c", read],
            "bodylog --help": ["-m", "bodylog_cli", "--help"],
            "bodylog info": ["-m", "bodylog_cli", "info", str(log)],
        }
        cases = {name: lambda typed=typed: _run(typed, shell) for name, typed in commands.items()}
        took = side_by_side(f"fresh processes, a log of {log.stat().st_size / 1e6:.1f} MB", cases, 10, cpu=True)
    bare = f"python alone {took['python -c pass']:.3f} s, with numpy {took['import numpy']:.3f} s"
    at_most("`bodylog info` on a small log, fresh process", took["bodylog info"], _LIMIT_S, "CPU s", bare)
    at_most("`import bodylog.logs`, fresh process", took["import bodylog.logs"], _LIMIT_S, "CPU s", bare)


def _run(typed: list[str], shell: dict[str, str]) -> None:
    subprocess.run([sys.executable, *typed], check=True, capture_output=True, env=shell)


if __name__ == "__main__":
    main()
