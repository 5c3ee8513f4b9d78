"""Links, snippets and commands of every page: links lead somewhere, settings are accepted, commands run."""

import json
import re
import shlex
import shutil
import tomllib
from importlib.util import find_spec
from pathlib import Path

import click
import numpy as np
import pytest
from bodylog_cli.commands import bodylog as commands

import bodylog
import bodylog.logs as logs
from bodylog.batch import manifest
from bodylog.config import load_settings
from bodylog.settings import Settings

ROOT = Path(__file__).parents[1]
PAGES = {
    str(path.relative_to(ROOT)): path.read_text()
    for path in sorted(
        [
            ROOT / "README.md",
            ROOT / "CHANGELOG.md",
            *ROOT.glob("docs/*.md"),
            *ROOT.glob(".github/*.md"),
        ]
    )
}
RUN_ELSEWHERE = {
    "docs/tutorial.md": "tests/test_docs.py",
    "docs/logs.md": "tests/logs/test_library.py",
}
"""Pages whose blocks another test runs word for word."""

NOT_RUN = {
    r"https?://|s3://": "no network: tests/io/test_remote.py reads logs behind URLs",
    r"bodylog reproduce": "takes minutes: tests/experiments runs it with few seeds",
    r"bodylog view \S+$": "opens a window",
    r"bodylog doctor DATASET": "tests/dataset runs it on drawn datasets",
    r"bodylog compare": "takes seconds: the test of README's figures below and docs/tutorial.md run it",
    r"--duration 40": "takes a minute: docs/tutorial.md records a shorter log",
    **({} if find_spec("rerun") else {r"bodylog view": "Rerun is not installed"}),
}
"""Commands that are parsed only, by pattern, and why."""

SMALL = ("--size", "160x120", "--duration", "10")
"""What a page's `record` is given besides: the rest of the page needs no more, and it takes a tenth of the time."""

FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
INDENTED = re.compile(r"(?:^ {4}\S.*\n)+", re.MULTILINE)


def _blocks(page: str, *languages: str) -> list[str]:
    return [body for language, body in FENCE.findall(PAGES[page]) if language in languages]


def _typed(page: str) -> list[str]:
    """Every command of a page's blocks, and each example of the command line's page, without comments."""
    indented = [
        block.replace("\n    ", "\n") for block in INDENTED.findall(FENCE.sub("", PAGES[page]))
    ]
    found = []
    for block in [*_blocks(page, "text", "bash", "yaml"), *indented]:
        for line in re.sub(r"\\\n\s*|(?<=-o)\n\s+", " ", block).splitlines():
            line = line.replace("${{ matrix.shard }}", "1")
            line = re.sub(r"^\s*(- run: |Example: |\$ )?|(?<=\s)#.*$|\s+>\s.*$", "", line)
            found += [part.strip() for part in line.split("&&")]
    return [
        line
        for line in found
        if re.match(r"(bodylog [a-z]|make |python -m |pip install |mkdocs )", line)
    ]


def _slug(heading: str) -> str:
    return re.sub(r"[\s-]+", "-", re.sub(r"[^\w\s-]", "", heading.lower())).strip("-")


@pytest.mark.parametrize("page", PAGES)
def test_page_links_resolve(page):
    folder = (ROOT / page).parent
    for target in re.findall(r"(?<!`)\]\(([^)\s]+)\)", FENCE.sub("", PAGES[page])):
        if re.match(r"https?:", target):
            continue
        name, _, anchor = target.partition("#")
        file = folder / name if name else ROOT / page
        assert file.exists(), target
        if anchor:
            headings = re.findall(r"^#+ (.*)$", FENCE.sub("", file.read_text()), re.MULTILINE)
            assert anchor in {_slug(heading) for heading in headings}, target


@pytest.mark.parametrize("page", PAGES)
def test_paths_on_a_page_exist(page):
    """Source files and folders, but for what the page's own commands write."""
    folders = ("bodylog", "cli", "tests", "docs", ".github")
    there = [*ROOT.glob("*"), *(path for name in folders for path in (ROOT / name).rglob("*"))]
    known = [f"{path}/" if path.is_dir() else str(path) for path in there]
    named = set(re.findall(r"`(?:\.\./)?([\w./-]+(?:\.(?:py|c|h)|/))`", FENCE.sub("", PAGES[page])))
    written = set(re.findall(r"[\w.-]+", "".join(_blocks(page, "bash", "text"))))
    missing = {name for name in named if not any(path.endswith(f"/{name}") for path in known)}
    assert not {name for name in missing if name.rstrip("/") not in written}


@pytest.mark.parametrize("page", [page for page in PAGES if _blocks(page, "toml")])
def test_settings_on_a_page_are_accepted(page, tmp_path):
    for block in _blocks(page, "toml"):
        assert tomllib.loads(block)
        (tmp_path / "robot.toml").write_text(block)
        manifest.load_manifest(
            tmp_path / "robot.toml", Settings()
        ) if "[[group]]" in block else load_settings(tmp_path / "robot.toml")


@pytest.mark.parametrize("page", PAGES)
def test_options_and_settings_in_the_text_exist(page):
    text = FENCE.sub("", PAGES[page])
    for command, rest in re.findall(r"`bodylog (\w+)([^`]*)`", text):
        options = commands.commands[command].params
        known = {
            "--help",
            *(name for option in options for name in (*option.opts, *option.secondary_opts)),
        }
        assert set(re.findall(r"(?<!\S)--?[a-z][\w-]*", rest)) <= known, command
    sections = dict(
        re.findall(r"^## \[(\w+)\]\n(.*?)(?=^## |\Z)", PAGES["docs/settings.md"], re.M | re.S)
    )
    for section, key in re.findall(r"`\[(\w+)\] (\w+)", text):
        assert f"| `{key}` |" in sections[section], f"[{section}] {key}"


@pytest.mark.parametrize("page", PAGES)
def test_python_on_a_page_is_run_by_a_test(page):
    assert page in RUN_ELSEWHERE or not _blocks(page, "python")


def test_everything_public_stands_on_the_page_of_the_python_api():
    public = {f"bodylog.{name}" for name in bodylog.__all__ if not name.startswith("_")}
    public |= {f"bodylog.logs.{name}" for name in logs.__all__}
    listed = re.findall(r"^::: ([\w.]+)$", PAGES["docs/python.md"], re.MULTILINE)
    assert public <= set(listed) and len(listed) == len(set(listed))


def test_navigation_has_every_page():
    listed = re.findall(r": (\w[\w-]*\.md)$", (ROOT / "mkdocs.yml").read_text(), re.MULTILINE)
    assert sorted(listed) == sorted(path.name for path in ROOT.glob("docs/*.md"))


@pytest.fixture(scope="module")
def scene(robot, run_cli, tmp_path_factory):
    """A folder with a file of every name that the commands of the pages read."""
    folder = tmp_path_factory.mktemp("scene")
    for name in ("run.bag", "run.mcap", "logs/one.mcap"):
        (folder / name).parent.mkdir(exist_ok=True)
        shutil.copy(robot / "reach.mcap", folder / name)
    for name in ("explore.bag", "explore.mcap"):
        shutil.copy(robot / "explore.mcap", folder / name)
    shutil.copy(robot / "body.npz", folder)
    (folder / "crashed.mcap").write_bytes((robot / "reach.mcap").read_bytes()[:-200_000])
    _tables(folder)
    shutil.copytree(ROOT / "fixtures" / "arm", folder / "fixtures" / "arm")
    return folder


def _tables(folder: Path) -> None:
    """poses.csv, robot.urdf and tracker.csv of the logs that are there."""
    _, found = bodylog.observe(folder / "explore.mcap", bodylog.Settings())
    joints, track = found.joints, found.tracks["effector"]
    q = np.column_stack([np.interp(track.t, joints.t, column) for column in joints.values.T])
    rows = np.column_stack([q, track.values[:, :2]])[::2]
    names = ",".join([*joints.names, "tip_u", "tip_v"])
    np.savetxt(folder / "poses.csv", rows, delimiter=",", header=names, comments="")
    with logs.open(folder / "run.mcap") as log:
        (folder / "robot.urdf").write_text(str(log["/robot_description"].data[0]))
        truth = log["/truth/joint_states"]
        t = (truth.header.stamp - log["/joint_states"].header.stamp[0]) / 1e9
        rows = np.column_stack([t, truth.position])
        names = ",".join(["t", *truth.name[0].tolist()])
    np.savetxt(folder / "tracker.csv", rows, delimiter=",", header=names, comments="")


@pytest.mark.parametrize(
    "page", [page for page in PAGES if _typed(page) and page not in RUN_ELSEWHERE]
)
def test_page_commands_run(page, scene, run_cli, tmp_path, monkeypatch):
    here = tmp_path / "scene"
    shutil.copytree(scene, here)
    monkeypatch.chdir(here)
    for line in _typed(page):
        _try(line, run_cli)


def _try(line: str, run_cli) -> None:
    program, *words = shlex.split(line)
    if program == "make":
        assert re.search(rf"^{words[0]}:", (ROOT / "Makefile").read_text(), re.MULTILINE), line
    elif program == "python":
        assert find_spec(words[1]), line
    elif program == "pip":
        _extras(line)
    elif any(re.search(pattern, line) for pattern in NOT_RUN):
        above = click.Context(commands, **commands.context_settings)  # whose help option they keep
        commands.commands[words[0]].make_context(words[0], list(words[1:]), parent=above)
    else:
        small = SMALL if words[0] == "record" else ()
        assert run_cli(*words, *small) == (3 if "crashed" in line else 0), line


def _extras(line: str) -> None:
    known = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert {
        name for words in re.findall(r"\[([\w,]+)\]", line) for name in words.split(",")
    } <= set(known)


def test_figures_of_the_readme_are_those_of_its_command(run_cli, tmp_path, capsys):
    arm, body = ROOT / "fixtures" / "arm", tmp_path / "arm.npz"
    assert run_cli("fit", arm / "explore.mcap", "-o", body) == 0
    capsys.readouterr()
    assert run_cli("compare", arm / "reach.mcap", "--body", body, "--json") == 0
    rows = json.loads(capsys.readouterr().out)["results"][0]["rows"]
    values = {
        (row["method"], *row["senses"]): {k: one["value"] for k, one in row["scores"].items()}
        for row in rows
    }
    filtered, smoothed = (
        values[method, "encoders", "vision"] for method in ("filter", "smoother")
    )
    errors = [filtered["rmse/encoders"], filtered["rmse/joint"], smoothed["rmse/joint"]]
    covered = [filtered["coverage_2sigma/joint"], smoothed["coverage_2sigma/joint"]]
    (sentence,) = re.findall(
        r"^Raw encoders err by .*?2σ\.$", PAGES["README.md"], re.MULTILINE | re.DOTALL
    )
    assert [float(number) for number in re.findall(r"([\d.]+) rad", sentence)] == pytest.approx(
        errors, rel=0.02
    )
    assert [float(number) for number in re.findall(r"([\d.]+) %", sentence)] == pytest.approx(
        covered, rel=0.02
    )
