"""Run the tests of numbers as other processors would: other kernels, vector units switched off.

python tests/every_processor.py [haswell zen skylakex old] [-- pytest's arguments]

A profile whose instructions this processor lacks is skipped, with its reason. Exit code 1 when
tests of one fail, when profiles that round alike differ in a byte, or when the angles that one
estimates differ from the first's by more than 1e-5 rad.
"""

import hashlib
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[1]
ROOMS = ("tests/perception", "tests/body", "tests/estimation")
CPU = Path("/proc/cpuinfo")
ARM = ROOT / "fixtures" / "arm"
AVX_512 = ("X86_V4", "AVX512_ICL", "AVX512_SPR", "AVX512F", "AVX512CD", "AVX512_SKX")
"""NumPy's names of groups of AVX-512 instructions, of version 2.4 and of earlier ones."""
AVX_2 = ("X86_V3", "AVX2", "FMA3")
MOST_APART_RAD = 1e-5
"""Between processors that round otherwise; 6e-7 were seen between one with AVX2 and one without."""


@dataclass(frozen=True)
class Profile:
    """OpenBLAS' kernels, the flags of /proc/cpuinfo they need, and what NumPy goes without.

    rounds_same: any two such profiles round alike.
    """

    kernels: str
    needs: tuple[str, ...]
    without: tuple[str, ...]
    rounds_same: bool = False


PROFILES = {
    "haswell": Profile("Haswell", ("avx2", "fma"), AVX_512, rounds_same=True),
    "zen": Profile("Zen", ("avx2", "fma"), AVX_512, rounds_same=True),
    "skylakex": Profile("SkylakeX", ("avx512f", "avx512bw", "avx512dq", "avx512vl"), ()),
    "old": Profile("Nehalem", (), (*AVX_512, *AVX_2)),
}


def main(arguments: list[str]) -> int:
    """Print what each profile gave: its tests, and its estimate beside the first profile's."""
    split = arguments.index("--") if "--" in arguments else len(arguments)
    ends: dict[str, str] = {}
    found: dict[str, Outcome] = {}
    failed = False
    for name in arguments[:split] or PROFILES:
        if missing := lacking(PROFILES[name]):
            ends[name] = f"skipped: this processor has no {', '.join(missing)}"
            continue
        surroundings = environment(PROFILES[name])
        print(f"{name}: OPENBLAS_CORETYPE={surroundings['OPENBLAS_CORETYPE']}", flush=True)
        command = [sys.executable, "-m", "pytest", *ROOMS, *arguments[split + 1 :]]
        code = subprocess.run(command, cwd=ROOT, env=surroundings).returncode
        found[name] = outcome(surroundings)
        wrong = differs(name, found)
        failed |= code != 0 or bool(wrong)
        verdict = "tests passed" if code == 0 else f"pytest ended with {code}"
        ends[name] = f"{verdict}; {wrong or compared(name, found)}"
    for name, end in ends.items():
        print(f"{name}: {end}")
    return int(failed)


@dataclass(frozen=True)
class Outcome:
    """Digests of a learned body and of an estimate with it, and the estimated angles (n,M) rad."""

    body: str
    estimate: str
    angles: Any


def compared(name: str, found: dict[str, Outcome]) -> str:
    """The outcome of a profile beside that of the first."""
    first, own = next(iter(found.values())), found[name]
    apart = np.abs(own.angles - first.angles).max()
    return f"body {own.body}, estimate {own.estimate}; angles within {apart:.1g} rad of the first's"


def differs(name: str, found: dict[str, Outcome]) -> str:
    """What is wrong with the outcome of a profile, beside those before it; "" for nothing."""
    first, own = next(iter(found.values())), found[name]
    if np.abs(own.angles - first.angles).max() > MOST_APART_RAD:
        return f"WRONG: {compared(name, found)}"
    same_rounding = [other for label, other in found.items() if PROFILES[label].rounds_same]
    if PROFILES[name].rounds_same and len({(other.body, other.estimate) for other in same_rounding}) > 1:
        return f"WRONG, not the bytes of a profile that rounds alike: {compared(name, found)}"
    return ""


def lacking(profile: Profile) -> list[str]:
    """The instructions that a profile needs and this processor has not."""
    lines = CPU.read_text().splitlines() if CPU.exists() else []
    flags = next((line.split() for line in lines if line.startswith("flags")), [])
    return [flag for flag in profile.needs if flag not in flags]


def environment(profile: Profile) -> dict[str, str]:
    """The environment of a process that computes as the profile says."""
    return {
        **os.environ,
        "OPENBLAS_NUM_THREADS": "1",
        "OPENBLAS_CORETYPE": profile.kernels,
        "NPY_DISABLE_CPU_FEATURES": " ".join(dispatched(profile.without)),
        **({} if profile.needs else {"NUMBA_CPU_NAME": "generic"}),
    }


def dispatched(groups: tuple[str, ...]) -> list[str]:
    """Those of the groups that NumPy chooses at run time here: it warns if others are disabled."""
    from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__

    return [group for group in groups if group in __cpu_dispatch__ and __cpu_features__.get(group)]


def outcome(surroundings: dict[str, str]) -> Outcome:
    """A body learned, and a log estimated with it, by processes with that environment."""
    import bodylog.logs as logs

    with tempfile.TemporaryDirectory() as folder:
        body, estimate = Path(folder) / "body.npz", Path(folder) / "estimate.mcap"
        _bodylog("fit", ARM / "explore.mcap", ["-o", body], surroundings)
        _bodylog("estimate", ARM / "reach.mcap", ["--body", body, "-o", estimate], surroundings)
        with logs.open(estimate) as log:
            angles = np.array(log["/bodylog/joint_states"].position)
        return Outcome(_digest(body), _digest(estimate), angles)


def _bodylog(name: str, log: Path, options: list[Any], surroundings: dict[str, str]) -> None:
    command = [sys.executable, "-m", "bodylog_cli", name, log, *options]
    subprocess.run(command, check=True, capture_output=True, env=surroundings)


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:12]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
