"""`touchline mark`: what the page sends is checked, saved as the calibrations read it, and served to nobody else."""

from __future__ import annotations

import http.client
import json
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from fakes import write_recording

from touchline.calibration.colour import read_regions
from touchline.calibration.lines.pixels_file import read_pixels
from touchline.calibration.marks import read_marks
from touchline.cli import main
from touchline.errors import InputError
from touchline.view.marking.clicks import files_of, read_clicks
from touchline.view.marking.server import MarkServer

FILE = "images/000000.png"
GOOD = {
    "points": [
        {"file": FILE, "name": "A", "u": 10.25, "v": 20.5, "x": 1.0, "y": -0.5},
        {"file": FILE, "name": "B", "u": 30.0, "v": 21.0, "x": None, "y": None},
    ],
    "regions": [{"file": FILE, "class": "green", "polygon": [[1, 2], [30, 2], [30, 40]]}],
    "lines": [{"file": FILE, "u": 5.5, "v": 6.25}, {"file": FILE, "u": 7, "v": 8}],
}


def sent(**changes: Any) -> bytes:
    return json.dumps({**GOOD, **changes}).encode()


def test_clicks_are_saved_as_the_calibrations_read_them(tmp_path: Path) -> None:
    for name, text in files_of(read_clicks(sent(), [FILE]), [FILE]).items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    marks = read_marks(tmp_path / "marks.csv")
    assert (marks.files, marks.names) == ((FILE, FILE), ("A", "B"))
    np.testing.assert_allclose(marks.pixels, [[10.25, 20.5], [30.0, 21.0]])
    np.testing.assert_allclose(marks.places_m[0], [1.0, -0.5])
    assert np.isnan(marks.places_m[1]).all()
    (region,) = read_regions(tmp_path / "regions.yaml")
    assert (region.file, region.kind, region.polygon.tolist()) == (FILE, "green", [[1, 2], [30, 2], [30, 40]])
    assert read_pixels(tmp_path / "pixels.csv").tolist() == [[5.5, 6.25], [7.0, 8.0]]


def test_lines_of_several_images_are_files_of_their_own() -> None:
    other = "images/000001.png"
    clicks = read_clicks(sent(lines=[{"file": other, "u": 1, "v": 2}, *GOOD["lines"]]), [FILE, other])
    assert {"pixels-000000.csv", "pixels-000001.csv"} < set(files_of(clicks, [FILE, other]))
    assert files_of(read_clicks(b"{}", [FILE]), [FILE]) == {}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (b"\xff", "expected JSON"),
        (b"[1]", "expected points, regions and lines"),
        (b"[" * 100_000, "expected JSON"),
        (sent(points=3), "points: expected a list"),
        (sent(points=[{}]), "points: a name has 1 to 60 letters"),
        (sent(points=[{**GOOD["points"][0], "name": "a,b"}]), "no commas"),
        (sent(points=[{**GOOD["points"][0], "name": "a\nb"}]), "no commas"),
        (sent(points=[{**GOOD["points"][0], "y": None}]), "A needs both x and y"),
        (sent(points=[{**GOOD["points"][0], "u": 1e9}]), "u is no number up to 20000"),
        (sent(points=[{**GOOD["points"][0], "u": True}]), "u is no number"),
        (sent(points=[GOOD["points"][0]] * 2), "A is marked twice"),
        (sent(points=[GOOD["points"][0]] * 10_001), "10001 are too many"),
        (sent(lines=[{"file": "/etc/passwd", "u": 1, "v": 1}]), "is none of the images"),
        (sent(lines=[{"file": FILE, "u": float("nan"), "v": 1}]), "u is no number"),
        (sent(regions=[{**GOOD["regions"][0], "class": "pink"}]), "a class is one of green"),
        (sent(regions=[{**GOOD["regions"][0], "polygon": [[1, 2]]}]), "at least three corners"),
        (sent(regions=[{**GOOD["regions"][0], "polygon": [1, 2, 3]}]), "a corner is"),
    ],
)
def test_what_no_page_would_send_is_refused(text: bytes, said: str) -> None:
    with pytest.raises(InputError, match=said):
        read_clicks(text, [FILE])


class Served:
    """A server in a thread, and what it answers."""

    def __init__(self) -> None:
        self.got: list[bytes] = []
        self.server = MarkServer({FILE: b"a picture"}, self.save)
        self.thread = threading.Thread(target=self.server.serve)
        self.thread.start()
        _, _, self.host, self.token, _ = self.server.url.split("/")

    def save(self, text: bytes) -> list[str]:
        read_clicks(text, [FILE])
        self.got.append(text)
        return ["marks.csv"]

    def ask(self, path: str, method: str = "GET", body: bytes | None = None, **headers: str) -> tuple[int, bytes]:
        connection = http.client.HTTPConnection(self.host, timeout=10)
        connection.request(method, path, body, headers)
        answer = connection.getresponse()
        return answer.status, answer.read()


@pytest.fixture
def served() -> Iterator[Served]:
    made = Served()
    yield made
    if made.thread.is_alive():
        made.server.stop()
    made.thread.join()


def test_the_page_and_its_images_are_served_until_the_marks_are_saved(served: Served) -> None:
    start = f"/{served.token}/"
    status, page = served.ask(start)
    assert status == 200
    assert FILE.encode() in page
    assert b"/*TOLD*/" not in page
    assert served.ask(start + "0") == (200, b"a picture")
    status, said = served.ask(start + "save", "POST", b"[]")
    assert (status, b"expected points" in said) == (400, True)
    assert served.ask(start + "save", "POST", sent()) == (200, b"marks.csv")
    served.thread.join(5.0)
    assert not served.thread.is_alive()
    assert served.server.saved == ["marks.csv"]
    assert served.got == [sent()]


def test_who_does_not_know_the_address_gets_nothing(served: Served) -> None:
    start = f"/{served.token}/"
    assert served.server.url.startswith("http://127.0.0.1:")
    for path in ("/", "/wrong/", start + "1", start + "../../etc/passwd", start + "9" * 50):
        assert served.ask(path)[0] == 404
    assert served.ask(start, Host="evil.example")[0] == 404
    assert served.ask(start + "save", "POST", b"", **{"Content-Length": "99999999"})[0] == 404
    for length in ("0" * 12, "0" * 5000, "-1", "1e3", "\u00b2"):
        assert served.ask(start + "save", "POST", b"", **{"Content-Length": length})[0] == 404
    for origin in ("http://evil.example", "null", "http://127.0.0.1.evil.example", "http://localhost@evil.example"):
        assert served.ask(start + "save", "POST", sent(), Origin=origin)[0] == 404
    assert served.ask(start, "POST", sent())[0] == 404
    assert served.got == []


def test_the_command_writes_into_the_recording_and_overwrites_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = write_recording(tmp_path / "walk", 2)
    answers: list[Any] = []

    def serve(self: MarkServer) -> list[str]:
        save = monkey["save"]
        try:
            return list(save(sent()))
        except InputError as error:
            answers.append(str(error))
            return []

    monkey: dict[str, Any] = {}
    before = MarkServer.__init__

    def init(self: MarkServer, images: Any, save: Any, port: int = 0) -> None:
        monkey["save"] = save
        assert cv2.imdecode(np.frombuffer(images[FILE], np.uint8), cv2.IMREAD_COLOR).shape == (96, 96, 3)
        before(self, images, save, port)
        self._server.server_close()

    monkeypatch.setattr(MarkServer, "__init__", init)
    monkeypatch.setattr(MarkServer, "serve", serve)
    assert main(["mark", str(recording / FILE), "--no-browser"]) == 0
    assert f"written: {recording / 'marks.csv'}" in capsys.readouterr().out
    written = {name: (recording / name).read_text() for name in ("marks.csv", "regions.yaml", "pixels.csv")}
    (recording / "regions.yaml").unlink()
    assert main(["mark", str(recording / FILE), "--no-browser"]) == 0
    assert "marks.csv: exists already" in answers[0]
    assert not (recording / "regions.yaml").exists()
    assert (recording / "marks.csv").read_text() == written["marks.csv"]
    assert main(["mark", str(tmp_path / "no.png"), "--no-browser"]) == 2
    assert main(["mark", str(recording / "images.csv"), "--no-browser"]) == 2
