"""The local page on which images are marked: on the loopback alone, under an address that nobody can guess."""

import json
import secrets
from collections.abc import Callable, Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from touchline.errors import TouchlineError
from touchline.files.opened import read_text
from touchline.perception.marked_colours import CLASSES

_PAGE = Path(__file__).parent / "page.html"
_MAX_BYTES = 4_000_000
_LOOPBACK = "127.0.0.1"
_SILENCE_S = 10.0

Save = Callable[[bytes], list[str]]
"""Takes what the page sends and returns the names of the files that it is in; a TouchlineError says what is wrong."""


class MarkServer:
    """Serves the images (file name -> PNG file) until the marks are saved.

    Whoever does not know the address, which is new each time, gets nothing; other hosts' names for this machine are
    refused, too.
    """

    def __init__(self, images: Mapping[str, bytes], save: Save, port: int = 0, page: str | None = None) -> None:
        names = list(images)
        listed = json.dumps({"files": names, "classes": CLASSES}).replace("</", "<\\/")
        text = (read_text(_PAGE, _MAX_BYTES) if page is None else page).replace("/*TOLD*/", listed)
        self._token = secrets.token_urlsafe(16)
        self._server = ThreadingHTTPServer((_LOOPBACK, port), self._handler(text, list(images.values()), save))
        self._server.daemon_threads = True
        self.saved: list[str] = []

    @property
    def url(self) -> str:
        """The address of the page."""
        return f"http://{_LOOPBACK}:{self._server.server_address[1]}/{self._token}/"

    def serve(self) -> list[str]:
        """Until the marks are saved; returns the files that hold them."""
        try:
            self._server.serve_forever(poll_interval=0.1)
        finally:
            self._server.server_close()
        return self.saved

    def stop(self) -> None:
        """End `serve`, from another thread."""
        self._server.shutdown()

    def _handler(self, text: str, pictures: list[bytes], save: Save) -> type[BaseHTTPRequestHandler]:
        outer = self

        class Handler(BaseHTTPRequestHandler):
            timeout = _SILENCE_S

            def do_GET(self) -> None:
                asked = self._asked()
                if asked == "":
                    self._answer(200, "text/html; charset=utf-8", text.encode())
                elif asked is not None and asked.isdecimal() and int(asked[:6]) < len(pictures):
                    self._answer(200, "image/png", pictures[int(asked[:6])])
                else:
                    self._answer(404, "text/plain", b"not here")

            def do_POST(self) -> None:
                length = self.headers.get("Content-Length", "")
                counts = length.isdecimal() and len(length) <= len(str(_MAX_BYTES)) and int(length) <= _MAX_BYTES
                if self._asked() != "save" or not counts or self._is_foreign():
                    self._answer(404, "text/plain", b"not here")
                    return
                try:
                    outer.saved = save(self.rfile.read(int(length)))
                except TouchlineError as error:
                    self._answer(400, "text/plain; charset=utf-8", str(error).encode(errors="replace"))
                    return
                self._answer(200, "text/plain; charset=utf-8", ", ".join(outer.saved).encode(errors="replace"))
                outer.stop()

            def _is_foreign(self) -> bool:
                """Whether another page sends it."""
                origin = self.headers.get("Origin")
                return origin is not None and origin.split("/")[-1].partition(":")[0] not in (_LOOPBACK, "localhost")

            def _asked(self) -> str | None:
                """What of the page is asked for; None for whoever does not know its address."""
                host = self.headers.get("Host", "").partition(":")[0]
                start = f"/{outer._token}/"
                known = host in (_LOOPBACK, "localhost") and self.path.startswith(start)
                return self.path.removeprefix(start) if known else None

            def _answer(self, status: int, kind: str, data: bytes) -> None:
                self.send_response(status)
                for name, value in (("Content-Type", kind), ("Content-Length", str(len(data)))):
                    self.send_header(name, value)
                self.send_header("Cache-Control", "no-store")
                self.send_header("Content-Security-Policy", "default-src 'self' data: 'unsafe-inline'")
                self.end_headers()
                self.wfile.write(data)

            def log_message(self, format: str, *args: Any) -> None:
                """Nothing: the terminal is the command's."""

        return Handler
