"""A headless Chromium that is driven while its page goes on: what a page draws on a canvas can only be looked at."""

from __future__ import annotations

import base64
import fcntl
import json
import os
import select
import shlex
import subprocess
from pathlib import Path
from typing import Any

_ANSWERS_S = 60.0


class Page:
    """A page in a window of a size, by Chrome's DevTools protocol over a pipe (NUL ends a message)."""

    def __init__(self, program: str, address: str, profile: Path, width: int, height: int) -> None:
        to_browser, self._to = map(_beyond_ten, os.pipe())  # 3 and 4 are the browser's own names of them
        self._from, from_browser = map(_beyond_ten, os.pipe())
        command = [
            program, "--headless", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader",
            "--enable-unsafe-swiftshader", f"--window-size={width},{height}", f"--user-data-dir={profile}",
            "--remote-debugging-pipe", "about:blank",
        ]  # fmt: skip
        pipes = f"exec {shlex.join(command)} 3<&{to_browser} 4>&{from_browser}"
        self._process = subprocess.Popen(
            ["bash", "-c", pipes], pass_fds=(to_browser, from_browser), stderr=subprocess.DEVNULL
        )
        os.close(to_browser)
        os.close(from_browser)
        self._left, self._number, self._session = b"", 0, ""
        self._requests: dict[str, str] = {}
        self.said: list[str] = []
        """What the page wrote on its console."""
        targets = self._ask("Target.getTargets")["targetInfos"]
        target = next(one["targetId"] for one in targets if one["type"] == "page")
        self._session = self._ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Network", "Runtime"):
            self._ask(f"{domain}.enable")
        self._ask("Page.navigate", url=address)

    @property
    def asked(self) -> list[str]:
        """Addresses that the page asked for."""
        return list(self._requests.values())

    def picture(self) -> bytes:
        """What the window shows, a PNG file."""
        return base64.b64decode(self._ask("Page.captureScreenshot")["data"])

    def close(self) -> None:
        """End the browser."""
        self._process.kill()
        self._process.wait()
        os.close(self._to)
        os.close(self._from)

    def _ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self._number:
                assert "result" in answer, answer
                return dict(answer["result"])
            self._note(answer)

    def _note(self, event: dict[str, Any]) -> None:
        if event.get("method") == "Network.requestWillBeSent":
            self._requests[event["params"]["requestId"]] = event["params"]["request"]["url"]
        if event.get("method") == "Network.loadingFailed" and event["params"].get("blockedReason") == "csp":
            self._requests.pop(event["params"]["requestId"], None)  # the page's own policy kept it from being sent
        if event.get("method") == "Runtime.consoleAPICalled":
            self.said += [str(one.get("value", one.get("description"))) for one in event["params"]["args"]]

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self._left:
            ready, _, _ = select.select([self._from], [], [], _ANSWERS_S)
            assert ready, "the browser does not answer"
            piece = os.read(self._from, 1 << 16)
            assert piece, "the browser has gone"
            self._left += piece
        first, _, self._left = self._left.partition(b"\0")
        return dict(json.loads(first))


def _beyond_ten(pipe: int) -> int:
    """The same end of a pipe under a number above ten."""
    other = fcntl.fcntl(pipe, fcntl.F_DUPFD_CLOEXEC, 10)
    os.close(pipe)
    return other
