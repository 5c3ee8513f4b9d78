"""Make the tables of figures in docs/, each by the script of its name, and write them between their markers.

python -m tests.validation [NAMES] [--print]      all tables, or those named; --print leaves the pages alone
"""

import argparse
import importlib
import os
import time
from pathlib import Path

for _variable in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

from docs.generate_claims import between  # noqa: E402

ROOT = Path(__file__).parents[2]
HELPERS = {"__main__", "explorations", "figures", "logs"}
NAMES = sorted(path.stem for path in Path(__file__).parent.glob("*.py") if path.stem not in HELPERS)


def main() -> None:
    """Make the tables; CPU seconds of each stand on the terminal."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAMES", help=f"of {', '.join(NAMES)}; default: all")
    parser.add_argument("--print", action="store_true", help="print the tables, write no page")
    wish = parser.parse_args()
    if unknown := sorted(set(wish.names) - set(NAMES)):
        parser.error(f"{', '.join(unknown)}: no such table; possible: {', '.join(NAMES)}")
    for name in wish.names or NAMES:
        started = time.process_time()
        script = importlib.import_module(f"tests.validation.{name}")
        if hasattr(script, "ready") and not script.ready():
            print(f"\n{name}: its logs are not at hand; the page keeps its table", flush=True)
            continue
        part = script.table()
        print(f"\n{name}, {time.process_time() - started:.0f} CPU s\n\n{part}", flush=True)
        if not wish.print:
            write(name, part)


def marks(name: str) -> tuple[str, str]:
    """The lines between which the table stands."""
    return f"<!-- {name} -->\n", f"<!-- end of {name} -->\n"


def write(name: str, part: str) -> None:
    """Put the table, and the command that makes it, on the page with its markers."""
    text = f"\n{part}\n`python -m tests.validation {name}`\n\n"
    for page in sorted((ROOT / "docs").glob("*.md")):
        old = page.read_text(encoding="utf-8")
        if marks(name)[0] in old:
            page.write_text(between(old, marks(name), text), encoding="utf-8")


if __name__ == "__main__":
    main()
