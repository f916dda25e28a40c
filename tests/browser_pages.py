"""The pages of runs in a real browser, clicked through at 1280 and 500 px: `make browser`, which needs Chromium."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from fakes import FakeSource, FakeSystem, WatchedSystem, true_samples, write_recording
from test_compare import Shifted, made

from touchline.evaluation.compare import compare, comparison_page
from touchline.evaluation.estimates import read_estimates
from touchline.evaluation.report import write_report
from touchline.evaluation.run_data import RunData
from touchline.evaluation.run_folder import RunFolder
from touchline.evaluation.runner import Thumbnail, run_frames
from touchline.evaluation.summary import RunSummary
from touchline.field import open_field

COUNT = 200
NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
BEFORE = "<script>window.faults = []; addEventListener('error', e => faults.push(e.message));</script>"
AFTER = """<script>
const id = name => document.getElementById(name), wait = ms => new Promise(done => setTimeout(done, ms));
const row = () => Number(id("time").value), over = () => document.querySelectorAll(".u-over")[1];
function mouse(kind, element, x, y) {
  element.dispatchEvent(new MouseEvent(kind, { bubbles: true, clientX: x, clientY: y, movementX: 2, view: window }));
}
async function hover(share) {
  over().scrollIntoView({ block: "center" });
  await wait(50);
  const box = over().getBoundingClientRect();
  mouse("mouseenter", over(), box.left + 1, box.top + 9);
  for (const d of [2, 0]) mouse("mousemove", over(), box.left + share * box.width + d, box.top + 10);
  await wait(50);
  return row();
}
(async () => {
  await wait(300);
  const told = { begin: row() };
  id("time").value = 150; id("time").dispatchEvent(new Event("input"));
  await wait(50);
  told.said = id("said").textContent; told.marker = id("at-0").getAttribute("transform");
  told.legend = document.querySelectorAll(".u-legend")[1].textContent;
  if (id("frame")) { told.frame = Number(id("frame").dataset.row); told.width = id("frame").naturalWidth; }
  told.hover = [await hover(0.25), await hover(0.75)];
  id("zoom-in").click(); await wait(100);
  told.zoomed = [await hover(0.25), await hover(0.75)];
  id("zoom-all").click(); await wait(100);
  told.all = [await hover(0.25), await hover(0.75)];
  const box = over().getBoundingClientRect(), at = share => box.left + share * box.width;
  mouse("mousedown", over(), at(0.5), box.top + 20);
  for (const share of [0.55, 0.7]) mouse("mousemove", over(), at(share), box.top + 20);
  mouse("mouseup", document, at(0.7), box.top + 20); await wait(100);
  told.dragged = [await hover(0.05), await hover(0.95)];
  mouse("dblclick", over(), at(0.5), box.top + 20); await wait(100);
  told.again = [await hover(0.25), await hover(0.75)];
  id("path").scrollIntoView({ block: "center" }); await wait(50);
  const data = JSON.parse(id("data").textContent), run = data.runs[0];
  const spot = new DOMPoint(run.x[40], run.y[40]).matrixTransform(id("metres").getScreenCTM());
  mouse("mousemove", id("path"), spot.x, spot.y); await wait(50);
  told.path = row();
  const boxes = ["play", "path"].map(name => id(name).getBoundingClientRect());
  told.beside = boxes.map(box => box.top >= 0 && box.bottom <= innerHeight);
  id("play").click(); await wait(1000); id("play").click();
  told.played = row();
  const stopped = row(); await wait(300);
  told.stays = row() === stopped;
  told.overflow = document.documentElement.scrollWidth - innerWidth;
  const texts = [...document.querySelectorAll("figure svg text")];
  told.smallest = Math.min(...texts.map(t => t.getBoundingClientRect().height));
  told.charts = document.querySelectorAll("#charts canvas").length; told.faults = faults;
  told.histograms = document.querySelectorAll("#histogram canvas").length;
  document.body.dataset.told = JSON.stringify(told);
})();
</script>"""


def chromium() -> str:
    for name in NAMES:
        if found := shutil.which(name):
            return found
    pytest.fail("no Chromium is found; install one, for example: apt-get install chromium")


def clicked_through(page: str, folder: Path, width: int) -> dict[str, Any]:
    """What the page showed when it was clicked through in a window of that width."""
    path = folder / "page.html"
    path.write_text(page.replace("<head>", "<head>" + BEFORE, 1).replace("</body>", AFTER + "</body>"))
    return seen_in_browser(path.as_uri(), folder, width)


def seen_in_browser(address: str, folder: Path, width: int) -> dict[str, Any]:
    """What the script of a page told in the end."""
    command = [
        chromium(), "--headless", "--no-sandbox", "--disable-gpu", f"--window-size={width},900",
        f"--user-data-dir={folder / 'profile'}", "--virtual-time-budget=15000", "--dump-dom", address,
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    (told,) = re.findall(r'data-told="(.*?)"', done.stdout) or pytest.fail(done.stdout[-2000:])
    return dict(json.loads(html.unescape(told)))


def check(told: dict[str, Any]) -> None:
    """What holds of every page of COUNT images at 10 Hz."""
    assert told["faults"] == []
    assert told["said"].startswith("15.00 s")
    assert told["marker"].startswith("translate(5.")
    assert "15.00 s" in told["legend"]
    assert told["hover"] == pytest.approx([COUNT / 4, 3 * COUNT / 4], abs=3)
    assert told["zoomed"][1] - told["zoomed"][0] == pytest.approx(COUNT / 4, abs=4)
    assert told["all"] == pytest.approx(told["hover"], abs=2)
    assert told["dragged"] == pytest.approx([0.51 * COUNT, 0.69 * COUNT], abs=4)
    assert told["again"] == pytest.approx(told["hover"], abs=2)
    assert told["path"] == pytest.approx(40, abs=1)
    assert told["played"] - told["path"] == pytest.approx(10, abs=3)
    assert told["stays"]
    assert told["beside"] == [True, True]  # what plays is beside what it moves
    assert told["overflow"] <= 0
    assert told["smallest"] >= 9.0


@pytest.mark.parametrize("width", [1280, 500])
def test_the_report_of_a_run(width: int, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    with RunFolder(folder) as writer:
        source = FakeSource(COUNT, black=(60, 61))
        tally = run_frames(source, WatchedSystem(np.random.default_rng(0)), writer)
    table, truth = read_estimates(folder / "estimates.csv"), true_samples(COUNT)
    data = RunData(table, open_field("msl-18x12"), truth, tally.black_ns, [{"t": 6.2, "kind": "kidnap"}],
                   tally.summary().said)  # fmt: skip
    jpeg = cv2.imencode(".jpg", np.full((240, 320, 3), 90, np.uint8))[1].tobytes()
    small = [Thumbnail(int(table.trajectory.stamp_ns[row]), jpeg) for row in range(0, COUNT, 4)]
    told = {
        "recording": {"name": "walk", "field": "msl-18x12"}, "system": "fake", "started": "2026-01-02T03:04:05",
        "settings": {}, "learns_colours": False, "seed": 0, "versions": {}, "cpu": "one", "why_no_errors": "not asked",
        "problems": {"counts": {}, "messages": []}, "prior": {"pose": None, "own_half": False},
    }  # fmt: skip
    summary = RunSummary(**told).updated(tally.summary())
    page = write_report(folder, summary, data, None, (), small).read_text(encoding="utf-8")
    told = clicked_through(page, tmp_path, width)
    check(told)
    assert told["begin"] == 1  # the first located
    assert told["frame"] in (148, 152)
    assert told["width"] == 320
    assert (told["charts"], told["histograms"]) == (9, 1)


@pytest.mark.parametrize("width", [1280, 500])
def test_the_page_of_runs_side_by_side(width: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("test_compare.COUNT", COUNT)
    recording = write_recording(tmp_path / "walk", COUNT)
    systems = [kind(np.random.default_rng(0), searching=()) for kind in (FakeSystem, Shifted)]
    runs = [made(tmp_path / name, recording, system) for name, system in zip("ab", systems, strict=True)]
    told = clicked_through(comparison_page(compare(runs)), tmp_path, width)
    check(told)
    assert told["charts"] == 4
