"""Names that a file of the product defines."""

import ast
from pathlib import Path

ROOT = Path(__file__).parents[1]


def list_defined_names(path: Path) -> set[str]:
    """Functions and classes of a file, methods as Class.method."""
    found = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
            members = [one for one in node.body if isinstance(one, ast.FunctionDef)]
            found |= {f"{node.name}.{one.name}" for one in members} if isinstance(node, ast.ClassDef) else set()
    return found
