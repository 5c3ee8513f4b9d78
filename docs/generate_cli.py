"""Write docs/cli.md from every command's --help; a test compares them."""

from pathlib import Path

import click
from bodylog_cli.commands import bodylog

PAGE = Path(__file__).with_name("cli.md")
BEGIN = """# Command line

An output file is complete or absent: it is written under another name and then renamed. A symlink's target is replaced.
No output may be an input, lie inside one or, as a folder, contain one; such commands are rejected before anything is
read. `--config` and `--baseline` may be pipes: `--config <(sed s/left/right/ robot.toml)`.

## Output

A command prints its result on standard output and everything else on standard error. `fit`, `estimate`, `evaluate`
and `report` print a verdict of a few lines; `--all` adds every score ([metrics](metrics.md)). Warnings and losses are
always printed, information with `-v`; `-q` leaves errors and losses alone. A terminal shows progress.

`--json` prints one envelope, whatever the command:

```json
{"bodylog": "0.1.0", "command": "estimate",
 "results": [{"input": "run.bag", "output": "run.mcap", "verdict": ["…"],
              "scores": {"rmse/joint": {"value": 0.0067, "unit": "rad"}},
              "health": {}, "findings": [], "faults": [], "settings": {}}]}
```

`results` has one entry for each input; `fit` and `convert` make one of several logs, whose `input` is a list. Some
commands add keys: `info` `log` or `body`, `fit` `body`, `compare` `rows`, `features` `candidates`, `calibration`
`calibration` and `next`, `offsets` `offsets` and `scales`, `batch` `name`, `status`, `exit_code` and `error`,
`reproduce` `claims`.

## Shell completion

The shell completes commands, options and their choices after one of these lines in its start-up file:

```sh
eval "$(_BODYLOG_COMPLETE=bash_source bodylog)"     # ~/.bashrc
eval "$(_BODYLOG_COMPLETE=zsh_source bodylog)"      # ~/.zshrc
_BODYLOG_COMPLETE=fish_source bodylog | source      # ~/.config/fish/config.fish
```

The rest of this page is the output of every `--help`.
"""


def page() -> str:
    """The command line reference as Markdown."""
    parts = [BEGIN, _help("bodylog", bodylog)]
    parts += [_help(f"bodylog {name}", command) for name, command in bodylog.commands.items()]
    return "\n".join(parts)


def _help(name: str, command: click.Command) -> str:
    context = click.Context(
        command, info_name=name, terminal_width=100, help_option_names=["-h", "--help"]
    )
    return f"## {name}\n\n```text\n{command.get_help(context)}\n```\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
