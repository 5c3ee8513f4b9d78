"""Side-by-side timing: every case runs in turn, round after round, so that all see the same machine."""

import gc
import resource
import statistics
import time
from collections.abc import Callable


def side_by_side(
    title: str, cases: dict[str, Callable[[], object]], repeats: int = 5, cpu: bool = False
) -> dict[str, float]:
    """Median wall seconds of each case, printed with its ratio to the first; one warm-up round is not counted.

    cpu: CPU seconds instead, of all threads and of the processes that a case starts: what others run counts less.
    """
    clock = cpu_seconds if cpu else time.perf_counter
    runs: dict[str, list[float]] = {name: [] for name in cases}
    for round_number in range(repeats + 1):
        first = round_number % len(cases)  # nobody always pays for cold pages
        order = [*cases.items()][first:] + [*cases.items()][:first]
        for name, case in order:
            gc.collect()
            started = clock()
            case()
            if round_number:
                runs[name].append(clock() - started)
    medians = {name: statistics.median(values) for name, values in runs.items()}
    _print(f"{title}{', CPU time' if cpu else ''}", medians, runs)
    return medians


def cpu_seconds() -> float:
    """CPU seconds of this process and of those it started and waited for."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def _print(title: str, medians: dict[str, float], runs: dict[str, list[float]]) -> None:
    first = next(iter(medians.values()))
    print(f"\n{title}")
    for name, median in medians.items():
        low, high = min(runs[name]), max(runs[name])
        spread = f"(min {low * 1e3:.2f}, max {high * 1e3:.2f})"
        print(f"  {name:<52} {median * 1e3:10.2f} ms  {spread}  x{median / first:.2f}")
