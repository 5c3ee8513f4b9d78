"""One case: hostile files or settings, the commands that read them, and the required properties."""

import json
import os
import re
import shutil
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from . import annotated, bodies, configs, datasets, servers, urdfs
from .bombs import SECRET
from .grammar import Draw
from .logs import WRITERS, Channel
from .worker import BYTES, SECONDS, Run, folder, run, warm

ALLOWED = (0, 2, 3, 4, 65, 73, 74)
KINDS = (*WRITERS, "annotated.mcap", "body.npz")
"""Kinds of hostile files."""
SETS = (*datasets.WRITERS, "arm.urdf", "kinematic.npz", "url")
"""Kinds of hostile datasets, tables, robots, bodies and servers."""
ARM = Path(__file__).parents[2] / "fixtures" / "arm"
UR5 = Path(__file__).parents[2] / "bodylog" / "sim" / "assets" / "ur5.urdf"
WAIT_S = 1.0
"""What a case waits for a server."""


_ONE_LINE = re.compile(r"bodylog: [^\n]+\n")
_ROWS = re.compile(r"(\[\d+/\d+\] [^\n]+: unusable: [^\n]+\n)+")
"""What is refused: a line, or of a dataset a line for each episode."""


@dataclass(frozen=True)
class Base:
    """A folder with sound.mcap, body.npz, kinematic.npz and estimate.mcap, the sources of all cases."""

    path: Path

    def __truediv__(self, name: str) -> Path:
        """A file in the folder."""
        return self.path / name


@dataclass(frozen=True)
class Problem:
    """A violation by one command."""

    seed: int
    kind: str
    what: str
    run: Run


def prepare(path: Path) -> Base:
    """Write the sound files to a folder."""
    from .logs import mcap

    path.mkdir(parents=True, exist_ok=True)
    base = Base(path)
    for seed in range(100):
        names = {channel.name for channel in mcap(Draw(seed, 0.0), base / "sound.mcap")}
        if names == {b"/joint_states", b"/camera/compressed", b"/skin"}:
            break
    log, body, done = str(base / "sound.mcap"), str(base / "body.npz"), str(base / "estimate.mcap")
    kinematic = ("fit", str(ARM / "explore.mcap"), "--urdf", str(UR5), "-o", str(base / "kinematic.npz"))
    runs = run([("fit", log, "-o", body), ("estimate", log, "--body", body, "-o", done), kinematic])
    assert [one.code for one in runs] == [0, 0, 0], runs
    warm(
        [
            ("info", done),
            ("info", body),
            ("doctor", log),
            ("doctor", log, "--repair", str(base / "a")),
            ("extract", log, "-o", str(base / "b")),
            ("ingest", log, "-o", str(base / "c")),
            ("fit", log, "-o", str(base / "d")),
            ("estimate", log, "--body", body, "-o", str(base / "e")),
            ("report", done, "-o", str(base / "f")),
            *(("info", str(found)) for found in _sound(base)),
        ]
    )
    return base


def _sound(base: Base) -> Iterator[Path]:
    """A sound log of each kind."""
    (base / "kinds").mkdir(exist_ok=True)
    for name, write in (WRITERS | datasets.WRITERS).items():
        write(Draw(1, 0.0), base / "kinds" / name)
        yield base / "kinds" / name


def file_case(base: Base, place: Path, seed: int) -> tuple[str, list[Run], list[Problem]]:
    """Write a hostile file and run every command on it."""
    draw = Draw(seed, 0.0)
    draw.chance = draw.of((0.002, 0.01, 0.03, 0.1, 0.3))
    kind = draw.of(KINDS)
    place = place / str(seed)
    place.mkdir(parents=True)
    file, some = place / kind, None
    if kind in WRITERS:
        some = WRITERS[kind](draw, file)
    else:
        draw.chance = max(draw.chance, 0.3)
        {"annotated.mcap": annotated, "body.npz": bodies}[kind].spoilt(draw, base / _SOURCES[kind], file)
    commands = list(_commands(draw, base, kind, file, place))
    before = folder(place)
    runs = run(commands, partial(_same, file, some) if some is not None else None)
    problems = [Problem(seed, kind, what, one) for one in runs for what in _wrong(one)]
    problems += [Problem(seed, kind, what, runs[-1]) for what in _left(before, folder(place), runs)]
    shutil.rmtree(os.fsencode(place)) if not problems else None
    return kind, runs, problems


def set_case(base: Base, place: Path, seed: int) -> tuple[str, list[Run], list[Problem]]:
    """Write a hostile dataset, table, robot or body, or start a hostile server, and run two commands on it."""
    draw = Draw(seed, 0.0)
    draw.chance = draw.of((0.03, 0.1, 0.3))
    kind = draw.of(SETS)
    place = place / f"set{seed}"
    place.mkdir(parents=True)
    with ExitStack() as serving:
        if kind == "url":
            (place / "robot.toml").write_text(f"[input]\nmax_wait_s = {WAIT_S}\n")
            content = (base / "sound.mcap").read_bytes()
            target = serving.enter_context(servers.serving(draw, content, draw.of(servers.KINDS)))
        else:
            target = str(place / kind)
            _write_set(draw, base, kind, place / kind)
        commands = list(_set_commands(draw, base, kind, target, place))
        before = folder(place)
        runs = run(commands)
    problems = [Problem(seed, kind, what, one) for one in runs for what in _wrong(one)]
    problems += [Problem(seed, kind, what, runs[-1]) for what in _left(before, folder(place), runs)]
    leaks = [one for one in runs if (out := _output(one)) and out.is_file() and SECRET in out.read_bytes()]
    problems += [Problem(seed, kind, "another file's bytes are in its output", one) for one in leaks]
    shutil.rmtree(place) if not problems else None
    return kind, runs, problems


def _write_set(draw: Draw, base: Base, kind: str, path: Path) -> None:
    if kind == "arm.urdf":
        urdfs.write(draw, path)
    elif kind == "kinematic.npz":
        draw.chance = 0.3
        bodies.spoilt(draw, base / kind, path)
    else:
        datasets.WRITERS[kind](draw, path)


def _set_commands(draw: Draw, base: Base, kind: str, target: str, place: Path) -> Iterator[tuple[str, ...]]:
    out = str(place / "out.mcap")
    if kind == "arm.urdf":
        yield ("fit", str(base / "sound.mcap"), "--urdf", target, "-o", str(place / "out.npz"), "--json")
    elif kind == "kinematic.npz":
        yield ("info", target, "--json")
        if draw.random.random() < 0.3:
            yield ("estimate", str(ARM / "reach.mcap"), "--body", target, "-o", out, "--json")
    elif kind == "url":
        yield ("info", target, "--json", "--config", str(place / "robot.toml"))
        if draw.random.random() < 0.3:
            yield ("ingest", target, "-o", out, "--config", str(place / "robot.toml"))
    else:
        yield ("info", target, "--json")
        fit = ("fit", target, "-o", str(place / "out.npz"), "--json")
        yield draw.of((("ingest", target, "-o", out), ("ingest", target, "-o", out), ("doctor", target), fit))


_SOURCES = {"annotated.mcap": "estimate.mcap", "body.npz": "body.npz"}


def settings_case(base: Base, place: Path, seed: int) -> tuple[str, list[Run], list[Problem]]:
    """Run commands with hostile settings on a sound log."""
    draw = Draw(seed, 0.3)
    place = place / f"settings{seed}"
    place.mkdir(parents=True)
    typed = configs.write(draw, place / "robot.toml")
    log, body, config = str(base / "sound.mcap"), str(base / "body.npz"), ("--config", str(place / "robot.toml"))
    before, outside = folder(place), folder(base.path)
    out = str(place / "out.mcap")
    commands = [
        ("info", log, *config, "--json"),
        ("config", *config),
        ("estimate", log, "--body", body, "-o", out, *config, "--json", *typed),
        draw.of(
            (
                ("extract", log, "-o", str(place / "x.mcap"), *config, "--json"),
                ("ingest", log, "-o", str(place / "i.mcap"), *config),
                ("fit", log, "-o", str(place / "b.npz"), *config, "--json"),
            )
        ),
    ]
    runs = run(commands)
    problems = [Problem(seed, "settings", what, one) for one in runs for what in _wrong(one)]
    problems += [Problem(seed, "settings", what, runs[-1]) for what in _left(before, folder(place), runs)]
    problems += [Problem(seed, "settings", "an input changed", runs[-1])] if folder(base.path) != outside else []
    shutil.rmtree(place) if not problems else None
    return "settings", runs, problems


def _commands(draw: Draw, base: Base, kind: str, file: Path, place: Path) -> Iterator[tuple[str, ...]]:
    log, body = str(file), str(base / "body.npz")
    if kind == "body.npz":
        yield ("info", log, "--json")
        yield ("info", log)
        yield ("estimate", str(base / "sound.mcap"), "--body", log, "-o", str(place / "e.mcap"), "--json")
        yield ("fit", str(base / "sound.mcap"), "--update", log, "-o", str(place / "f.npz"), "--json")
        return
    yield ("info", log, "--json")
    yield ("doctor", log)
    estimate = ("estimate", log, "--body", body, "-o", str(place / "e.mcap"), "--json")
    report = ("report", str(place / "e.mcap"), "-o", str(place / "r.html"))
    further = (
        (estimate,),
        (estimate, report),
        (("extract", log, "-o", str(place / "x.mcap"), "--json"),),
        (("ingest", log, "-o", str(place / "i.mcap")),),
        (("fit", log, "-o", str(place / "f.npz"), "--json"),),
        (("doctor", log, "--repair", str(place / "d.mcap")), ("info", log)),
    )
    if kind == "annotated.mcap":
        yield ("report", log, "-o", str(place / "r.html"))
    for commands in draw.random.sample(further, 2):
        yield from commands


def _wrong(one: Run) -> Iterator[str]:
    """Violations of one run."""
    if one.command == ("check",):
        if one.code:
            yield f"reads otherwise: {one.err[-1500:]}"
        return
    if one.code is None:
        yield "it did not end, or was killed"
        return
    if one.code not in ALLOWED:
        yield f"exit code {one.code}"
    if one.code not in (0, 3, 4) and not (_ONE_LINE.fullmatch(one.err) or _ROWS.fullmatch(one.err)):
        yield "not refused in one line"
    if "not enough memory" in one.err:
        yield "not enough memory"
    if re.search(r"Traceback|Warning:|libpng|OpenCV|\[ WARN|\[ERROR", one.err):
        yield "a library speaks"
    if one.seconds > SECONDS:
        yield f"{one.seconds:.1f} s"
    if one.memory > BYTES:
        yield f"{one.memory >> 20} MB"
    if one.code in (0, 3, 4):
        yield from _outputs(one)


def _outputs(one: Run) -> Iterator[str]:
    if "--json" in one.command:
        try:
            json.loads(one.out, parse_constant=_refuse)
        except (ValueError, RecursionError) as problem:
            yield f"its JSON: {problem}"
    if (out := _output(one)) is None:
        return
    if not out.is_file():
        yield "success without an output"
    elif out.suffix == ".mcap":
        yield from _mcap(out, one.command[0])


def _output(one: Run) -> Path | None:
    """The output file of a command."""
    place = next((one.command.index(name) + 1 for name in ("-o", "--repair") if name in one.command), None)
    return None if place is None else Path(one.command[place])


def _refuse(name: str) -> None:
    raise ValueError(f"{name} in it")


def _mcap(path: Path, command: str) -> Iterator[str]:
    """Violations of a written log: mcap's own reader fails, or its estimate is not finite."""
    from mcap.reader import NonSeekingReader

    try:
        with path.open("rb") as stream:
            for _, channel, message in NonSeekingReader(stream, validate_crcs=True).iter_messages():
                if command == "estimate" and channel.topic == "/bodylog/joint_states" and _has_nan(message.data):
                    yield "NaN in the estimate"
                    return
    except Exception as problem:
        yield f"mcap cannot read {path.name}: {type(problem).__name__}: {problem}"


def _has_nan(data: bytes) -> bool:
    from tests.logs.writing import store

    return bool(np.isnan(store().deserialize_cdr(data, "sensor_msgs/msg/JointState").position).any())


def _left(before: dict[str, tuple[int, int]], after: dict[str, tuple[int, int]], runs: list[Run]) -> Iterator[str]:
    """Files that are lost, changed, or left without a successful command."""
    if any(after.get(name) != status for name, status in before.items()):
        yield "an input changed or is gone"
    good = {str(_output(one)) for one in runs if one.code in (0, 3, 4)}
    killed = any(one.code is None for one in runs)
    left = sorted(name for name in after if name not in before and name not in good)
    if left and not killed:
        yield f"left over: {', '.join(left)[:300]}"


def _same(file: Path, some: list[Channel]) -> str | None:
    """Differences between a container read by bodylog and what was written, or what other libraries read."""
    from bodylog.errors import BodylogError
    from bodylog.logs.formats import open_log, payload_views

    found: Counter[tuple[str, bytes]] = Counter()
    try:
        with open_log(file) as log:
            names = {topic.id: topic.name for topic in log.topics}
            for batch in log.batches():
                found.update((names[batch.topic_id], bytes(p)) for p in payload_views(batch))
            if log.findings:
                return None  # a loss, and it was reported
    except BodylogError:
        return None
    for read in (_by_mcap, _by_rosbags):
        with suppress(Exception):  # a library that cannot read the file proves nothing
            other = read(file)
            if other is not None and (theirs := _normal(other)) != (ours := _normal(found)):
                counts = f"{sum(other.values())} messages, {sum(found.values())} ours"
                return f"{counts}; {list((theirs - ours) or (ours - theirs))[:1]}"
    return None


def _normal(found: Counter[tuple[str, bytes]]) -> Counter[tuple[str, bytes]]:
    """The same with topic names as in rosbags: no doubled or trailing slashes."""
    named: Counter[tuple[str, bytes]] = Counter()
    for (topic, data), count in found.items():
        named[re.sub("/+", "/", topic).rstrip("/") or "/", data] += count
    return named


def _by_mcap(file: Path) -> Counter[tuple[str, bytes]] | None:
    from mcap.reader import NonSeekingReader

    if file.suffix != ".mcap" or file.is_dir():
        return None
    with file.open("rb") as stream:
        return Counter((c.topic, bytes(m.data)) for _, c, m in NonSeekingReader(stream).iter_messages())


def _by_rosbags(file: Path) -> Counter[tuple[str, bytes]] | None:
    from rosbags.rosbag1 import Reader

    if file.suffix != ".bag":
        return None
    with Reader(file) as reader:
        return Counter((c.topic, bytes(data)) for c, _, data in reader.messages())
