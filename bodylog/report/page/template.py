"""A self-contained HTML document with its style,
script and data; its policy forbids all other scripts.
"""

import base64
import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ...overlay_style import STYLE_SHEET
from .data import embed_json
from .tables import escape_text

_ASSETS = Path(__file__).parent / "assets"
_POLICY = (
    "default-src 'none'; img-src data:; base-uri 'none'; form-action 'none'; style-src {}; "
    "script-src {}"
)
_HELP = (
    "drag: zoom · shift-drag, <kbd>←</kbd> <kbd>→</kbd>: move · "
    "ctrl-wheel, <kbd>+</kbd> <kbd>-</kbd>: zoom · double click, <kbd>0</kbd>: whole"
)


def render_document(title: str, body: str, groups: Sequence[Mapping[str, Any]]) -> str:
    """The page as text; `groups` are those of `data.plain`,
    one for each `plots_placeholder` in the body, in order.
    """
    inks = ";".join(f"--{name}:{ink}" for name, ink in STYLE_SHEET.items())
    style = f":root{{{inks}}}\n{_read_asset('page.css')}"
    script = _read_asset("panel.js") + _read_asset("view.js") if groups else ""
    policy = _POLICY.format(_script_source(style), _script_source(script))
    data = (
        f'<script type="application/json" id="data">{embed_json(groups)}</script>\n'
        if groups
        else ""
    )
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape_text(title)}</title>\n<style>{style}</style>\n</head>\n<body>\n{body}\n{data}"
        + (f"<script>{script}</script>\n" if script else "")
        + "</body>\n</html>\n"
    )


def plots_placeholder(notes: Sequence[str] = ()) -> str:
    """The place of panels that share one time axis, with their controls, and notes below."""
    paragraphs = "".join(f"<p>{escape_text(note)}</p>" for note in notes)
    return (
        '<section>\n<div class="bar"><button type="button">whole log</button><output></output>'
        f'<span class="soft">{_HELP}</span></div>\n'
        '<noscript><p class="warning">The plots need JavaScript; the tables do '
        "not.</p></noscript>\n"
        f'<div class="panels"></div>\n<div class="soft">{paragraphs}</div>\n</section>'
    )


def _read_asset(name: str) -> str:
    return (_ASSETS / name).read_text(encoding="utf-8")


def _script_source(text: str) -> str:
    """The policy's source for one inline text: no text from a log can run."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
