"""Headless Chromium, driven by the DevTools protocol over two pipes: nothing but the
browser is needed."""

import base64
import json
import os
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
PATIENCE = 60.0  # seconds until a wait is given up, on any machine


def found() -> str | None:
    """The browser of this machine."""
    return next((path for path in map(shutil.which, NAMES) if path), None)


class Browser:
    """A browser with one page.

    - `size`: of its window; `dark`: whether it prefers dark colours.
    """

    def __init__(self, size: tuple[int, int] = (1280, 900), dark: bool = False) -> None:
        path = found()
        assert path is not None
        self._folder = tempfile.mkdtemp(prefix="aslo_jax_browser_")
        ours, theirs = os.pipe(), os.pipe()
        # `--remote-debugging-pipe` reads from descriptor 3 and writes to 4.
        options = (
            "--headless=new --no-sandbox --disable-gpu --disable-dev-shm-usage "
            "--hide-scrollbars --no-first-run --disable-extensions "
            f"--disable-background-networking --user-data-dir={self._folder} "
            "--remote-debugging-pipe about:blank"
        )
        command = f"exec {path} {options} 3<&{ours[0]} 4>&{theirs[1]}"
        self._process = subprocess.Popen(
            ["bash", "-c", command],
            pass_fds=(ours[0], theirs[1]),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(ours[0])
        os.close(theirs[1])
        self._out, self._in = os.fdopen(ours[1], "wb", 0), os.fdopen(theirs[0], "rb", 0)
        self._rest, self._count, self._session = b"", 0, None
        self.events: list[dict[str, Any]] = []
        target = self("Target.createTarget", url="about:blank")["targetId"]
        attached = self("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self(f"{domain}.enable")
        self.resize(*size)
        self.prefer(dark)

    def __call__(self, method: str, **parameters: Any) -> dict[str, Any]:
        """What a command of the protocol gives."""
        self._count += 1
        message: dict[str, Any] = {"id": self._count, "method": method}
        message["params"] = parameters
        if self._session is not None:
            message["sessionId"] = self._session
        self._out.write(json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self._count:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return answer["result"]
            self.events.append(answer)

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self._rest:
            piece = self._in.read(1 << 16)
            if not piece:
                raise RuntimeError("The browser has ended.")
            self._rest += piece
        message, _, self._rest = self._rest.partition(b"\0")
        return json.loads(message)

    def open(self, address: str) -> None:
        """Go to an address."""
        self("Page.navigate", url=address)

    def value(self, expression: str) -> Any:
        """That of an expression of JavaScript, a promise too."""
        options = {"returnByValue": True, "awaitPromise": True}
        found = self("Runtime.evaluate", expression=expression, **options)
        if "exceptionDetails" in found:
            raise RuntimeError(str(found["exceptionDetails"]))
        return found["result"].get("value")

    def wait(self, expression: str) -> Any:
        """Its value, once that is true."""
        until = time.monotonic() + PATIENCE
        while time.monotonic() < until:
            value = self.value(expression)
            if value:
                return value
            time.sleep(0.01)
        raise TimeoutError(expression)

    def press(self, key: str, times: int = 1) -> None:
        """Press a key, by its name."""
        codes = {"ArrowRight": 39, "ArrowLeft": 37, "Tab": 9, "End": 35, "Home": 36}
        about = {"key": key, "code": key, "windowsVirtualKeyCode": codes[key]}
        for _ in range(times):
            self("Input.dispatchKeyEvent", type="rawKeyDown", **about)
            self("Input.dispatchKeyEvent", type="keyUp", **about)

    def resize(self, width: int, height: int) -> None:
        """Of the window, in pixels of the page."""
        self(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )

    def prefer(self, dark: bool) -> None:
        """Colours."""
        value = "dark" if dark else "light"
        features = [{"name": "prefers-color-scheme", "value": value}]
        self("Emulation.setEmulatedMedia", features=features)

    def picture(self, path: Path, whole: bool = True) -> None:
        """Of the page, as PNG."""
        found = self("Page.captureScreenshot", captureBeyondViewport=whole, format="png")
        path.write_bytes(base64.b64decode(found["data"]))

    def errors(self) -> list[str]:
        """What the page has complained about so far."""
        self.value("1")
        kinds = ("Runtime.exceptionThrown", "Log.entryAdded")
        return [str(e["params"]) for e in self.events if e.get("method") in kinds]

    def requested(self) -> list[str]:
        """Every address that the page has asked for."""
        self.value("1")
        sent = [e for e in self.events if e.get("method") == "Network.requestWillBeSent"]
        return [e["params"]["request"]["url"] for e in sent]

    def close(self) -> None:
        """End it."""
        self._out.close()
        try:
            self._process.wait(20)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._in.close()
        shutil.rmtree(self._folder, ignore_errors=True)
