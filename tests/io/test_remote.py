"""Logs behind URLs: listed, read by ranges, fetched whole, and one-line errors."""

import gc
import json
import os
import shutil
import threading
from contextlib import contextmanager
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

import bodylog.logs as logs
from bodylog import info
from bodylog.errors import BodylogError, LogError, UsageError
from bodylog.io import remote
from bodylog.logs.formats import payload_views
from bodylog.settings import Settings
from tests.logs.writing import T0, Stream, write

pytest.importorskip("fsspec")

FILES = sorted((Path(__file__).parents[2] / "fixtures" / "containers").glob("*.mcap"))


class _Ranges(SimpleHTTPRequestHandler):
    """A file server that supports ranges."""

    def log_message(self, *_: object) -> None:
        """Print nothing."""

    def do_GET(self) -> None:
        """Serve the file or the requested range."""
        path = Path(self.translate_path(self.path))
        if not path.is_file():
            super().do_GET()
            return
        size, asked = path.stat().st_size, self.headers.get("Range")
        low, _, high = asked.removeprefix("bytes=").partition("-") if asked else ("0", "-", "")
        begin, end = int(low), min(int(high) + 1, size) if high else size
        self.send_response(206 if asked else 200)
        self.send_header("Content-Range", f"bytes {begin}-{end - 1}/{size}")
        self.send_header("Accept-Ranges", "bytes")
        self.send_header("Content-Length", str(end - begin))
        self.end_headers()
        self.wfile.write(path.read_bytes()[begin:end])


class _Whole(SimpleHTTPRequestHandler):
    """A file server without ranges."""

    def log_message(self, *_: object) -> None:
        """Print nothing."""


class _Cut(_Ranges):
    """A file server that ends ranges after 100 bytes."""

    def do_GET(self) -> None:
        """Serve the file or the first part of the range."""
        if asked := self.headers.get("Range"):
            low, _, high = asked.removeprefix("bytes=").partition("-")
            self.headers.replace_header("Range", f"bytes={low}-{min(int(high), int(low) + 99)}")
        super().do_GET()


@contextmanager
def _serving(folder, kind):
    """The address of a folder that a kind of server serves."""
    pytest.importorskip("aiohttp")
    server = ThreadingHTTPServer(("127.0.0.1", 0), lambda *a: kind(*a, directory=str(folder)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()


@pytest.fixture
def served(tmp_path):
    """A folder and its address."""
    folder = tmp_path / "served"
    folder.mkdir()
    with _serving(folder, _Ranges) as address:
        yield folder, address


def _described(read):
    try:
        found = read()
    except BodylogError as err:
        return type(err)
    return {key: value for key, value in found.items() if key != "path"}


def _named(described, path, url):
    """The same with findings about the URL."""
    if isinstance(described, type):
        return described
    findings = [{**finding, "text": finding["text"].replace(path, url)} for finding in described["findings"]]
    return {**described, "findings": findings}


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_mapped_remote_info_equals_the_files(path):
    url = path.resolve().as_uri()
    here = _described(lambda: info.describe_file(path, Settings()))
    assert _described(lambda: info.describe_file(url, Settings())) == _named(here, str(path), url)


def test_mapped_remote_reads_no_images_for_info(tmp_path, monkeypatch):
    pictures = [(T0 + k * 10**6, os.urandom(1 << 20)) for k in range(48)]
    words = [(T0 + 10**9, b"\x00\x01\x00\x00\x05\x00\x00\x00word\x00")]
    log = write(tmp_path / "large.mcap", [
        Stream("/blob", "std_msgs/msg/UInt8MultiArray", b"uint8[] data", pictures),
        Stream("/words", "std_msgs/msg/String", b"string data", words),
    ], chunk=1 << 22)  # fmt: skip
    brought, part = [], remote.read_range

    def counted(url, start, end, *wait_s):
        brought.append(end - start)
        return part(url, start, end, *wait_s)

    monkeypatch.setattr(remote, "read_range", counted)
    described = info.describe_file(log.as_uri(), Settings())
    assert [topic["messages"] for topic in described["topics"]] == [48, 1]
    assert log.stat().st_size > 48 << 20
    assert sum(brought) < 4 << 20


def test_info_over_http_equals_the_files(served, robot):
    folder, address = served
    shutil.copy(robot / "reach.mcap", folder / "reach.mcap")
    bag = Path(__file__).parents[2] / "fixtures" / "containers" / "lz4.bag"
    shutil.copy(bag, folder / "lz4.bag")
    for path in folder.iterdir():
        described, here = info.describe_file(f"{address}/{path.name}", Settings()), info.describe_file(path, Settings())
        assert described.pop("path") == f"{address}/{path.name}"
        here.pop("path")
        assert described == here


def _read(where):
    """Format, payloads and findings of a log; an error's class and text."""
    named = "LOG"
    try:
        with logs.open(where) as log:
            held = sorted((one.topic_id, bytes(payload)) for one in log.batches() for payload in payload_views(one))
            return log.format, held, [one.text.replace(str(where), named) for one in log.findings]
    except BodylogError as err:
        return type(err), str(err).replace(str(where), named)


@pytest.mark.parametrize("kind", [_Ranges, _Whole])
def test_logs_behind_urls_equal_the_files(kind):
    folder = FILES[0].parent
    names = [path.name for path in sorted(folder.iterdir()) if path.suffix != ".json"]
    assert {"split.bag", "cut_in_chunk.mcap", "cut.bag", "packed.mcap.zst", "humble.db3", "empty.mcap"} < set(names)
    with _serving(folder, kind) as address:
        for name in names:
            here, there = _read(folder / name), _read(f"{address}/{name}")
            assert there == here, name
        found = logs.examine(f"{address}/cut.bag")
        assert found and all("tmp" not in one.text and f"{address}/cut.bag" in one.text for one in found)


def test_interrupted_server_is_one_line(tmp_path, robot):
    with _serving(robot, _Cut) as address:
        kind, text = _read(f"{address}/reach.mcap")
    assert kind is LogError and "100 bytes arrived where 262144 were asked for; try again" in text
    (tmp_path / "page").mkdir()
    with _serving(tmp_path, _Ranges) as address, pytest.raises(LogError, match=r"page without metadata\.yaml"):
        logs.open(f"{address}/page")


def test_estimate_of_a_url_equals_the_files(tmp_path, robot, run_cli):
    here, there = tmp_path / "here.mcap", tmp_path / "there.mcap"
    assert run_cli("estimate", robot / "reach.mcap", "--body", robot / "body.npz", "-o", here) == 0
    url = (robot / "reach.mcap").as_uri()
    assert run_cli("estimate", url, "--body", robot / "body.npz", "-o", there) == 0
    assert there.read_bytes() == here.read_bytes()


def test_batch_over_a_url_resumes_until_the_file_changes(tmp_path, robot, run_cli):
    logs = tmp_path / "logs"
    logs.mkdir()
    for name in ("a.mcap", "b.mcap"):
        shutil.copy(robot / "reach.mcap", logs / name)
    typed = ("batch", logs.as_uri(), "-o", tmp_path / "out", "--body", robot / "body.npz")
    assert run_cli(*typed) == 0
    rows = [json.loads(line) for line in (tmp_path / "out" / "results.jsonl").read_text().splitlines()]
    assert [row["log"] for row in rows] == [(logs / name).as_uri() for name in ("a.mcap", "b.mcap")]
    assert not list((tmp_path / "out").rglob(".fetched*"))
    made = {name: (tmp_path / "out" / name / "row.json").stat().st_mtime_ns for name in ("a.mcap", "b.mcap")}
    os.utime(logs / "b.mcap", (1, 1))
    assert run_cli(*typed, "--resume") == 0
    again = {name: (tmp_path / "out" / name / "row.json").stat().st_mtime_ns for name in made}
    assert again["a.mcap"] == made["a.mcap"]
    assert again["b.mcap"] != made["b.mcap"]


def test_remote_errors_are_one_line(served, tmp_path):
    _, address = served
    for url in (f"{address}/none.mcap", f"file://{tmp_path}/none.mcap", "quux://x/y.mcap", "http://127.0.0.1:1/y.mcap"):
        with pytest.raises((LogError, UsageError)) as caught:
            info.describe_file(url, Settings())
        assert url in str(caught.value)
        assert "\n" not in str(caught.value)


def test_errors_about_a_fetched_log_name_its_url(tmp_path, robot, run_cli, capsys):
    url = (robot / "reach.mcap").as_uri()
    assert run_cli("evaluate", url) == 65
    assert url in capsys.readouterr().err
    url = (FILES[0].parent / "cut.bag").as_uri()
    for form in ((), ("--json",)):
        assert run_cli("doctor", url, *form) == 3
        printed = capsys.readouterr().out
        assert printed.count(url) >= 3 and "bodylog.part" not in printed


def test_name_of_is_safe():
    assert remote.name_of("https://host/a/..") == "log"
    assert remote.name_of("s3://bucket/run 1.mcap?versionId=3") == "run_1.mcap"
    assert remote.name_of("http://host/%2e%2e%2fetc%2fpasswd") == "passwd"
    assert not remote.is_url("C:/logs/run.mcap")


def test_mapped_remote_leaves_no_descriptor_open():
    url = FILES[0].resolve().as_uri()
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(3):
        info.describe_file(url, Settings())
    gc.collect()
    assert len(os.listdir("/proc/self/fd")) <= before


@pytest.fixture
def silent():
    """A store, of no web server, that never answers; its calls are counted."""
    import fsspec
    from fsspec.implementations.memory import MemoryFileSystem

    asked, ended = [], threading.Event()

    def never(*_: object, **__: object) -> None:
        asked.append(1)
        ended.wait(60.0)

    kind = type("Silent", (MemoryFileSystem,), {"protocol": "silent", "info": never, "isdir": never, "find": never})
    fsspec.register_implementation("silent", kind, clobber=True)
    yield asked
    ended.set()


def test_a_store_that_never_answers_is_given_up(silent, tmp_path, run_cli, capsys, robot):
    expected_error = r"silent://x/a.mcap: its server did not answer within 0.2 s; .*\[input\] max_wait_s = 2"
    with pytest.raises(LogError, match=expected_error):
        logs.open("silent://x/a.mcap", max_wait_s=0.2)
    (tmp_path / "robot.toml").write_text("[input]\nmax_wait_s = 0.2\n")
    settings = ("--config", tmp_path / "robot.toml")
    for typed in (
        ("fit", "silent://x/a.mcap", "-o", tmp_path / "out.npz", *settings),
        ("info", "silent://x/a.mcap", *settings),
        ("batch", "silent://x/a.mcap", "-o", tmp_path / "out", "--body", robot / "body.npz", *settings),
    ):
        before = len(silent)
        assert run_cli(*typed) == 65
        assert "did not answer within 0.2 s" in capsys.readouterr().err and len(silent) > before


def test_the_answer_of_a_store_and_its_errors_are_its_own():
    assert remote._wait_for_answer(lambda: 7, 1.0) == 7
    with pytest.raises(FileNotFoundError, match="gone"):
        remote._wait_for_answer(lambda: (_ for _ in ()).throw(FileNotFoundError("gone")), 1.0)
