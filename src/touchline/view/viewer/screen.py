"""Where a run is shown: in a file, in a window, in a browser. Nothing of it leaves this machine."""

import importlib.util
import os
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from touchline.errors import InputError, TouchlineError
from touchline.files.new import check_new_file
from touchline.view.viewer.library import rerun_library
from touchline.view.viewer.page_server import PageServer

WINDOW, WEB = "window", "web"
ENDING = ".rrd"
_APPLICATION = "touchline"
_LOOPBACK = "127.0.0.1"
_STARTS_S, _LOOK_AGAIN_S = 20.0, 0.05
_QUIET = {"CI": "true"}  # in which Rerun neither asks nor tells anybody how it is used


class Screen:
    """A Rerun stream and what shows it. url: the page in a browser; None where it is a window or a file."""

    def __init__(self, stream: Any, process: subprocess.Popen[bytes] | None = None, page: PageServer | None = None):
        self.stream, self._process, self._page = stream, process, page

    @property
    def url(self) -> str | None:
        """The address of the page, on this machine alone."""
        return None if self._page is None else self._page.url

    def finish(self) -> None:
        """All has been shown: it is on the disk, or with the viewer. A window stays open, a page is served on."""
        self.stream.flush()
        self.stream.disconnect()

    def close(self) -> None:
        """End the page in the browser; a window is the user's."""
        if self._page is not None:
            self._page.stop()
            if self._process is not None:
                self._process.terminate()
                self._process.wait()


def open_screen(view: str | None, file: Path | None = None) -> Screen:
    """A new file (FILE.rrd), a window (`window`) or a page for a browser (`web`).

    Raises InputError where Rerun is not installed, for another kind of view and for a file that cannot be written;
    TouchlineError if the viewer does not start.
    """
    if view not in (None, WINDOW, WEB):
        raise InputError(f"--view {view}: expected web, for a browser, or nothing, for a window")
    if (view is None) == (file is None):
        raise InputError("--view and --rrd exclude each other: a window or page, or a file for later")
    if file is not None:
        check_new_file(file, (ENDING,), "what the viewer shows")
    stream = rerun_library().RecordingStream(_APPLICATION)
    if file is not None:
        return _file_screen(stream, file)
    port = _free_port()
    if view == WINDOW:
        process = _start(["--port", str(port), "--hide-welcome-screen", "--expect-data-soon"], port)
        page = None
    else:
        page_port = _free_port()
        process = _start(["--serve-web", "--port", str(port), "--web-viewer-port", str(page_port)], port)
        page = PageServer(
            page_port, f"?url=rerun%2Bhttp%3A%2F%2F{_LOOPBACK}%3A{port}%2Fproxy&hide_welcome_screen=1", port
        )
    stream.connect_grpc(f"rerun+http://{_LOOPBACK}:{port}/proxy")
    return Screen(stream, process, page)


def _file_screen(stream: Any, file: Path) -> Screen:
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.open("xb").close()
        stream.save(file)
    except OSError as error:
        raise InputError(f"{file}: cannot be written ({error.strerror})") from None
    return Screen(stream)


def _free_port() -> int:
    with socket.socket() as one:
        one.bind((_LOOPBACK, 0))
        return int(one.getsockname()[1])


def _start(options: list[str], port: int) -> subprocess.Popen[bytes]:
    """The viewer's own program, once it listens to the port. Raises TouchlineError if it ends before."""
    found = importlib.util.find_spec("rerun_cli")
    if found is None or found.origin is None:
        raise InputError("Rerun is installed without its viewer: pip install 'touchline[view]'")
    program = Path(found.origin).with_name("rerun.exe" if sys.platform == "win32" else "rerun")
    nowhere = subprocess.DEVNULL
    process = subprocess.Popen(
        [str(program), "--bind", _LOOPBACK, *options],
        stdin=nowhere,
        stdout=nowhere,
        stderr=nowhere,
        env={**os.environ, **_QUIET},
        start_new_session=True,  # a Ctrl-C ends the run, not the window
    )
    ends_s = time.monotonic() + _STARTS_S
    while time.monotonic() < ends_s and process.poll() is None:
        if _listens(port):
            return process
        time.sleep(_LOOK_AGAIN_S)
    process.kill()
    raise TouchlineError(
        "the viewer did not start: is there a screen? --view web shows the run in a browser, --rrd FILE keeps it"
    )


def _listens(port: int) -> bool:
    try:
        socket.create_connection((_LOOPBACK, port), timeout=1.0).close()
    except OSError:
        return False
    return True
