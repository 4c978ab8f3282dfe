"""Headless Chromium, driven over a pipe in its own protocol, so that keys are real keys."""

import json
import os
import shutil
import subprocess
from base64 import b64decode
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from conftest import need

Message = dict[str, Any]


class Browser:
    """One tab."""

    def __init__(self, to: int, of: int) -> None:
        self._to, self._of, self._rest, self._last = to, of, b"", 0
        self._session: str | None = None
        self.events: list[Message] = []
        target = self.ask("Target.createTarget", url="about:blank")["targetId"]
        session = self.ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        self._session = str(session)
        for domain in ("Page", "Network", "Runtime", "Log"):
            self.ask(f"{domain}.enable")

    def ask(self, method: str, **parameters: object) -> Message:
        """Send a command and wait for its answer; what else is said is kept in `events`."""
        self._last += 1
        message = {"id": self._last, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._read()
            if answer.get("id") == self._last:
                assert "error" not in answer, answer
                return dict(answer["result"])
            self.events.append(answer)

    def _read(self) -> Message:
        while b"\0" not in self._rest:
            read = os.read(self._of, 1 << 16)
            assert read, "the browser has gone"
            self._rest += read
        message, self._rest = self._rest.split(b"\0", 1)
        return dict(json.loads(message))

    def open(
        self, path: Path, at: str = "", *, width: int = 1280, height: int = 900, **media: str
    ) -> None:
        """Load a page and wait until it is there.

        `at` is a fragment such as `#scores`, `media` are features such as a colour scheme.
        """
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
        self.ask("Emulation.setDeviceMetricsOverride", **size)
        features = [{"name": k.replace("_", "-"), "value": v} for k, v in media.items()]
        self.ask("Emulation.setEmulatedMedia", features=features)
        self.events.clear()
        self.ask("Page.navigate", url=f"{path.as_uri()}{at}")
        while not self.said("Page.loadEventFired"):
            self.events.append(self._read())

    def said(self, method: str) -> list[Message]:
        """Parameters of the events of this kind since the page was opened."""
        return [dict(e["params"]) for e in self.events if e.get("method") == method]

    def run(self, script: str) -> Any:
        """What a JavaScript expression, or its promise, comes to, as JSON has it."""
        answer = self.ask(
            "Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def press(self, key: str, code: int, text: str = "") -> None:
        """Press and release a key."""
        for kind in ("keyDown", "keyUp"):
            self.ask("Input.dispatchKeyEvent", type=kind, key=key, code=key, text=text,
                     windowsVirtualKeyCode=code)  # fmt: skip

    def screenshot(self, path: Path, *, whole: bool = False) -> Path:
        """A picture of the window, or of the whole page."""
        shot = self.ask("Page.captureScreenshot", captureBeyondViewport=whole)
        path.write_bytes(b64decode(shot["data"]))
        return path


@contextmanager
def browsing(profile: Path) -> Iterator[Browser]:
    """A browser until the end of the block, with a profile of its own."""
    found = shutil.which("chromium")
    need(found, "chromium")
    to_read, to = os.pipe()
    of, of_write = os.pipe()
    # The browser reads commands from file 3 and answers on file 4.
    shell = f'exec "$0" "$@" 3<&{to_read} 4>&{of_write}'
    process = subprocess.Popen(
        ["bash", "-c", shell, str(found), "--headless", "--no-sandbox", "--disable-gpu",
         "--no-first-run", "--disable-background-networking", "--disable-component-update",
         "--disable-sync", "--hide-scrollbars", "--remote-debugging-pipe",
         f"--user-data-dir={profile}", "about:blank"],
        pass_fds=(to_read, of_write), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    os.close(to_read)
    os.close(of_write)
    try:
        browser = Browser(to, of)
        yield browser
        browser.ask("Browser.close")
        process.wait(timeout=20)
    finally:
        process.kill()
        process.wait()
        os.close(to)
        os.close(of)
