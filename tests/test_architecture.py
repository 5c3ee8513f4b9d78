"""Who may import whom (docs/architecture.md), read from the source."""

import ast
import subprocess
import sys
from pathlib import Path

import bodylog

ROOT = Path(__file__).parents[1]
STAGES = {"logs", "perception", "body", "estimation", "sim", "evaluation", "report"}
SHARED = {"kinematics"}
RECORDS = {"episodes", "types", "errors", "settings", "sources", "files", "outputs", "temporary", "threads", "values"}
LAYERS = (
    {*RECORDS, *SHARED, "memory", "stopping", "toml_file", "torn"},
    {"config", "stores", "workers"},
    STAGES,
    {"in_space", "robots"},
    {"changed", "online", "dates", "inventory", "joints_only", "zeros", "refusals", "remarks", "scoring", "sought"},
    {"pipeline"},
    {"present", "comparison"},
    {"batch", "experiments"},
)  # fmt: skip
PAGE = (ROOT / "docs" / "architecture.md").read_text()


def _imported(path: Path) -> set[str]:
    """First part below bodylog of everything a file of the package imports."""
    package = ["bodylog", *path.relative_to(ROOT / "bodylog").parent.parts]
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            base = package[: len(package) + 1 - node.level] if node.level else []
            full = [*base, *(node.module or "").split(".")] if node.module else base
            names = [".".join([*full, alias.name]) for alias in node.names]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        else:
            continue
        found |= {name for name in names if name.split(".")[0] in ("bodylog", "click", "cli", "bodylog_cli")}
    return {name.split(".")[1] if name.startswith("bodylog.") else name.split(".")[0] for name in found}


def test_stages_import_only_records_and_themselves():
    wrong = {}
    for path in (ROOT / "bodylog").rglob("*.py"):
        parts = path.relative_to(ROOT / "bodylog").parts
        urls = {"stores"} if parts[0] == "logs" else set()
        allowed = RECORDS | SHARED | urls | {parts[0]} if parts[0] in STAGES else None
        if allowed is not None and (extra := _imported(path) - allowed):
            wrong[str(path)] = extra
    assert not wrong


def test_whatever_is_no_stage_imports_only_what_stands_below_it():
    wrong = {}
    for path in (ROOT / "bodylog").rglob("*.py"):
        part = path.relative_to(ROOT / "bodylog").parts[0].removesuffix(".py")
        if part not in STAGES | {"__init__"}:
            (level,) = (k for k, layer in enumerate(LAYERS) if part in layer)
            below = set().union(*LAYERS[: max(level, 1)], {part, "__version__"})
            wrong |= {str(path): extra for extra in [_imported(path) - below] if extra}
    assert not wrong


def test_every_file_of_a_stage_stands_in_the_page_on_the_architecture():
    paths = [path for stage in STAGES | SHARED for path in (ROOT / "bodylog" / stage).rglob("*.py")]
    files = {path.stem for path in paths if path.parent.name != "scenarios"} - {"__init__"}
    assert not {name for name in files if f"`{name}`" not in PAGE}, "say in docs/architecture.md what they are for"


def test_library_never_prints_exits_or_reads_the_environment():
    wrong = []
    for path in (ROOT / "bodylog").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and ast.unparse(node.func) in ("print", "exit", "sys.exit", "os.getenv"):
                wrong.append(f"{path}:{node.lineno}")
            if isinstance(node, ast.Attribute) and ast.unparse(node) == "os.environ":
                wrong.append(f"{path}:{node.lineno}")
            if isinstance(node, ast.Import | ast.ImportFrom) and "click" in ast.unparse(node).split():
                wrong.append(f"{path}:{node.lineno}")
    assert not wrong


def test_all_that_is_public_is_there():
    assert set(bodylog.__all__) == {name for name in bodylog.__all__ if getattr(bodylog, name)}
    assert bodylog.estimate is bodylog.pipeline.estimate


def test_importing_bodylog_and_asking_for_help_imports_nothing_heavy():
    code = "import sys, bodylog, bodylog_cli\nbodylog_cli.run(['--help'])\nprint(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not {"numpy", "scipy", "cv2", "rosbags", "mcap", "pybullet", "matplotlib", "rich"} & set(loaded)
