"""Options with choices: they are the tables' names, and help, completion and errors show them."""

import click
import pytest
from bodylog_cli.commands import bodylog

from bodylog import choices, sim
from bodylog.logs.datasets.encode import CODECS
from bodylog.recording.lerobot_writer import FORMS
from bodylog.settings import METHODS
from bodylog.sim.arms import ARMS

ENUMERATED = {
    "estimate": ("method", "preset", "precision", "bias", "touch", "step"),
    "batch": ("method", "preset", "precision", "bias", "touch", "step"),
    "fit": ("preset",),
    "convert": ("form", "how"),
    "record": ("scenario", "arm", "variant", "place", "image", "feature", "camera"),
}


@pytest.mark.parametrize("command", ENUMERATED)
def test_options_with_choices_show_and_complete_them(command):
    names = ["-h", "--help"]
    context = click.Context(bodylog.commands[command], terminal_width=1000, help_option_names=names)
    shown = bodylog.commands[command].get_help(context)
    options = {option.name: option for option in bodylog.commands[command].params}
    for name in ENUMERATED[command]:
        completed = [item.value for item in options[name].shell_complete(context, "")]
        assert len(completed) > 1 and all(choice in shown for choice in completed)
        assert options[name].shell_complete(context, completed[-1])[0].value == completed[-1]
    if "method" in options:
        assert tuple(options["method"].type.choices) == METHODS


def test_record_choices_are_those_of_the_simulator():
    assert {name: one.variants for name, one in sim.SCENARIOS.items() if one.variants != ("",)} == {
        name: variants for name, variants in choices.VARIANTS.items() if variants
    }
    assert tuple(sim.SCENARIOS) == tuple(choices.VARIANTS) and tuple(ARMS) == choices.ARMS
    assert sim.SCENARIOS["rubber-hand"].places == choices.PLACES


def test_format_choices_are_those_of_the_writers():
    assert ("mcap", *FORMS) == choices.FORMATS and tuple(CODECS) == choices.VIDEO_CODECS


@pytest.mark.parametrize(
    ("typed", "text"),
    [
        (("estimate", "run.mcap", "-o", "out.mcap", "--method", "smother"), "did you mean smoother? possible: filter"),
        (("record", "reech", "-o", "out.mcap"), "'SCENARIO': 'reech'; did you mean reach? possible: babble"),
        (("fit", "run.mcap", "-o", "body.npz", "--preset", "papers"), "did you mean paper?"),
    ],
)
def test_impossible_choices_name_the_nearest(capsys, run_cli, typed, text):
    assert run_cli(*typed) == 2
    assert text in capsys.readouterr().err
