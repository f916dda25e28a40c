"""`run --view web` in a real browser: the run is drawn, and the page asks nobody but this machine: `make browser`."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
from browser_pages import chromium
from devtools import Page

RECORDING = Path(__file__).parents[1] / "examples" / "omni_msl_track_short"
CARPET_RGB, FIELD_LINES_RGB = (169, 207, 164), (255, 90, 235)
DRAWN_S = 120.0


def share_of(picture: bytes, color: tuple[int, int, int]) -> float:
    """Share of the pixels of a PNG file that have a colour (red, green, blue), as good as."""
    pixels = cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_COLOR).astype(int)
    return float((np.abs(pixels - np.array(color[::-1])).max(axis=2) < 12).mean())


def address(process: subprocess.Popen[str]) -> str:
    """Where the command says that the viewer is."""
    assert process.stderr is not None
    for line in process.stderr:
        if found := re.search(r"http://127\.0\.0\.1:\S+", line):
            return found[0]
    raise AssertionError("no address was told")


def test_a_run_is_drawn_in_a_browser_and_nothing_leaves_the_machine(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "touchline", "run", str(RECORDING), "--view", "web"]
    with subprocess.Popen(
        [*command, "-o", str(tmp_path / "run"), "--system", "touchline"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        page = None
        try:
            page = Page(chromium(), address(process), tmp_path / "profile", 1280, 900)
            ends_s, drawn = time.monotonic() + DRAWN_S, False
            while not drawn:
                assert time.monotonic() < ends_s, page.said[-5:]
                time.sleep(1.0)
                picture = page.picture()
                drawn = share_of(picture, CARPET_RGB) > 0.1 and share_of(picture, FIELD_LINES_RGB) > 2e-4
            (tmp_path / "viewer.png").write_bytes(picture)
            assert {one.partition("//")[2].partition(":")[0] for one in page.asked if one.startswith("http")} == {
                "127.0.0.1"
            }
        finally:
            if page is not None:
                page.close()
            process.send_signal(signal.SIGINT)
            said, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    assert "tracking 54, searching 6" in said  # until the motion has confirmed the pose
