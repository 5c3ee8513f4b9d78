"""Run commands in a separate process and record their time, memory, exit code and output."""

import contextlib
import gc
import importlib
import json
import os
import resource
import select
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import bodylog_cli

SECONDS, BYTES, PATIENCE = 60.0, 1 << 30, 300.0
"""What a command may take at most: processor time, memory, and the time after which it is killed."""
_ADDRESSES = 6 << 30


@dataclass(frozen=True)
class Run:
    """One command: arguments, exit code (None: it never ended), output, processor seconds, bytes."""

    command: tuple[str, ...]
    code: int | None
    out: str
    err: str
    seconds: float
    memory: int


def warm(commands: Sequence[Sequence[str]]) -> None:
    """Import what commands import, so that a child need not; threads that imports start must not exist here."""
    report = run(commands, lambda: json.dumps(sorted(sys.modules)))[-1].err
    for name in ("mcap.reader", "rosbags.rosbag1", *json.loads(report)):
        with contextlib.suppress(Exception):
            importlib.import_module(name)
    gc.collect()
    gc.freeze()


def run(commands: Sequence[Sequence[str]], check: Callable[[], str | None] | None = None) -> list[Run]:
    """Run the commands one after another in a child; kill one that does not end in time, and skip the rest.

    `check` runs in the child after them, as a command of the name "check": it returns an error text.
    """
    read, write = os.pipe()
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        child = os.fork()
        if not child:
            os.close(read)
            _child(commands, check, write, out.fileno(), err.fileno())
        os.close(write)
        try:
            return _collect(child, read, commands, out.fileno(), err.fileno())
        finally:
            os.close(read)


def _child(
    commands: Sequence[Sequence[str]], check: Callable[[], str | None] | None, write: int, out: int, err: int
) -> None:
    try:
        os.dup2(out, 1)
        os.dup2(err, 2)
        sys.stdout = os.fdopen(1, "w", encoding="utf-8", errors="backslashreplace", closefd=False)
        sys.stderr = os.fdopen(2, "w", encoding="utf-8", errors="backslashreplace", closefd=False)
        resource.setrlimit(resource.RLIMIT_AS, (_ADDRESSES, _ADDRESSES))
        for command in commands:
            code, seconds = _one(command)
            _send(write, {"code": code, "seconds": seconds, **_words(out, err), "memory": _memory()})
        if check is not None:
            report = check()
            _send(
                write, {"code": 1 if report else 0, "seconds": 0.0, "out": "", "err": report or "", "memory": _memory()}
            )
    except BaseException:
        _send(write, {"code": 1, "seconds": 0.0, "out": "", "err": traceback.format_exc()[-3000:], "memory": 0})
    finally:
        os._exit(0)


def _one(command: Sequence[str]) -> tuple[int, float]:
    start = _processor()
    try:
        code = bodylog_cli.run_command(list(command))
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 1
    except BaseException:
        traceback.print_exc()
        code = 1
    with contextlib.suppress(Exception):
        sys.stdout.flush()
        sys.stderr.flush()
    return code, _processor() - start


def _processor() -> float:
    """Seconds of processor time: other processes may load this machine."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def _words(out: int, err: int) -> dict[str, str]:
    """The output since the last call."""
    report = {}
    for name, handle in (("out", out), ("err", err)):
        os.lseek(handle, 0, os.SEEK_SET)
        report[name] = os.read(handle, 1 << 22).decode("utf-8", "backslashreplace")
        os.ftruncate(handle, 0)
        os.lseek(handle, 0, os.SEEK_SET)
    return report


def _memory() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10


def _send(write: int, report: dict[str, object]) -> None:
    data = json.dumps(report).encode()
    data = len(data).to_bytes(4, "little") + data
    while data:
        data = data[os.write(write, data) :]


def _collect(child: int, read: int, commands: Sequence[Sequence[str]], out: int, err: int) -> list[Run]:
    runs: list[Run] = []
    names = [*map(tuple, commands), ("check",)]
    while len(runs) < len(names) and (report := _receive(read)) is not None:
        runs.append(Run(names[len(runs)], **report))
    late = len(runs) < len(commands)
    if late:
        with contextlib.suppress(ProcessLookupError):
            os.kill(child, signal.SIGKILL)
    _, status, usage = os.wait4(child, 0)
    if late:
        why = f"did not end: status {status}"
        runs.append(
            Run(names[len(runs)], None, "", f"{why}; {_words(out, err)['err'][-2000:]}", SECONDS, usage.ru_maxrss << 10)
        )
    return runs


def _receive(read: int) -> dict[str, object] | None:
    head = _bytes(read, 4)
    body = _bytes(read, int.from_bytes(head, "little")) if head else None
    return json.loads(body) if body else None


def _bytes(read: int, count: int) -> bytes | None:
    data, until = b"", time.monotonic() + PATIENCE
    while len(data) < count:
        ready, _, _ = select.select([read], [], [], max(0.0, until - time.monotonic()))
        piece = os.read(read, count - len(data)) if ready else b""
        if not piece:
            return None
        data += piece
    return data


def plain(one: Run) -> dict[str, object]:
    """A run for JSON."""
    return asdict(one) | {"command": list(one.command)}


def folder(path: Path) -> dict[str, tuple[int, int]]:
    """Names, sizes and times of everything in a folder."""
    found = {}
    for place, _, names in os.walk(os.fsencode(path)):
        for name in names:
            status = os.lstat(place + b"/" + name)
            found[os.fsdecode(place + b"/" + name)] = (status.st_size, status.st_mtime_ns)
    return found
