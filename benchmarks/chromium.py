"""A headless Chromium with software rendering, controlled by its DevTools protocol."""

from __future__ import annotations

import base64
import contextlib
import json
import shutil
import subprocess
import tempfile
from pathlib import Path
from time import monotonic, sleep
from types import TracebackType
from typing import Any

from palpate.core.faults import InputError

BROWSER_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
BROWSER_OPTIONS = [
    "--headless=new", "--no-sandbox", "--disable-gpu", "--use-gl=angle", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--disable-extensions", "--hide-scrollbars", "--mute-audio",
    "--remote-debugging-port=0",
]  # fmt: skip
RESPONSE_TIMEOUT = 60.0  # [s] for the browser to start or answer


def find_chromium() -> str | None:
    """Return the path of an installed Chromium, or None."""
    return next((path for name in BROWSER_NAMES if (path := shutil.which(name))), None)


class Chromium:
    """A browser with a temporary profile; a context manager that ends it.

    Raises
    ------
    InputError
        Chromium is not installed, or does not start.
    """

    def __init__(self) -> None:
        program = find_chromium()
        if program is None:
            raise InputError("Chromium must be installed, got none; on Debian: apt-get install chromium")
        self._folder = tempfile.TemporaryDirectory(prefix="palpate-chromium-", ignore_cleanup_errors=True)
        command = [program, *BROWSER_OPTIONS, f"--user-data-dir={self._folder.name}", "about:blank"]
        self._process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        self._stack = contextlib.ExitStack()
        try:
            connection = _connection(self._process, Path(self._folder.name) / "DevToolsActivePort")
            self._socket = self._stack.enter_context(connection)
        except BaseException:
            self.close()
            raise
        self._count = 0
        self._tabs: dict[str, Tab] = {}

    def __enter__(self) -> Chromium:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """End the browser."""
        self._stack.close()
        self._process.terminate()
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._folder.cleanup()

    def open(
        self, address: str, width: int = 1280, height: int = 800, *, dark: bool = False, touch_screen: bool = False
    ) -> Tab:
        """Open a page in a new window of a size [px], by default with a mouse and in light colours."""
        target = self.call("Target.createTarget", {"url": "about:blank", "newWindow": True})["targetId"]
        session = self.call("Target.attachToTarget", {"targetId": target, "flatten": True})["sessionId"]
        tab = self._tabs[session] = Tab(self, session, target)
        for domain in ("Page", "Runtime", "Log"):
            tab.call(f"{domain}.enable")
        tab.resize(width, height)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        tab.call("Emulation.setEmulatedMedia", {"features": [scheme]})
        if touch_screen:
            tab.call("Emulation.setTouchEmulationEnabled", {"enabled": True, "maxTouchPoints": 2})
        tab.call("Emulation.setFocusEmulationEnabled", {"enabled": True})  # each window behaves as the focused one
        tab.call("Page.navigate", {"url": address})
        return tab

    def call(self, method: str, parameters: dict[str, Any] | None = None, session: str | None = None) -> dict[str, Any]:
        """Send a command and return its result; pass events that arrive before it to the tabs."""
        self._count += 1
        message: dict[str, Any] = {"id": self._count, "method": method, "params": parameters or {}}
        if session:
            message["sessionId"] = session
        self._socket.send(json.dumps(message))
        while True:
            answer = json.loads(self._socket.recv(timeout=RESPONSE_TIMEOUT))
            if answer.get("id") == self._count:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error'].get('message')}")
                return dict(answer["result"])
            if answer.get("sessionId") in self._tabs:
                self._tabs[answer["sessionId"]].handle_event(answer.get("method", ""), answer.get("params", {}))


def _connection(process: subprocess.Popen[bytes], port_file: Path) -> Any:
    from websockets.sync.client import connect

    end = monotonic() + RESPONSE_TIMEOUT
    while monotonic() < end and process.poll() is None:
        if port_file.is_file() and len(lines := port_file.read_text().split()) == 2:
            address = f"ws://127.0.0.1:{lines[0]}{lines[1]}"
            return connect(address, max_size=None, compression=None, open_timeout=RESPONSE_TIMEOUT)
        sleep(0.05)
    raise InputError(f"Chromium must start within {RESPONSE_TIMEOUT:g} s, got no answer; run it for its errors")


class Tab:
    """A page in the browser; `errors` holds the error messages of its console and scripts."""

    def __init__(self, browser: Chromium, session: str, target: str) -> None:
        self._browser, self._session, self._target = browser, session, target
        self.errors: list[str] = []

    def call(self, method: str, parameters: dict[str, Any] | None = None) -> dict[str, Any]:
        """Send a command to this page."""
        return self._browser.call(method, parameters, self._session)

    def handle_event(self, method: str, parameters: dict[str, Any]) -> None:
        """Process an event."""
        if method == "Runtime.exceptionThrown":
            details = parameters["exceptionDetails"]
            self.errors.append(details.get("exception", {}).get("description", details["text"]))
        elif method == "Runtime.consoleAPICalled" and parameters["type"] in ("error", "assert"):
            self.errors.append(" ".join(str(each.get("value", each.get("description"))) for each in parameters["args"]))
        elif method == "Log.entryAdded" and parameters["entry"]["level"] == "error":
            self.errors.append(f"{parameters['entry']['text']} {parameters['entry'].get('url', '')}".strip())

    def close(self) -> None:
        """Close the page."""
        self._browser.call("Target.closeTarget", {"targetId": self._target})

    def resize(self, width: int, height: int, scale: float = 1.0) -> None:
        """Resize the window [px]."""
        sizes = {"width": width, "height": height, "deviceScaleFactor": scale, "mobile": False}
        self.call("Emulation.setDeviceMetricsOverride", sizes)

    def evaluate(self, expression: str) -> Any:
        """Return the value of a JavaScript expression, awaited.

        Raises
        ------
        RuntimeError
            The expression threw an exception.
        """
        asked = {"expression": expression, "returnByValue": True, "awaitPromise": True}
        answer = self.call("Runtime.evaluate", asked)
        if "exceptionDetails" in answer:
            exception = answer["exceptionDetails"].get("exception", {})
            raise RuntimeError(exception.get("description", "the expression threw an exception"))
        return answer["result"].get("value")

    def wait(self, expression: str, seconds: float = 20.0) -> Any:
        """Return the value of an expression once it is true.

        Raises
        ------
        TimeoutError
            The expression was not true within the time.
        """
        end = monotonic() + seconds
        while monotonic() < end:
            if value := self.evaluate(expression):
                return value
            sleep(0.03)
        raise TimeoutError(f"not true within {seconds:g} s: {expression}; errors of the page: {self.errors}")

    def mouse(self, kind: str, x: float, y: float, button: str = "left", **more: Any) -> None:
        """Send a mouse event: ``"Pressed"``, ``"Moved"``, ``"Released"`` or ``"Wheel"`` (with deltaX, deltaY)."""
        pressed_buttons = {"left": 1, "right": 2, "none": 0}[button] if kind != "Released" else 0
        event = {"type": f"mouse{kind}", "x": x, "y": y, "button": button, "buttons": pressed_buttons, "clickCount": 1}
        self.call("Input.dispatchMouseEvent", event | more)

    def touch(self, kind: str, *points: tuple[float, float]) -> None:
        """Send a touch event: ``"Start"``, ``"Move"`` or ``"End"``, with the positions of all fingers."""
        fingers = [{"x": x, "y": y, "id": k} for k, (x, y) in enumerate(points)]
        self.call("Input.dispatchTouchEvent", {"type": f"touch{kind}", "touchPoints": fingers})

    def key(self, key: str) -> None:
        """Press and release a key, given by its name or its character."""
        text = {"text": key} if len(key) == 1 else {}
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", {"type": kind, "key": key, **(text if kind == "keyDown" else {})})

    def screenshot(self, path: Path | None = None) -> bytes:
        """Return the page as PNG, and write it to a file if given."""
        picture = base64.b64decode(self.call("Page.captureScreenshot", {"format": "png"})["data"])
        if path is not None:
            path.write_bytes(picture)
        return picture
