"""Score names: one unit each, all of them in docs/metrics.md."""

import ast
import re
from pathlib import Path

from bodylog.score_names import FIGURES, score_unit, split_score_name

ROOT = Path(__file__).parents[1]
ROWS = dict(re.findall(r"^\| `([^`]+)` \|([^|]*)\|", (ROOT / "docs" / "metrics.md").read_text(), re.MULTILINE))


def test_metrics_page_lists_all_figures_with_units() -> None:
    stated = {split_score_name(name.replace("[", "").replace("]", ""))[0]: unit_.strip() for name, unit_ in ROWS.items()}
    assert stated == dict(FIGURES)


def _made() -> list[tuple[str, str, str | None]]:
    """Every Score(...) in the source: where, its name with PART for what is filled in, its unit if that is written."""
    found = []
    for path in (ROOT / "bodylog").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Score":
                name, of = node.args[0], node.args[2]
                parts = name.values if isinstance(name, ast.JoinedStr) else [name]
                text = "".join(str(p.value) if isinstance(p, ast.Constant) else "PART" for p in parts)
                found.append((f"{path.name}:{node.lineno}", text, of.value if isinstance(of, ast.Constant) else None))
    return found


def test_score_names_have_known_figures_and_units() -> None:
    made = _made()
    assert len(made) > 50
    for place, name, stated in made:
        pattern = name.replace("PART", ".+")
        assert any(re.fullmatch(pattern, f"{figure}{part}") for figure in FIGURES for part in ("", "/p", "/p/q")), place
        if stated is not None and score_unit(name):
            assert stated == score_unit(name), place


def test_split_separates_the_figure_despite_slashes() -> None:
    assert split_score_name("rmse/innovation/side/effector") == ("rmse/innovation", "side/effector")
    assert split_score_name("nis/held_out/tip") == ("nis/held_out", "tip") and split_score_name("nis/tip") == ("nis", "tip")
    assert split_score_name("rmse/joint") == ("rmse/joint", "") and split_score_name("fault/dead/elbow") == ("fault", "dead/elbow")
