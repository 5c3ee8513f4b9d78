"""The tutorial runs, and generated pages and the repository's own files are current."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from bodylog_cli.commands import bodylog
from ruamel.yaml import YAML

from bodylog import __version__
from docs.generate_cli import page

ROOT = Path(__file__).parents[1]
CONTRIBUTING = (ROOT / ".github" / "CONTRIBUTING.md").read_text()
TUTORIAL = (ROOT / "docs" / "tutorial.md").read_text()


def test_cli_reference_is_what_help_says():
    assert (ROOT / "docs" / "cli.md").read_text() == page(), "type: make docs"


@pytest.mark.parametrize("name", bodylog.commands)
def test_help_of_each_command_ends_with_an_example(name):
    command = bodylog.commands[name]
    assert command.help
    assert command.epilog is not None and command.epilog.startswith(f"Example: bodylog {name}")


def test_help_and_formats_page_name_every_method():
    from bodylog.estimation import METHODS

    (method,) = (option for option in bodylog.commands["estimate"].params if option.name == "method")
    assert set(method.type.choices) == set(METHODS)
    (faults,) = re.findall(r"^\| `/bodylog/faults`.*$", (ROOT / "docs" / "formats.md").read_text(), re.MULTILINE)
    methods = "`kalman` and `predictive-coding`"
    assert f"{methods} report frozen, dead and jumping encoders and glitches, but no drift" in faults


def test_formats_page_lists_every_written_topic():
    page = (ROOT / "docs" / "formats.md").read_text()
    topics = re.findall(r'PREFIX \+ "(\w+)', (ROOT / "bodylog" / "annotating" / "messages.py").read_text())
    assert len(topics) > 10 and not {topic for topic in topics if f"/bodylog/{topic}" not in page}


def test_cli_page_explains_shell_completion():
    page = (ROOT / "docs" / "cli.md").read_text()
    for shell in re.findall(r"_BODYLOG_COMPLETE=(\w+)_source", page):
        assert shell in {"bash", "zsh", "fish"}
    environment = {**os.environ, "_BODYLOG_COMPLETE": "zsh_source"}
    program = Path(sys.executable).with_name("bodylog")
    done = subprocess.run([program], env=environment, capture_output=True, text=True)
    assert done.returncode == 0 and "#compdef bodylog" in done.stdout


def test_readme_has_at_most_100_lines():
    assert len((ROOT / "README.md").read_text().splitlines()) <= 100


def test_citation_names_this_version():
    citation = YAML(typ="safe").load(ROOT / "CITATION.cff")
    assert {"cff-version", "message", "title", "authors"} <= set(citation)
    assert citation["version"] == __version__
    (paper,) = citation["references"]
    assert paper["year"] == 2018 and [author["family-names"] for author in paper["authors"]] == ["Lanillos", "Cheng"]


def test_issue_forms_ask_for_what_info_prints():
    for name in ("bug", "robot"):
        form = YAML(typ="safe").load(ROOT / ".github" / "ISSUE_TEMPLATE" / f"{name}.yml")
        labels = [field["attributes"]["label"] for field in form["body"]]
        assert "bodylog info --json LOG" in labels


def test_workflows_run_commands_that_exist():
    targets = set(re.findall(r"^([\w$(/).-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    for path in (ROOT / ".github" / "workflows").glob("*.yml"):
        jobs = YAML(typ="safe").load(path)["jobs"].values()
        lines = [step["run"] for job in jobs for step in job["steps"] if "run" in step]
        made = {line.split()[1].replace(".venv", "$(VENV)") for line in lines if line.startswith("make ")}
        assert made and made <= targets
        assert all((ROOT / script).is_file() for line in lines for script in re.findall(r"tests/\w+\.py", line))


def test_tutorial_runs_word_for_word(tmp_path):
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    run = {"bash": ("bash", "-ec"), "python": (sys.executable, "-W", "error", "-c")}
    printed = ""
    for language, block in re.findall(r"```(bash|python|text)\n(.*?)```", TUTORIAL, re.DOTALL):
        if language == "text":
            assert _numbers(block) == pytest.approx(_numbers(printed)[-len(_numbers(block)) :], rel=0.05)
            assert _words(printed).endswith(_words(block))
            continue
        command, environment = [*run[language], block], {**os.environ, "PATH": path}
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, env=environment)
        assert done.returncode == 0, f"{block}\n{done.stdout}\n{done.stderr}"
        printed = done.stdout
    assert {"body.npz", "smooth.mcap", "smooth.png", "report.html", "results"} <= {p.name for p in tmp_path.iterdir()}


def _numbers(text: str) -> list[float]:
    return [float(number) for number in re.findall(r"\d[\d.]*", text)]


def _words(text: str) -> str:
    return " ".join(re.sub(r"\d[\d.]*", "", text).split())


WRITTEN = [
    path.read_text(errors="ignore")
    for folder in ("bodylog", "cli", "tests", "docs")
    for path in (ROOT / folder).rglob("*")
    if path.suffix in (".py", ".js")
] + [(ROOT / name).read_text() for name in ("pyproject.toml", "Makefile")]


@pytest.mark.parametrize("page", [".github/CONTRIBUTING.md", "docs/architecture.md", "docs/decisions.md"])
def test_pages_for_developers_name_what_exists(page):
    words = set(re.findall(r"\w+", "\n".join(WRITTEN)))
    text = (ROOT / page).read_text()
    names = {name.rpartition(".")[2] for name in re.findall(r"`([A-Za-z_][\w.]*)(?:\(\))?`", text)}
    assert names and not names - words


@pytest.mark.parametrize("table, file", re.findall(r"\| `([A-Z_]+)` in `([\w/]+\.py)` \|", CONTRIBUTING))
def test_contributing_names_tables_where_they_stand(table, file):
    assert re.search(rf"^{table}\b.* = ", (ROOT / file).read_text(), re.MULTILINE)


def test_every_friction_has_a_test_that_exists():
    section = CONTRIBUTING.partition("## What a new user meets")[2]
    rows = [line for line in section.splitlines() if line.startswith("| ")][1:]
    defined = set(re.findall(r"^def (test_\w+)", "\n".join(WRITTEN), re.MULTILINE))
    named = [re.findall(r"`(test_\w+)`", row.split("|")[3]) for row in rows]
    assert rows and all(named)
    assert not {name for names in named for name in names} - defined
