"""A web server on this machine that lies: about sizes, parts, ends and answers."""

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from .grammar import Draw

ENDLESS = 64 << 20
"""Bytes after which an endless answer ends, so that a test does."""
KINDS = (
    "whole",
    "endless",
    "endless part",
    "silent",
    "silent body",
    "slow",
    "huge",
    "negative",
    "no size",
    "text size",
    "long header",
    "wrong part",
    "closes",
    "redirects",
    "links",
    "404",
    "500",
    "204",
)
"""How a server lies."""


@contextmanager
def serving(draw: Draw, content: bytes, kind: str) -> Iterator[str]:
    """The address of a log on a server of that kind."""
    listener = socket.create_server(("127.0.0.1", 0))
    port = listener.getsockname()[1]
    stop = threading.Event()

    def accept() -> None:
        while not stop.is_set():
            try:
                client, _ = listener.accept()
            except OSError:
                return
            threading.Thread(target=_answer, args=(client, content, kind, port, stop), daemon=True).start()

    threading.Thread(target=accept, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{port}/{draw.of(('run.mcap', 'run.bag', 'logs/', 'a%20b.db3'))}"
    finally:
        stop.set()
        listener.close()


def _answer(client: socket.socket, content: bytes, kind: str, port: int, stop: threading.Event) -> None:
    with client:
        try:
            client.settimeout(5.0)
            asked = b""
            while b"\r\n\r\n" not in asked:
                if not (piece := client.recv(65_536)):
                    return
                asked += piece
            _speak(client, asked, content, kind, port, stop)
        except OSError:
            return


def _speak(client: socket.socket, asked: bytes, content: bytes, kind: str, port: int, stop: threading.Event) -> None:
    is_head = asked.startswith(b"HEAD")
    wanted = next((line[13:] for line in asked.split(b"\r\n") if line.lower().startswith(b"range: bytes=")), b"")
    size = str(len(content))
    if kind == "silent":
        stop.wait(60.0)
        return
    if kind in ("404", "500", "204"):
        client.sendall(f"HTTP/1.1 {kind} x\r\nContent-Length: 0\r\n\r\n".encode())
        return
    if kind == "redirects":
        client.sendall(f"HTTP/1.1 302 x\r\nLocation: http://127.0.0.1:{port}/{time.monotonic()}\r\n\r\n".encode())
        return
    if kind == "links":
        page = "".join(f'<a href="{k}/">x</a>' for k in range(20)).encode()
        head = f"HTTP/1.1 200 OK\r\nContent-Type: text/html\r\nContent-Length: {len(page)}\r\n\r\n"
        client.sendall(head.encode() + (b"" if is_head else page))
        return
    if kind == "long header":
        client.sendall(b"HTTP/1.1 200 OK\r\n" + b"X: " + b"x" * 10**6 + b"\r\n\r\n")
        return
    sizes = {"huge": str(1 << 62), "negative": "-5", "text size": "many", "endless": str(len(content))}
    size = sizes.get(kind, size)
    part = kind not in ("whole", "endless") and bool(wanted) and not is_head
    low, _, high = wanted.decode("latin-1").partition("-")
    start, end = (int(low or 0), int(high or len(content)) + 1) if part else (0, len(content))
    body = content[start:end]
    head = f"HTTP/1.1 {206 if part else 200} OK\r\n"
    if part:
        head += f"Content-Range: bytes {start}-{end - 1}/{size}\r\n"
    endless = kind in ("endless", "endless part") and not is_head
    if kind != "no size" and not endless:
        head += f"Content-Length: {len(body) if part else size}\r\n"
    client.sendall((head + "Connection: close\r\n\r\n").encode())
    if is_head or kind == "closes":
        return
    if kind == "silent body":
        stop.wait(60.0)
    elif kind == "slow":
        for byte in body:
            if stop.wait(0.5):
                return
            client.sendall(bytes([byte]))
    elif kind == "wrong part":
        client.sendall(bytes(len(body)))
    else:
        client.sendall(body)
        for _ in range(ENDLESS >> 16 if endless else 0):
            client.sendall(bytes(1 << 16))
