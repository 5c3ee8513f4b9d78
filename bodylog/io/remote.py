"""Logs behind URLs (s3://, http://, file://, memory:// others of fsspec): list, measure, fetch."""

import posixpath
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from ..errors import BodylogError, LogError, UsageError
from . import atomic_files, temporary
from .extras import require_module
from .outputs import METADATA, RECORDED

T = TypeVar("T")
_MARGIN = 256 << 20
_BLOCK = 4 << 20
WAIT_S = 20.0
"""s without an answer from a server, where there are no settings."""
_SLOWEST = 10_000
"""Bytes a second: a server that sends less is given up."""
_LONGEST_PAGE = 16 << 20
_MOST_PAGES = 1000
"""Folders of a web server that are searched for logs;
each is a page of links, which may go on for ever.
"""
_PAGES_S = 10.0
"""Times the longest wait for one answer that a list of many pages may take."""
_LARGEST = 1 << 50
_WEB = ("http", "https")


def is_url(text: str) -> bool:
    """Whether this is a URL and not a path."""
    scheme, colon, _ = text.partition("://")
    return bool(colon) and scheme.isalnum()


def expand_url(url: str, suffixes: tuple[str, ...], wait_s: float = WAIT_S) -> tuple[str, ...]:
    """The URLs of logs under a URL: itself, or the matches
    of its pattern or folder; LogError without any.
    """
    with _store_errors(url, wait_s):
        store, path = _open_remote_store(url, wait_s)
        if _is_web(url):
            if not any(sign in path for sign in "*[") and not store.isdir(path):
                return (url,)
            found = [
                entry for entry in _linked_files(store, path, wait_s) if entry.endswith(suffixes)
            ]
        elif any(sign in path for sign in "*["):
            listed = _wait_for_answer(lambda: store.glob(path), _PAGES_S * wait_s)
            found = [entry for entry in listed if entry.endswith(suffixes)]
        elif _wait_for_answer(lambda: store.isdir(path) and not store.isfile(path), wait_s):
            listed = _wait_for_answer(lambda: store.find(path), _PAGES_S * wait_s)
            found = [entry for entry in listed if entry.endswith(suffixes)]
        else:
            return (url,)
        urls = tuple(sorted(store.unstrip_protocol(entry) for entry in found))
    if not urls:
        raise LogError(f"{url}: no log in there; logs end in {', '.join(suffixes)}")
    return urls


def name_of(url: str) -> str:
    """The file name at the end of a URL, made safe."""
    from urllib.parse import unquote

    name = posixpath.basename(unquote(url.split("?", 1)[0].rstrip("/")))
    return re.sub(r"[^A-Za-z0-9._-]", "_", name).lstrip(".") or "log"


def _is_web(url: str) -> bool:
    return url.partition("://")[0].lower() in _WEB


def _linked_files(store: Any, top: str, wait_s: float) -> list[str]:
    """The files that the pages below an address link to,
    or that match its pattern; LogError if there is no end.
    """
    import time

    from fsspec.utils import glob_translate

    begin = re.split(r"[*\[]", top)[0]
    pattern = re.compile(glob_translate(top)) if begin != top else None
    left = [begin.rpartition("/")[0] + "/" if pattern else top]
    seen = set[str]()
    found = list[str]()
    until = time.monotonic() + _PAGES_S * wait_s
    while left:
        page = left.pop()
        if page in seen:
            continue
        seen.add(page)
        if len(seen) > _MOST_PAGES or time.monotonic() > until:
            raise LogError(
                f"{top}: its pages of links have no end; name a folder nearer to the logs"
            )
        for entry in store.ls(page, detail=True):
            name = str(entry["name"])
            if name.endswith("/"):
                left.append(name)
            elif pattern is None or pattern.match(name):
                found.append(name)
    return found


def file_behind(url: str) -> Path | None:
    """The local file of a URL (file://, local://); None for any other."""
    if url.partition("://")[0].lower() not in ("file", "local"):
        return None
    with _store_errors(url, WAIT_S):
        return Path(_open_remote_store(url, WAIT_S)[1])


def remote_size_bytes(url: str, wait_s: float = WAIT_S) -> int:
    """Bytes behind a URL, 0 for a folder; LogError if unknown, impossible or unreachable."""
    with _store_errors(url, wait_s):
        store, path = _open_remote_store(url, wait_s)
        details = _wait_for_answer(lambda: store.info(path), wait_s)
    if _is_folder(details):
        return 0
    found = details.get("size")
    if found is None:
        raise LogError(f"{url}: its server does not give its size; download it and give the file")
    if not 0 <= int(found) <= _LARGEST:
        raise LogError(f"{url}: its server announces {int(found)} bytes; check the address")
    return int(found)


def remote_identity(url: str, wait_s: float = WAIT_S) -> str:
    """A digest of a remote file's metadata (size and tag or date): it changes with the file."""
    with _store_errors(url, wait_s):
        store, path = _open_remote_store(url, wait_s)
        details = _wait_for_answer(lambda: store.info(path), wait_s)
    telling = (
        "size",
        "ETag",
        "etag",
        "mtime",
        "LastModified",
        "last_modified",
        "created",
        "md5",
        "sha256",
    )
    from hashlib import sha256

    return sha256(
        repr([url, *((key, str(details.get(key))) for key in telling)]).encode()
    ).hexdigest()


def read_range(url: str, start: int, end: int, wait_s: float = WAIT_S) -> bytes:
    """The bytes of a file from `start` to before `end`, or
    fewer; LogError where a web server does not send a range.
    """
    with _store_errors(url, wait_s):
        store, path = _open_remote_store(url, wait_s)
        if not _is_web(url):
            patience = wait_s + (end - start) / _SLOWEST
            return bytes(
                _wait_for_answer(lambda: store.cat_file(path, start=start, end=end), patience)
            )
        found = bytearray()
        if not _stream_web_file(store, path, (start, end), wait_s, found.extend):
            raise LogError(
                f"{url}: its server does not send parts of files; download it and give the file"
            )
        return bytes(found)


def read_first_bytes(url: str, count: int, wait_s: float = WAIT_S) -> tuple[bytes, bool]:
    """The first `count` bytes of a file, and whether its server sends parts of files."""
    if not _is_web(url):
        return read_range(url, 0, count, wait_s), True
    with _store_errors(url, wait_s):
        store, path = _open_remote_store(url, wait_s)
        found = bytearray()
        in_parts = _stream_web_file(store, path, (0, count), wait_s, found.extend, whole=True)
        return bytes(found[:count]), in_parts


def _stream_web_file(
    store: Any,
    url: str,
    part: tuple[int, int],
    wait_s: float,
    take: Callable[[bytes], object],
    whole: bool = False,
) -> bool:
    """Give the bytes of a web server's file to `take`, as
    many as asked for at most; whether they are that part.

    A server may ignore which part is asked for, send more, or hardly anything. With `whole`, the
    beginning of the whole file will do.
    """
    from fsspec import asyn

    async def receive() -> bool:
        import aiohttp

        start, end = part
        patience = aiohttp.ClientTimeout(total=wait_s + (end - start) / _SLOWEST, sock_read=wait_s)
        asked = {"Range": f"bytes={start}-{end - 1}", "Accept-Encoding": "identity"}
        session = await store.set_session()
        async with session.get(store.encode_url(url), headers=asked, timeout=patience) as answer:
            store._raise_not_found_for_status(answer, url)
            answer.raise_for_status()
            if answer.status != 206 and not whole:
                return False
            left = end - start
            async for piece in answer.content.iter_chunked(_BLOCK):
                take(piece[:left])
                left -= len(piece)
                if left <= 0:
                    answer.close()
                    break
            return bool(answer.status == 206)

    return bool(asyn.sync(store.loop, receive))


@contextmanager
def local_copy(source: str, folder: Path, wait_s: float = WAIT_S) -> Iterator[Path]:
    """A local path for a file or folder: its own, or for
    a URL a copy in `folder` that is removed afterwards.
    """
    if not is_url(source):
        yield Path(source)
        return
    with temporary.create_scratch_folder(atomic_files.ensure_dir(folder)) as beside:
        path = beside / name_of(source)
        with errors_about(path, source):
            yield _fetch_to_path(source, path, wait_s)


@contextmanager
def errors_about(path: Path, url: str) -> Iterator[None]:
    """Turn errors about a local copy into errors about its URL."""
    try:
        yield
    except BodylogError as err:
        raise type(err)(str(err).replace(str(path), url)) from err


def _is_folder(details: Mapping[str, Any]) -> bool:
    """Whether a store's details are those of a folder, which a web server lists as a page."""
    return details.get("type") == "directory" or details.get("mimetype") == "text/html"


def _fetch_to_path(url: str, path: Path, wait_s: float) -> Path:
    """Copy a file, or the log files of a folder (rosbag2), to `path`."""
    with _store_errors(url, wait_s):
        store, remote = _open_remote_store(url, wait_s)
        if not _is_folder(_wait_for_answer(lambda: store.info(remote), wait_s)):
            return _fetch_file(url, path, wait_s)
        listed = _wait_for_answer(lambda: store.ls(remote, detail=False), _PAGES_S * wait_s)
        entries = sorted(store.unstrip_protocol(entry) for entry in listed)
    inside = [entry for entry in entries if entry.rpartition("/")[0] == url.rstrip("/")]
    wanted = [entry for entry in inside if entry.endswith((*RECORDED, f"/{METADATA}"))]
    if not any(entry.endswith(f"/{METADATA}") for entry in wanted):
        raise LogError(
            f"{url}: a folder or page without {METADATA}, so no rosbag2 log; give the "
            "address of a log"
        )
    path.mkdir()
    for entry in wanted:
        _fetch_file(entry, path / name_of(entry), wait_s)
    return path


def _fetch_file(url: str, path: Path, wait_s: float) -> Path:
    import shutil

    wanted = remote_size_bytes(url, wait_s)
    free = shutil.disk_usage(path.parent).free - _MARGIN
    if wanted > free:
        raise LogError(
            f"{url}: {wanted} bytes, where {free} are free in {path.parent}; give a folder "
            "with more room"
        )
    with _store_errors(url, wait_s), path.open("wb") as target:
        store, remote = _open_remote_store(url, wait_s)
        if not _is_web(url):
            how = {"block_size": _BLOCK, "cache_type": "readahead"}
            with _wait_for_answer(lambda: store.open(remote, "rb", **how), wait_s) as source:
                while piece := _wait_for_answer(
                    lambda: source.read(_BLOCK), wait_s + _BLOCK / _SLOWEST
                ):
                    target.write(piece)
        elif wanted:
            _stream_web_file(store, remote, (0, wanted), wait_s, target.write, whole=True)
    if path.stat().st_size != wanted:
        raise LogError(
            f"{url}: {path.stat().st_size} bytes arrived, {wanted} were announced; try again"
        )
    return path


def _wait_for_answer(call: Callable[[], T], wait_s: float) -> T:
    """What a store answers; TimeoutError where it takes more than `wait_s`.

    Stores other than web servers know no common limit:
    one that does not answer is left behind in its thread.
    """
    from contextvars import copy_context
    from queue import Empty, SimpleQueue
    from threading import Thread

    answered: SimpleQueue[tuple[bool, Any]] = SimpleQueue()

    def wait_for_it() -> None:
        try:
            answered.put((True, call()))
        except BaseException as problem:  # raised again where it is waited for
            answered.put((False, problem))

    Thread(target=copy_context().run, args=(wait_for_it,), daemon=True).start()
    try:
        sound, value = answered.get(timeout=wait_s)
    except Empty:
        raise TimeoutError(f"no answer within {wait_s:g} s") from None
    if not sound:
        raise value
    found: T = value
    return found


def _open_remote_store(url: str, wait_s: float) -> tuple[Any, str]:
    fsspec = require_module("fsspec")
    options: dict[str, Any] = {}
    if _is_web(url):
        import aiohttp

        patience = aiohttp.ClientTimeout(total=wait_s)
        options = {"get_client": _session, "client_kwargs": {"timeout": patience}}
    store, path = fsspec.core.url_to_fs(url, **options)
    return store, str(path)


async def _session(**options: Any) -> Any:
    """A session of which no answer takes more than _LONGEST_PAGE, where it is read as a whole."""
    import aiohttp

    class Page(aiohttp.ClientResponse):
        async def read(self) -> bytes:
            if self._body is None:
                found = bytearray()
                async for piece in self.content.iter_any():
                    found += piece
                    if len(found) > _LONGEST_PAGE:
                        self.close()
                        raise ValueError(f"a page of more than {_LONGEST_PAGE} bytes")
                self._body = bytes(found)
            return self._body

    return aiohttp.ClientSession(response_class=Page, **options)


@contextmanager
def _store_errors(url: str, wait_s: float) -> Iterator[None]:
    """Turn any exception of a store's own library into one line."""
    try:
        yield
    except (LogError, UsageError):
        raise
    except ImportError as err:
        raise UsageError(f"{url}: {err}") from None
    except Exception as err:  # each store has its own exceptions, without a common base
        # a store may call a file missing because of any error, as no answer
        cause = (
            err.__cause__
            if isinstance(err, FileNotFoundError) and err.__cause__ is not None
            else err
        )
        if isinstance(cause, TimeoutError):
            asked = f"to wait longer, type in robot.toml: [input] max_wait_s = {round(10 * wait_s)}"
            raise LogError(
                f"{url}: its server did not answer within {wait_s:g} s; {asked}"
            ) from None
        if isinstance(cause, FileNotFoundError) or getattr(cause, "status", None) in (404, 410):
            raise LogError(f"{url}: there is no such file; check the address") from None
        text = " ".join(str(cause).split()) or type(cause).__name__
        raise LogError(f"{url}: it cannot be read: {text}") from None
