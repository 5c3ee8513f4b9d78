"""Goals of speed and memory: what was measured, beside whom, and the limit; collected by a run, drawn as one table."""

import json
import math
import os
import platform
import re
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

_VERSIONS = ("numpy", "scipy", "opencv-python-headless", "mcap", "mcap-ros2-support", "mcap-protobuf-support",
             "rosbags", "scikit-learn", "filterpy")  # fmt: skip


@dataclass(frozen=True)
class Goal:
    """One bound: `measured` in `unit` ("" for ratios), at least or at most `limit`; NaN where nothing was measured.

    peer: who it is measured beside, and what that took.
    """

    what: str
    measured: float
    limit: float
    most: bool
    unit: str = ""
    peer: str = ""

    @property
    def holds(self) -> bool:
        """Whether the bound holds."""
        return self.measured <= self.limit if self.most else self.measured >= self.limit


FOUND: list[Goal] = []
"""The goals of this process so far."""


def at_most(what: str, measured: float, limit: float, unit: str = "", peer: str = "") -> None:
    """Note and print a bound from above."""
    _note(Goal(what, float(measured), limit, True, unit, peer))


def at_least(what: str, measured: float, limit: float, unit: str = "", peer: str = "") -> None:
    """Note and print a bound from below."""
    _note(Goal(what, float(measured), limit, False, unit, peer))


def unmeasured(what: str, why: str) -> None:
    """Note a goal that could not be measured, which breaks it."""
    _note(Goal(what, math.nan, 0.0, False, "", why))


def _note(goal: Goal) -> None:
    FOUND.append(goal)
    print(f"  {'holds' if goal.holds else 'BROKEN'}: {goal.what}: {measured(goal)}, {limit(goal)}")


def measured(goal: Goal) -> str:
    """What was measured, three digits."""
    return "not measured" if math.isnan(goal.measured) else f"{_short(goal.measured)} {goal.unit}".strip()


def limit(goal: Goal) -> str:
    """The bound."""
    return "-" if math.isnan(goal.measured) else f"{'≤' if goal.most else '≥'} {goal.limit:g} {goal.unit}".strip()


def _short(value: float) -> str:
    digits = 2 - math.floor(math.log10(abs(value))) if value else 0
    return f"{value:,.{max(0, digits)}f}"


def save(path: Path) -> None:
    """Write the goals of this process."""
    path.write_text(json.dumps([asdict(goal) for goal in FOUND]))


def load(path: Path) -> list[Goal]:
    """Read what `save` wrote; none where there is no such file."""
    return [Goal(**one) for one in json.loads(path.read_text())] if path.exists() else []


def table(goals: list[Goal]) -> str:
    """The goals as a table in Markdown."""
    rows = [(g.what, measured(g), limit(g), "yes" if g.holds else "**no**", g.peer or "-") for g in goals]
    head = ("goal", "measured", "limit", "holds", "measured beside")
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, ("---",) * len(head), *rows))


def page(groups: dict[str, list[Goal]]) -> str:
    """The page on performance: the machine, and a table for each benchmark."""
    goals = [goal for some in groups.values() for goal in some]
    broken = sum(not goal.holds for goal in goals)
    parts = [
        "# Performance",
        "`make bench` runs every benchmark with its peers installed, writes this page, and exits with 4 if a bound is "
        "broken.\nRatios are of one run, side by side. CPU seconds are those of all threads, and of processes started.",
        f"{machine()} {len(goals)} goals, {broken} of them broken.",
    ]
    for name, some in groups.items():
        parts += [f"## `python -m tests.benchmarks {name}`", table(some) if some else "No bounds: it prints figures."]
    return "\n\n".join(parts) + "\n"


def machine() -> str:
    """Processor, versions and how busy the machine is, in a sentence each."""
    text = Path("/proc/cpuinfo")
    names = re.findall(r"model name\s*:\s*(.+)", text.read_text()) if text.exists() else []
    processor = names[0].strip() if names else platform.processor() or platform.machine()
    found = [f"{name} {known}" for name in _VERSIONS if (known := _version(name))]
    busy = os.getloadavg()[0] / (os.cpu_count() or 1)
    kind = f"{os.cpu_count()} cores of {processor}; Python {platform.python_version()}, {', '.join(found)}."
    return f"{kind}\n{busy:.1f} processes per core wanted to run at the end of the run."


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""
