"""Logs behind URLs (s3://, http://, file://, memory:// and others of fsspec): list, measure, fetch."""

import posixpath
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..errors import BodylogError, LogError, UsageError
from . import atomic_files, temporary
from .outputs import METADATA, RECORDED

_MARGIN = 256 << 20
_BLOCK = 4 << 20


def is_url(text: str) -> bool:
    """Whether this is a URL and not a path."""
    scheme, colon, _ = text.partition("://")
    return bool(colon) and scheme.isalnum()


def expand(url: str, suffixes: tuple[str, ...]) -> tuple[str, ...]:
    """The URLs of logs under a URL: itself, or the matches of its pattern or folder; LogError without any."""
    with _store_errors(url):
        store, path = _store(url)
        if any(sign in path for sign in "*["):
            found = [entry for entry in store.glob(path) if entry.endswith(suffixes)]
        elif store.isdir(path) and not store.isfile(path):
            found = [entry for entry in store.find(path) if entry.endswith(suffixes)]
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


def file_behind(url: str) -> Path | None:
    """The local file of a URL (file://, local://); None for any other."""
    if url.partition("://")[0].lower() not in ("file", "local"):
        return None
    with _store_errors(url):
        return Path(_store(url)[1])


def size(url: str) -> int:
    """Bytes behind a URL, 0 for a folder; LogError if unknown or unreachable."""
    with _store_errors(url):
        store, path = _store(url)
        details = store.info(path)
    if _is_folder(details):
        return 0
    found = details.get("size")
    if found is None:
        raise LogError(f"{url}: its server does not give its size; download it and give the file")
    return int(found)


def identity(url: str) -> str:
    """A digest of a remote file's metadata (size and tag or date): it changes with the file."""
    with _store_errors(url):
        store, path = _store(url)
        details = store.info(path)
    telling = ("size", "ETag", "etag", "mtime", "LastModified", "last_modified", "created", "md5", "sha256")
    from hashlib import sha256

    return sha256(repr([url, *((key, str(details.get(key))) for key in telling)]).encode()).hexdigest()


def read_range(url: str, start: int, end: int) -> bytes:
    """The bytes of a file from `start` to before `end`; the whole file if the server does not support ranges."""
    with _store_errors(url):
        store, path = _store(url)
        return bytes(store.cat_file(path, start=start, end=end))


@contextmanager
def local(source: str, folder: Path) -> Iterator[Path]:
    """A local path for a file or folder: its own, or for a URL a copy in `folder` that is removed afterwards."""
    if not is_url(source):
        yield Path(source)
        return
    with temporary.scratch(atomic_files.ensure_dir(folder)) as beside:
        path = beside / name_of(source)
        with errors_about(path, source):
            yield _fetch(source, path)


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


def _fetch(url: str, path: Path) -> Path:
    """Copy a file, or the log files of a folder (rosbag2), to `path`."""
    with _store_errors(url):
        store, remote = _store(url)
        if not _is_folder(store.info(remote)):
            return _fetch_file(url, path)
        entries = sorted(store.unstrip_protocol(entry) for entry in store.ls(remote, detail=False))
    inside = [entry for entry in entries if entry.rpartition("/")[0] == url.rstrip("/")]
    wanted = [entry for entry in inside if entry.endswith((*RECORDED, f"/{METADATA}"))]
    if not any(entry.endswith(f"/{METADATA}") for entry in wanted):
        raise LogError(f"{url}: a folder or page without {METADATA}, so no rosbag2 log; give the address of a log")
    path.mkdir()
    for entry in wanted:
        _fetch_file(entry, path / name_of(entry))
    return path


def _fetch_file(url: str, path: Path) -> Path:
    import shutil

    wanted, free = size(url), shutil.disk_usage(path.parent).free - _MARGIN
    if wanted > free:
        raise LogError(f"{url}: {wanted} bytes, where {free} are free in {path.parent}; give a folder with more room")
    with _store_errors(url):
        store, remote = _store(url)
        with store.open(remote, "rb", block_size=_BLOCK, cache_type="readahead") as source, path.open("wb") as target:
            shutil.copyfileobj(source, target, _BLOCK)
    if path.stat().st_size != wanted:
        raise LogError(f"{url}: {path.stat().st_size} bytes arrived, {wanted} were announced; try again")
    return path


def _store(url: str) -> tuple[Any, str]:
    try:
        import fsspec
    except ImportError as err:
        raise UsageError("a URL as a log needs fsspec; type: pip install 'bodylog[cloud]'") from err
    store, path = fsspec.core.url_to_fs(url)
    return store, str(path)


@contextmanager
def _store_errors(url: str) -> Iterator[None]:
    """Turn any exception of a store's own library into one line."""
    try:
        yield
    except (LogError, UsageError):
        raise
    except FileNotFoundError:
        raise LogError(f"{url}: there is no such file; check the address") from None
    except ImportError as err:
        raise UsageError(f"{url}: {err}") from None
    except Exception as err:  # each store has its own exceptions, without a common base
        text = " ".join(str(err).split()) or type(err).__name__
        raise LogError(f"{url}: it cannot be read: {text}") from None
