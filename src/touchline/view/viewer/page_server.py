"""The viewer's page for a browser, without what its own would ask other machines for: fonts, scripts, statistics."""

import re
import threading
from http.client import HTTPConnection, HTTPException
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

_LOOPBACK = "127.0.0.1"
_FILES = ("", "re_viewer.js", "re_viewer_bg.wasm", "favicon.ico", "favicon.svg", "apple-touch-icon.png")
_KEPT_HEADERS = ("Content-Type", "rerun-final-length")
_SILENCE_S = 30.0
_PIECE = 1 << 20
_ELSEWHERE = re.compile(rb'<link[^>]*"https?://[^>]*>', re.DOTALL)


class PageServer:
    """Serves, on the loopback alone, what the viewer's own server on `viewer_port` has.

    query: what the address ends with. data_port: where the page gets its data; it may ask for nothing else.
    """

    def __init__(self, viewer_port: int, query: str, data_port: int) -> None:
        self._server = ThreadingHTTPServer((_LOOPBACK, 0), _handler(viewer_port, data_port))
        self._server.daemon_threads = True
        self.url = f"http://{_LOOPBACK}:{self._server.server_address[1]}/{query}"
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.1,), daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """No page any more."""
        self._server.shutdown()
        self._server.server_close()


def _handler(viewer_port: int, data_port: int) -> type[BaseHTTPRequestHandler]:
    policy = (
        "default-src 'self' data: blob: 'unsafe-inline' 'unsafe-eval'; "
        f"connect-src 'self' data: blob: http://{_LOOPBACK}:{data_port}"
    )

    class Handler(BaseHTTPRequestHandler):
        timeout = _SILENCE_S

        def do_GET(self) -> None:
            name = self.path.partition("?")[0].removeprefix("/")
            host = self.headers.get("Host", "").partition(":")[0]
            if name not in _FILES or host not in (_LOOPBACK, "localhost"):
                self.send_error(404)
                return
            try:
                self._hand_on(name)
            except (OSError, HTTPException):  # the browser or the viewer has gone
                self.close_connection = True

        def _hand_on(self, name: str) -> None:
            asked = HTTPConnection(_LOOPBACK, viewer_port, timeout=_SILENCE_S)
            asked.request("GET", f"/{name}")
            answer = asked.getresponse()
            self.send_response(answer.status)
            for header in _KEPT_HEADERS:
                if (value := answer.getheader(header)) is not None:
                    self.send_header(header, value)
            self.send_header("Content-Security-Policy", policy)
            self.end_headers()
            if name == "":
                self.wfile.write(_ELSEWHERE.sub(b"", answer.read()))
            while piece := answer.read(_PIECE):
                self.wfile.write(piece)
            asked.close()

        def log_message(self, format: str, *args: Any) -> None:
            """Nothing: the terminal is the command's."""

    return Handler
