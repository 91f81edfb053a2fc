"""A page in headless Chromium, driven over a pipe by the DevTools protocol."""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Final

CHROMIUM: Final = shutil.which("chromium") or shutil.which("chromium-browser")

_SWITCHES: Final = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run", "--disable-sync",
    "--disable-background-networking", "--disable-component-update", "--disable-extensions", "--hide-scrollbars",
    "--remote-debugging-pipe",
)  # fmt: skip


class Page:
    """An open page. requests: every address that was asked for. complaints: what scripts threw or logged as errors."""

    def __init__(self, browser: Browser, session: str) -> None:
        self._browser, self._session = browser, session
        self.requests: list[str] = []
        self.complaints: list[str] = []

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """The answer to a command of the protocol. Raises RuntimeError where it is refused."""
        return self._browser.call(method, self._session, **params)

    def close(self) -> None:
        """Close the page, and the browser's memory of it."""
        self.call("Page.close")

    def evaluate(self, expression: str) -> Any:
        """The value of a JavaScript expression, awaited, as JSON types. Raises RuntimeError where it throws."""
        answer = self.call("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(f"{expression}: {answer['exceptionDetails']}")
        return answer["result"].get("value")

    def size(self, width: int, height: int) -> None:
        """Give the page a window of so many pixels."""
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)

    def open(self, address: str) -> None:
        """Go to an address and wait until it is loaded."""
        self.call("Page.navigate", url=address)
        self._browser.wait_for("Page.loadEventFired", self._session)

    def press(self, key: str) -> None:
        """A key, as from a keyboard; Enter also types its character."""
        text = {"text": "\r"} if key == "Enter" else {}
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=_KEYS[key], **text)

    def screenshot(self, path: Path, *, whole: bool = False) -> None:
        """The window as PNG, or all of the page."""
        content = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=whole, **self._clip(whole))
        path.write_bytes(base64.b64decode(content["data"]))

    def _clip(self, whole: bool) -> dict[str, Any]:
        if not whole:
            return {}
        box = self.call("Page.getLayoutMetrics")["cssContentSize"]
        return {"clip": {**box, "scale": 1}}

    def hear(self, event: dict[str, Any]) -> None:
        """Note what the page asked for and complained about."""
        method, params = event["method"], event["params"]
        if method == "Network.requestWillBeSent":
            self.requests.append(params["request"]["url"])
        elif method == "Runtime.exceptionThrown":
            self.complaints.append(str(params["exceptionDetails"].get("exception", {}).get("description", params)))
        elif method == "Runtime.consoleAPICalled" and params["type"] in ("error", "warning", "assert"):
            self.complaints.append(json.dumps([found.get("value") for found in params["args"]]))
        elif method == "Log.entryAdded" and params["entry"]["level"] == "error":
            self.complaints.append(params["entry"]["text"])


_KEYS: Final = {"Enter": 13, "ArrowLeft": 37, "ArrowRight": 39, "Tab": 9}


class Browser:
    """A Chromium of its own, with its profile in `folder`."""

    def __init__(self, folder: Path) -> None:
        assert CHROMIUM is not None
        from_us, to_browser = os.pipe()
        from_browser, to_us = os.pipe()
        script = f'exec "$@" 3<&{from_us} 4>&{to_us}'
        command = ["bash", "-c", script, "bash", CHROMIUM, *_SWITCHES, f"--user-data-dir={folder}", "about:blank"]
        self._process = subprocess.Popen(
            command, pass_fds=(from_us, to_us), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        os.close(from_us)
        os.close(to_us)
        self._out, self._in = os.fdopen(to_browser, "wb", buffering=0), os.fdopen(from_browser, "rb")
        self._pages: dict[str, Page] = {}
        self._events: list[tuple[str, str]] = []
        self._count = 0
        self._waiting = b""

    def page(self) -> Page:
        """A new page that hears everything."""
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        page = self._pages[session] = Page(self, session)
        for domain in ("Page", "Runtime", "Network", "Log"):
            page.call(f"{domain}.enable")
        return page

    def call(self, method: str, session: str = "", **params: Any) -> dict[str, Any]:
        """The answer to a command."""
        self._count += 1
        number = self._count
        message = {"id": number, "method": method, "params": params, **({"sessionId": session} if session else {})}
        self._out.write(json.dumps(message).encode() + b"\0")
        while True:
            answer = self._read()
            if answer.get("id") == number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                found: dict[str, Any] = answer["result"]
                return found

    def wait_for(self, method: str, session: str) -> None:
        """Read until a page has sent an event."""
        while (method, session) not in self._events:
            self._read()
        self._events.remove((method, session))

    def _read(self) -> dict[str, Any]:
        while b"\0" not in self._waiting:
            found = self._in.read1(1 << 20)
            if not found:
                raise RuntimeError("chromium ended")
            self._waiting += found
        text, _, self._waiting = self._waiting.partition(b"\0")
        message: dict[str, Any] = json.loads(text)
        session = message.get("sessionId", "")
        if "method" in message and session in self._pages:
            self._events.append((message["method"], session))
            self._pages[session].hear(message)
        return message

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._out.close()
        self._in.close()
        self._process.terminate()
        self._process.wait(timeout=30)


@contextmanager
def browser(folder: Path) -> Iterator[Browser]:
    """A browser that is closed at the end."""
    with Browser(folder) as opened:
        yield opened
