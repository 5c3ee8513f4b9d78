"""A headless Chromium driven over the WebDriver protocol with nothing but the standard library."""

import json
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from urllib.request import ProxyHandler, Request, build_opener

DRIVER, BROWSER = shutil.which("chromedriver"), shutil.which("chromium") or shutil.which("google-chrome")
_SWITCHES = ["--headless=new", "--no-sandbox", "--disable-gpu", "--window-size=1200,900", "--disable-dev-shm-usage"]
_OPEN = build_opener(ProxyHandler({}))


class Page:
    """One browser window."""

    def __init__(self, base: str) -> None:
        options = {"binary": BROWSER, "args": _SWITCHES}
        wanted = {"goog:chromeOptions": options, "goog:loggingPrefs": {"browser": "ALL"}}
        self._base = base
        started = self._ask("POST", "/session", {"capabilities": {"alwaysMatch": wanted}})
        self._base += f"/session/{started['sessionId']}"

    def open(self, path: Any, fragment: str = "") -> None:
        self._ask("POST", "/url", {"url": "about:blank"})
        self._ask("POST", "/url", {"url": path.as_uri() + fragment})
        self.settle()

    def run(self, script: str, *arguments: Any) -> Any:
        """What `return …` in the script gives."""
        return self._ask("POST", "/execute/sync", {"script": script, "args": list(arguments)})

    def settle(self) -> None:
        """Wait until two frames have been drawn."""
        wait = "const done = arguments[0]; requestAnimationFrame(() => requestAnimationFrame(() => done(0)))"
        self._ask("POST", "/execute/async", {"script": wait, "args": []})

    def drag(self, start: tuple[int, int], end: tuple[int, int]) -> None:
        """Press at start (px in the window), move to end, let go."""
        steps = [_move(*start), {"type": "pointerDown", "button": 0}, _move(*end), {"type": "pointerUp", "button": 0}]
        pointer = {"type": "pointer", "id": "mouse", "parameters": {"pointerType": "mouse"}, "actions": steps}
        self._ask("POST", "/actions", {"actions": [pointer]})
        self.settle()

    def press(self, key: str) -> None:
        steps = [{"type": "keyDown", "value": key}, {"type": "keyUp", "value": key}]
        self._ask("POST", "/actions", {"actions": [{"type": "key", "id": "keys", "actions": steps}]})
        self.settle()

    def complaints(self) -> list[str]:
        """Everything the console has said since it was last asked."""
        return [entry["message"] for entry in self._ask("POST", "/se/log", {"type": "browser"})]

    def close(self) -> None:
        self._ask("DELETE", "")

    def _ask(self, method: str, path: str, values: dict[str, Any] | None = None) -> Any:
        body = None if values is None else json.dumps(values).encode()
        with _OPEN.open(Request(self._base + path, body, {"Content-Type": "application/json"}, method=method)) as reply:
            return json.load(reply)["value"]


def _move(x: int, y: int) -> dict[str, Any]:
    return {"type": "pointerMove", "x": x, "y": y, "duration": 0}


@contextmanager
def page() -> Iterator[Page]:
    """A browser window that is closed, and its driver ended, on the way out."""
    with subprocess.Popen([str(DRIVER), "--port=0"], stdout=subprocess.PIPE, text=True) as driver:
        try:
            window = Page(f"http://127.0.0.1:{_port(driver)}")
            yield window
            window.close()
        finally:
            driver.terminate()


def _port(driver: "subprocess.Popen[str]") -> int:
    assert driver.stdout is not None
    for line in driver.stdout:
        if "on port" in line and "started" in line:
            return int(line.rstrip(". \n").rsplit(" ", 1)[1])
    raise RuntimeError("chromedriver did not start")


RANGES = "return [...document.querySelectorAll('canvas')].map((c) => [Number(c.dataset.from), Number(c.dataset.to)])"
DRAWN = "return [...document.querySelectorAll('canvas')].map((c) => c.toDataURL())"
SHOW = """const c = document.querySelectorAll('canvas')[arguments[0]]; c.scrollIntoView({block: 'center'});
const b = c.getBoundingClientRect(); return [b.left, b.top, b.width, b.height]"""
BLANK = """const c = document.createElement('canvas'); [c.width, c.height] = arguments; return c.toDataURL()"""


def drag_across(window, index, start, end):
    """Drag over one canvas between two shares of its width."""
    left, top, width, height = window.run(SHOW, index)
    window.settle()
    y = round(top + height / 2)
    window.drag((round(left + start * width), y), (round(left + end * width), y))
