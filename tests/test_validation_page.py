"""Every table of figures on docs/validation.md is made by a script that is kept, and the page names it."""

import importlib
import re
from pathlib import Path

import pytest

from tests.validation import __main__ as validation

FILES = [validation.ROOT / "README.md", *(validation.ROOT / "docs").glob("*.md")]
PAGES = {path.name: path.read_text(encoding="utf-8") for path in FILES}
FEW = 10
"""Decimal numbers that a table may have which is of no measurements."""
COMMAND = re.compile(r"python -m [\w.]+|make (?:bench|validation)|bodylog (?:reproduce|evaluate|estimate|fit)")


@pytest.mark.parametrize("name", validation.NAMES)
def test_validation_scripts_have_one_table_each(name):
    assert callable(importlib.import_module(f"tests.validation.{name}").table)
    begin, end = validation.marks(name)
    (page,) = (text for text in PAGES.values() if begin in text)
    part = page.split(begin)[1].split(end)[0]
    assert part.strip().splitlines()[0].startswith("| ")
    assert part.rstrip().endswith(f"`python -m tests.validation {name}`")


def test_validation_page_has_only_generated_tables():
    text = PAGES["validation.md"]
    for name in validation.NAMES:
        begin, end = validation.marks(name)
        if begin in text:
            text = text.split(begin)[0] + text.split(end)[1]
    assert "\n|" not in text and "<!--" not in text


@pytest.mark.parametrize("name", sorted(PAGES))
def test_validation_tables_state_their_command(name):
    section = ""
    for part in re.split(r"^(?=#+ )", PAGES[name], flags=re.MULTILINE):
        # a page's first part speaks for all that follow
        section = section or part
        for table in re.findall(r"^\|(?:.*\n\|)+", part, re.MULTILINE):
            figures = re.findall(r"[^\w.]\d+\.\d+\b", table)
            assert len(figures) < FEW or COMMAND.search(part) or COMMAND.search(section), table.splitlines()[0]


def test_table_is_written_only_between_its_markers(tmp_path, monkeypatch):
    begin, end = validation.marks("delay")
    (tmp_path / "docs").mkdir()
    pages = {name: Path(tmp_path / "docs" / name) for name in ("one.md", "other.md")}
    pages["one.md"].write_text(f"before\n{begin}old\n{end}after\n")
    pages["other.md"].write_text("healthy\n")
    monkeypatch.setattr(validation, "ROOT", tmp_path)
    validation.write("delay", "| a |\n|---|\n| 1 |\n")
    text = pages["one.md"].read_text()
    part = r"\n\| a .*`python -m tests.validation delay`\n\n"
    assert re.fullmatch(rf"before\n{begin}{part}{end}after\n", text, re.DOTALL)
    assert pages["other.md"].read_text() == "healthy\n"
