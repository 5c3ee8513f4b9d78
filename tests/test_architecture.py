"""Who may import whom (docs/architecture.md), read from the source."""

import ast
import re
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

import bodylog

ROOT = Path(__file__).parents[1]
BELOW = {"errors", "version", "wording", "io", "runtime"}
RECORDS = {*BELOW, "logs", "types", "fault_kinds", "body_model", "overlay_style", "score_names", "settings", "sources"}
ROOMS = {
    "__main__": set(),
    "errors": set(),
    "version": set(),
    "wording": set(),
    "runtime": {"errors"},
    "io": {"errors", "runtime"},
    "logs": BELOW,
    "score_names": BELOW,
    "sources": BELOW,
    "choices": set(),
    "settings": {*BELOW, "logs", "sources"},
    "fault_kinds": BELOW,
    "types": {*BELOW, "body_model", "fault_kinds", "logs", "settings"},
    "body_model": {*BELOW, "logs"},
    "overlay_style": RECORDS,
    "config": RECORDS,
    "kinematics": RECORDS,
    "bfgs": RECORDS,
    "linear_algebra": RECORDS,
    "motion": RECORDS,
    "annotating": RECORDS,
    "recording": {*RECORDS, "annotating"},
    "perception": RECORDS,
    "body": {*RECORDS, "bfgs", "kinematics", "linear_algebra", "motion"},
    "estimation": {*RECORDS, "bfgs", "kinematics", "linear_algebra", "motion"},
    "evaluation": {*RECORDS, "motion"},
    "report": RECORDS,
    "sim": {*RECORDS, "choices", "kinematics"},
}
"""Which parts of bodylog a room may import; what imports several rooms stands in LAYERS, each above the one before."""
LAYERS = (
    {"robot"},
    {"checks", "features", "info", "online"},
    {"findings"},
    {"delays"},
    {"surface"},
    {"pipeline"},
    {"compare", "views"},
    {"dataset"},
    {"batch", "experiments"},
)
PAGE = (ROOT / "docs" / "architecture.md").read_text()


def _modules() -> dict[str, Path]:
    """Every module of the package, and the file it stands in."""
    found = {}
    for path in (ROOT / "bodylog").rglob("*.py"):
        parts = path.relative_to(ROOT).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


MODULES = _modules()


@cache
def _nodes(path: Path) -> list[ast.AST]:
    """All nodes of a file; several tests read them."""
    return [*ast.walk(ast.parse(path.read_text()))]


@cache
def _imports(module: str) -> set[str]:
    """Full names of what a module imports, wherever in the file; of this package, modules alone."""
    path, found = MODULES[module], set()
    package = module.split(".")[: None if path.name == "__init__.py" else -1]
    for node in _nodes(path):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) + 1 - node.level] if node.level else []
            full = ".".join([*base, *([node.module] if node.module else [])])
            names = {f"{full}.{alias.name}" for alias in node.names}
            found |= {name if name in MODULES else full for name in names} - {module}
    return found


def _room(module: str) -> str:
    return module.split(".")[1] if module.startswith("bodylog.") else module.split(".")[0]


def test_rooms_import_only_what_stands_below_them():
    wrong, below = {}, set(ROOMS)
    allowed = {room: {*names, room} for room, names in ROOMS.items()}
    for layer in LAYERS:
        below |= layer
        allowed |= {room: set(below) for room in layer}
    for module in MODULES:
        ours = {_room(name) for name in _imports(module) if name.split(".")[0] in ("bodylog", "click", "cli", "bodylog_cli")}
        if module != "bodylog" and (extra := ours - allowed[_room(module)]):
            wrong[module] = extra
    assert not wrong


def test_imports_run_in_no_circle():
    left = {module: {name for name in _imports(module) if name in MODULES} for module in MODULES}
    while free := {module for module, names in left.items() if not names & left.keys()}:
        left = {module: names for module, names in left.items() if module not in free}
    assert not left


def test_modules_have_a_docstring():
    assert not [name for name, path in MODULES.items() if not ast.get_docstring(_nodes(path)[0])]


def test_architecture_page_lists_every_file():
    paths = [path for path in (ROOT / "bodylog").rglob("*.py") if path.parent.name != "scenarios"]
    files = {path.stem for path in paths} - {"__init__", "version"}
    missing = {name for name in files if f"`{name}`" not in PAGE and f"`{name}.py`" not in PAGE}
    assert not missing, "say in docs/architecture.md what they are for"


def test_library_never_prints_exits_or_reads_the_environment():
    wrong = []
    for path in (ROOT / "bodylog").rglob("*.py"):
        for node in _nodes(path):
            if isinstance(node, ast.Call) and ast.unparse(node.func) in ("print", "exit", "sys.exit", "os.getenv"):
                wrong.append(f"{path}:{node.lineno}")
            if isinstance(node, ast.Attribute) and node.attr == "environ" and ast.unparse(node) == "os.environ":
                wrong.append(f"{path}:{node.lineno}")
            if isinstance(node, ast.Import | ast.ImportFrom) and "click" in ast.unparse(node).split():
                wrong.append(f"{path}:{node.lineno}")
    assert not wrong


def test_public_names_exist():
    assert set(bodylog.__all__) == {name for name in bodylog.__all__ if getattr(bodylog, name)}
    assert bodylog.estimate is bodylog.pipeline.estimate


def test_importing_bodylog_and_asking_for_help_imports_nothing_heavy():
    code = "import sys, bodylog, bodylog_cli\nbodylog_cli.run_command(['--help'])\nprint(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not {"numpy", "scipy", "cv2", "rosbags", "mcap", "pybullet", "matplotlib", "numba", "rich"} & set(loaded)


def test_simulation_and_experiments_are_imported_by_nothing_else():
    """But where they are offered: what is installed without them reads, learns and estimates."""
    offered = {"sim": {"bodylog/pipeline.py"}, "experiments": {"cli/reproduce.py"}}
    for room, places in offered.items():
        wanted = re.compile(rf"^\s*(from|import) .*\b{room}\b", re.MULTILINE)
        files = [*(ROOT / "bodylog").rglob("*.py"), *(ROOT / "cli").glob("*.py")]
        outside = (path.relative_to(ROOT) for path in files if not {"sim", "experiments"} & set(path.parts))
        assert {path.as_posix() for path in outside if wanted.search((ROOT / path).read_text())} == places


BEHAVIOURS = {
    "": {
        "architecture",
        "benchmark_goals",
        "dependencies",
        "docs",
        "every_processor",
        "method_page",
        "pages",
        "paper_page",
        "platforms",
        "python_use",
        "validation_page",
    },
    "adversary": {"adversary", "bombs", "servers"},
    "cli": {
        "dataset_episodes",
        "pose_tables",
        "printed_tags",
        "real_robots",
        "refusals",
        "seven_joints",
        "stopped_commands",
        "two_cameras",
    },
    "clients": {"mcap_core"},
    "estimation": {"attainable_error", "recorded_arm"},
    "experiments": {"notebooks"},
    "logs": {"damaged_datasets", "hostile_content", "real_logs"},
    "perception": {"rounding", "simulated_logs"},
}
"""Tests of the repository and of whole behaviours, by folder: they are named for no module."""


def _list_tested_names() -> dict[str, set[str]]:
    """What tests may be named for, by folder: a module, its folder, or the two joined."""
    found: dict[str, set[str]] = {}
    for path in [*(ROOT / "bodylog").rglob("*.py"), *(ROOT / "cli").glob("*.py")]:
        *folders, name = path.relative_to(ROOT).with_suffix("").parts
        room = "cli" if folders[0] == "cli" else "".join(folders[1:2])
        found.setdefault(room, set()).update({name, folders[-1], f"{folders[-1]}_{name}"})
    return found


def test_tests_are_named_for_what_they_test():
    tested = _list_tested_names()
    unused = {(room, name) for room, names in BEHAVIOURS.items() for name in names}
    wrong = []
    for path in sorted((ROOT / "tests").rglob("test_*.py")):
        *folders, name = path.relative_to(ROOT / "tests").with_suffix("").parts
        room = "".join(folders[:1])
        name = name.removeprefix("test_")
        if name in BEHAVIOURS.get(room, ()):
            unused -= {(room, name)}
        elif not any(f"{name}_".startswith(f"{one}_") for one in tested.get(room, ())):
            wrong.append(str(path.relative_to(ROOT)))
    assert not wrong, "name it test_MODULE.py or test_MODULE_ASPECT.py, in the folder of its module"
    assert not unused, "BEHAVIOURS names tests that are gone"


def test_tests_import_nothing_from_other_tests():
    wrong = []
    for path in (ROOT / "tests").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.level or str(node.module).startswith("tests")):
                names = [*str(node.module).split("."), *(alias.name for alias in node.names)]
                if any(name.startswith("test_") for name in names):
                    wrong.append(f"{path.relative_to(ROOT)}:{node.lineno}")
    assert not wrong, "what several tests use stands in a module of their folder that is no test"


CHANGES = {
    "a container of logs": {
        "bodylog/logs/ours.py": """
from .mcap.reader import McapLog


def open_ours(path, strict, source, limits):
    inside = path.with_suffix(".inside")
    inside.write_bytes(source.read_bytes()[6:])
    return McapLog(path, strict, inside, limits)
""",
        "bodylog/logs/formats.py": (
            (line := "FORMATS: Mapping[bytes, Opener] = {\n"),
            "def _open_ours(*log):\n    from .ours import open_ours\n\n    return open_ours(*log)\n\n\n"
            + line
            + "    b'OURLOG': _open_ours,\n",
        ),
    },
    "a method": {
        "bodylog/estimation/methods/ours.py": """
from ...types import Capabilities
from . import filtering
from .contract import Method

METHODS = {"ours": Method(filtering.estimate_by_filter, Capabilities(), live=True)}
""",
        "bodylog/settings.py": ('    "kalman": "kalman",\n', '    "kalman": "kalman",\n    "ours": "ours",\n'),
    },
    "a fault of a sensor": {
        "bodylog/fault_kinds.py": (
            (kind := '    GLITCH = "glitch"\n'),
            kind + '    SLEEPY = "sleepy"\n',
            (line := "FORMS: Mapping[tuple[str, FaultKind], FaultForm] = {\n"),
            line + '    ("encoders", FaultKind.SLEEPY): FaultForm("encoder is sleepy {since}"),\n',
        ),
        "bodylog/estimation/faults/encoder_faults.py": (
            (found := "        for fault in one.faults\n        ],\n    )\n"),
            found + '    faults.append(Fault("encoders", body.joints[0], FaultKind.SLEEPY, 1.0, 0.1, "rad"))\n',
        ),
    },
    "a motion model": {
        "bodylog/motion.py": (
            (table := 'WHITE_ACCELERATION = "white-acceleration"\n'),
            """class Fading(WhiteNoise):
    def transition(self, gap: Array) -> Array:
        moved = super().transition(gap)
        moved[:, :, 2] *= np.exp(-gap)[:, None]
        return moved


"""
            + table,
            (line := "    WHITE_JERK: WhiteNoise(3),\n"),
            line + '    "ours": Fading(3),\n',
        ),
    },
    "the words of a fault, of a verdict, of a score, of a setting": {
        "bodylog/findings/verdict.py": ("no fault found in", "none of these has a fault:")
    },
}
"""What someone changes who has the page alone: the text of a new file, or texts and what replaces each in a file."""


def test_a_change_is_placed_by_the_page_in_two_files_at_most(tmp_path):
    for room in ("bodylog", "cli"):
        shutil.copytree(ROOT / room, tmp_path / {"cli": "bodylog_cli"}.get(room, room))
    for change, files in CHANGES.items():
        (row,) = re.findall(rf"^\| {change} \| (.*) \|$", PAGE, re.MULTILINE)
        assert len(files) <= 2
        for name, text in files.items():
            path = tmp_path / name
            if isinstance(text, str):
                assert f"`{path.parent.relative_to(tmp_path / 'bodylog').as_posix()}/`" in row and not path.exists()
                path.write_text(text)
                continue
            assert path.name in row
            written = path.read_text()
            for old, new in zip(text[::2], text[1::2], strict=True):
                assert written.count(old) == 1
                written = written.replace(old, new)
            path.write_text(written)
    log = tmp_path / "log.ours"
    log.write_bytes(b"OURLOG" + (ROOT / "fixtures" / "arm" / "reach.mcap").read_bytes())
    config = tmp_path / "robot.toml"
    config.write_text('[estimate]\nmotion = "ours"\n')
    typed = ("estimate", log, "--method", "ours", "--config", config, "-o", tmp_path / "out.mcap")
    command = [sys.executable, "-m", "bodylog_cli", *map(str, typed)]
    printed = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True).stdout
    assert "encoder is sleepy since 1.0 s" in printed and "none of these has a fault:" in printed
    assert b'"motion": "ours"' in (tmp_path / "out.mcap").read_bytes()
