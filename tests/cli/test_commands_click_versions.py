"""The command line is the same with every click that pyproject.toml allows."""

import click
import pytest


def test_bodylog_without_a_command_prints_help_on_standard_error(capsys, run_cli):
    assert run_cli() == 2
    out, shown = capsys.readouterr()
    assert not out and shown.startswith("Usage: bodylog") and "estimate" in shown


@pytest.mark.parametrize("typed", [("nothing",), ("info",), ("estimate", "--bodi", "x"), ("config", "--nothing")])
def test_usage_error_is_one_line_with_an_older_click(monkeypatch, capsys, run_cli, typed):
    monkeypatch.delattr(click.exceptions, "NoArgsIsHelpError", raising=False)  # click 8.1
    assert run_cli(*typed) == 2
    shown = capsys.readouterr().err
    assert shown.startswith("bodylog: ") and shown.count("\n") == 1 and "--help" in shown
