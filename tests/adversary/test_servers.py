"""A server that sends without end, or nothing, is given up in one line, within the time and memory that are set."""

import resource
import time

import pytest

from bodylog import info
from bodylog.errors import LogError
from bodylog.io import remote
from bodylog.logs.limits import Input
from bodylog.settings import Settings

from . import servers
from .grammar import Draw

pytest.importorskip("fsspec")
pytest.importorskip("aiohttp")

CONTENT = b"\x89MCAP0\r\n" + bytes(1 << 20)


@pytest.mark.parametrize("kind", ["silent", "silent body"])
def test_info_gives_up_a_server_that_does_not_answer(kind):
    started = time.monotonic()
    with servers.serving(Draw(1, 0.0), CONTENT, kind) as url, pytest.raises(LogError) as caught:
        info.describe_file(url, Settings(input=Input(max_wait_s=0.5)))
    asked = "to wait longer, type in robot.toml: [input] max_wait_s = 5"
    assert f"did not answer within 0.5 s; {asked}" in str(caught.value)
    assert time.monotonic() - started < 10


@pytest.mark.parametrize("kind", ["endless", "endless part"])
def test_read_range_takes_no_more_than_was_asked_for(kind):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with servers.serving(Draw(1, 0.0), CONTENT, kind) as url:
        found, in_parts = remote.read_first_bytes(url, 64, 2.0)
    assert (len(found), in_parts) == (64, kind == "endless part")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < servers.ENDLESS >> 11


@pytest.mark.parametrize("kind", ["whole", "endless", "endless part"])
def test_local_takes_no_more_than_was_announced(tmp_path, kind):
    with servers.serving(Draw(1, 0.0), CONTENT, kind) as url, remote.local_copy(url, tmp_path, 2.0) as here:
        assert here.read_bytes() == CONTENT


@pytest.mark.parametrize("kind", ["huge", "negative", "text size", "long header", "redirects", "closes", "500", "204"])
def test_info_refuses_lying_servers_in_one_line(kind):
    with servers.serving(Draw(1, 0.0), CONTENT, kind) as url, pytest.raises(LogError) as caught:
        info.describe_file(url, Settings(input=Input(max_wait_s=1.0)))
    assert url in str(caught.value) and "\n" not in str(caught.value)


def test_expand_ends_on_pages_without_end():
    with servers.serving(Draw(1, 0.0), b"", "links") as url, pytest.raises(LogError, match="have no end"):
        remote.expand_url(url.rpartition("/")[0] + "/", (".mcap",), 0.2)
