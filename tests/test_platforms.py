"""Systems that lack what Linux has: every module can be imported there, and the command line answers."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
_AS_WITHOUT_POSIX = """
import importlib, os, pathlib, signal, sys
for name in ("fcntl", "resource", "pwd", "termios"):
    sys.modules[name] = None  # importing it is an ImportError
for module, names in ((signal, ("SIGHUP", "pthread_sigmask")), (os, ("geteuid", "O_DIRECT"))):
    for name in names:
        delattr(module, name)
for package, folder in (("bodylog", "bodylog"), ("bodylog_cli", "cli")):
    for path in sorted(pathlib.Path(sys.argv[1], folder).rglob("*.py")):
        parts = path.relative_to(pathlib.Path(sys.argv[1], folder)).with_suffix("").parts
        if parts[-1] != "__main__":
            importlib.import_module(".".join((package, *parts)).removesuffix(".__init__"))
from bodylog.io import temporary
with temporary.create_scratch_folder() as folder:
    (folder / "x").write_text("y")
assert not folder.exists()
import bodylog_cli
raise SystemExit(bodylog_cli.run_command(["--version"]))
"""


def test_every_module_is_imported_without_posix_only_modules() -> None:
    command = [sys.executable, "-W", "error", "-c", _AS_WITHOUT_POSIX, str(ROOT)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.startswith("bodylog, version")
