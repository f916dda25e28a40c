"""report.html: one page that needs nothing but itself, and shows everything."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fakes import STEP_NS, FakeSource, FakeSystem, WatchedSystem, true_samples
from syrupy.assertion import SnapshotAssertion

from touchline import palette
from touchline.evaluation.estimates import EstimateTable, read_estimates
from touchline.evaluation.metrics import ErrorTable, error_table
from touchline.evaluation.report import Picture, write_report
from touchline.evaluation.run_data import RunData
from touchline.evaluation.run_folder import RunFolder
from touchline.evaluation.runner import Thumbnail, run_frames
from touchline.evaluation.summary import Durations, Latency, RunSummary, SaidPhrase
from touchline.evaluation.timeline import (
    MAX_ROWS,
    dot_colors,
    error_charts,
    latency_tree,
    page_data,
    run_tree,
    shown_rows,
)
from touchline.field import open_field
from touchline.types import Samples, Status

VOID = {"meta", "img", "br", "hr", "link", "input"}


class Page(HTMLParser):
    """Collects what a page refers to, and checks that its elements are closed in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.references: list[str] = []
        self.text: list[str] = []
        self.ids: list[str] = []
        self.tags: list[str] = []
        self._open: list[str] = []
        self.feed(text)
        assert not self._open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.references += [value or "" for name, value in attrs if name in ("src", "href", "xlink:href", "action")]
        self.ids += [value or "" for name, value in attrs if name == "id"]
        if tag not in VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self._open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self._open and self._open[-1] not in ("script", "style", "title") and data.strip():
            self.text.append(f"{self._open[-1]}: {' '.join(data.split())}")


def write(
    folder: Path,
    frames: int = 30,
    truth: bool = True,
    searching: int = 1,
    system: FakeSystem | None = None,
    data: RunData | None = None,
    **changes: Any,
) -> tuple[str, ErrorTable | None]:
    folder.mkdir(exist_ok=True)
    system = system or FakeSystem(np.random.default_rng(0), searching=tuple(range(searching)))
    with RunFolder(folder) as writer:
        tally = run_frames(FakeSource(frames, black=(9, 10)), system, writer)
    table = read_estimates(folder / "estimates.csv")
    known = true_samples(frames) if truth and frames else None
    located = table.has_status(Status.TRACKING)
    errors = None
    if known is not None and searching < frames:
        watched = {"black_ns": tally.black_ns, "protection": table.protection}
        errors = error_table(table.trajectory, known, located=located, **watched)
    told = {
        "recording": {"name": "walk <1>", "field": "msl-18x12", "description": "Black & white"},
        "system": "fake",
        "started": "2026-01-02T03:04:05+00:00",
        "prior": {"pose": None, "own_half": False},
        "settings": {"matching": {"c_m": 0.25}},
        "learns_colours": True,
        "seed": 5,
        "versions": {"touchline": "0.1.0"},
        "cpu": "a processor",
        "why_no_errors": "the recording holds no truth to compare with",
        "problems": {"counts": {"sensor gap": 2}, "messages": ["imu.csv, line 7: a gap", "imu.csv, line 9: <gap>"]},
        **changes,
    }
    summary = RunSummary(**{**dict(tally.summary()), **told})
    data = data or RunData(table, open_field("msl-18x12"), known, tally.black_ns, said=tally.summary().said)
    pictures = [Picture("Image 3 at 0.30 s", "tracking", np.full((40, 60, 3), 90, dtype=np.uint8))]
    small = [Thumbnail(STEP_NS * index, b"jpeg") for index in range(0, frames, 10)]
    path = write_report(folder, summary, data, errors, pictures if frames else (), small)
    return path.read_text(encoding="utf-8"), errors


def page_data_of(page: str) -> dict[str, Any]:
    """What the page's script reads."""
    (text,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    return dict(json.loads(text))


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    return write(tmp_path_factory.mktemp("report"))[0]


def test_it_needs_nothing_from_elsewhere(page: str) -> None:
    parsed = Page(page)
    assert parsed.references
    for reference in parsed.references:
        assert reference.startswith(("#", "data:image/jpeg;base64,"))
    assert set(re.findall(r"https?://[^ \"']*", page)) == {"https://github.com/leeoniya/uPlot"}  # whose the curves are
    assert not re.search(r"fetch\(|XMLHttpRequest|WebSocket|sendBeacon|import\(|serviceWorker", page)
    assert "@import" not in page
    assert set(re.findall(r"url\((.)", page)) <= {"#"}
    assert not {"link", "iframe", "object"} & set(parsed.tags)
    assert not re.search(r"<script[^>]* src", page)


def unsure(found: float | None, **changes: Any) -> dict[str, Any]:
    return {"either_side": {"count": 7, "other_pose": [1.0, -2.0, np.pi / 2], "probability": found}, **changes}


CASES: dict[str, dict[str, Any]] = {
    "usual": {},
    "no truth": {"truth": False, "learns_colours": False},
    "no frames": {"frames": 0},
    "one frame": {"frames": 1, "truth": False},
    "interrupted": {"ended": "interrupted"},
    "failed": {"ended": "failed", "failure": "Why"},
    "either end": unsure(None),
    "an end that nothing confirms": unsure(
        0.047, prior={"pose": None, "own_half": True}, said=[SaidPhrase(t=1.0, until=1.0, code="it-is", what="so")]
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_what_a_page_says(tmp_path: Path, snapshot: SnapshotAssertion, case: str) -> None:
    """All of the usual page, of others what that does not say."""
    page = Page(write(tmp_path / "case", **{"rate_fps": 100.0, **CASES[case]})[0])
    usual = [] if case == "usual" else Page(write(tmp_path / "usual", rate_fps=100.0)[0]).text
    assert "\n".join(line for line in page.text if line not in usual) == snapshot
    assert len(page.ids) == len(set(page.ids))


def test_every_colour_of_the_page_is_defined_by_day_and_night(page: str) -> None:
    style, body = page.split("</style>", 1)
    day, night = style.split("prefers-color-scheme: dark")
    used = set(re.findall(r"var\(--([a-z-]+)\)|(?:css|bar)\(\"([a-z]+)\"\)", body))
    used = {first or second for first, second in used} | {"searching", "lost"}
    used |= {series["color"] for chart in page_data_of(page)["charts"] for series in chart["series"]}
    for variable in used:
        assert f"--{variable}:" in day
        assert f"--{variable}:" in night
    assert f"--tracking:{palette.BLUE}" in day


def test_protection_levels_statistics_and_named_faults_are_drawn(tmp_path: Path, page: str) -> None:
    shown, errors = write(tmp_path, system=WatchedSystem(np.random.default_rng(0)))
    assert errors is not None
    assert errors.protection_position is not None
    assert f"misleading: {errors.protection_position.misleading} of 18 images in position" in shown
    data = page_data_of(shown)
    charts = {chart["title"].partition(" (")[0]: chart for chart in data["charts"]}
    level = charts["Protection level of the position"]
    assert [one["label"] for one in level["series"]] == ["error", "protection level"]
    assert [level["series"][1]["values"][k] for k in (5, 15, 25)] == [6, None, 6]
    assert level["series"][0]["values"][5] == pytest.approx(2.0, abs=2.0)
    assert level["range"] == [0.0, pytest.approx(6.3, abs=4.0)]
    statistics = charts["Consistency"]
    assert [one["label"] for one in statistics["series"]] == ["alarm", "motion", "share"]
    assert [statistics["series"][1]["values"][k] for k in (5, 15)] == [0.3, 1.5]
    (fault,) = [event for event in data["events"] if event.get("color") == "searching"]
    assert (fault["t"], fault["until"], fault["label"]) == (1.0, 1.9, "odometry turns the wrong way")
    run = data["runs"][0]
    assert [run["reasons"][run["reason"][k]] for k in (5, 15)] == ["", "odometry contradicts the images"]
    assert "1.00 to 1.90 s (10 images): odometry turns the wrong way <code>odometry-turn-sign</code>" in shown
    assert "Consistency" not in page, "a system without a monitor has none"


def run_data(frames: int, searching: int, black_ns: list[tuple[int, int]]) -> RunData:
    """Estimates that are off by as many metres as their row; the first `searching` are not located."""
    truth = true_samples(frames)
    status = np.array([list(Status).index(Status.SEARCHING)] * searching + [0] * (frames - searching), dtype=np.int8)
    floats, counts = np.ones(frames, dtype=np.float32), np.ones(frames, dtype=np.int32)
    moved = Samples(truth.stamp_ns, truth.values + np.arange(frames)[:, np.newaxis] * [1.0, 0.0, 0.0])
    modes = np.full(frames, -1, dtype=np.int8)
    covariance = np.ones((frames, 6), np.float32)
    numbers = (moved, covariance, status, floats, counts, floats, floats, modes, *[floats] * 5)
    table = EstimateTable(*numbers, {}, np.zeros(frames, dtype=np.int32), ("",))
    return RunData(table, open_field("msl-18x12"), truth, black_ns)


def test_curves_start_where_the_robot_was_first_located() -> None:
    data = run_data(20, 5, [])
    errors = data.errors_since_located()
    assert errors is not None
    assert errors.rows.tolist() == list(range(5, 20))
    np.testing.assert_allclose(errors.values[:, 0], np.arange(5.0, 20.0))
    assert run_data(20, 20, []).errors_since_located() is None
    assert dot_colors(data).tolist() == [None] * 5 + ["tracking"] * 15


def test_black_stretches_are_shaded_and_their_errors_left_out() -> None:
    plain, shaded = (tree_of(run_data(30, 0, black)) for black in ([], [(10 * STEP_NS, 14 * STEP_NS)]))
    assert [event["label"] for event in plain["events"]] == []
    assert shaded["events"] == [{"t": 1.0, "until": 1.4, "label": "black"}]
    values = [tree["charts"][0]["series"][0]["values"] for tree in (plain, shaded)]
    assert [sum(value is None for value in one) for one in values] == [0, 5]


def tree_of(data: RunData) -> dict[str, Any]:
    rows = shown_rows(data)
    return dict(json.loads(page_data(data, error_charts(data, rows), [run_tree("estimate", data, rows)], rows)))


def kidnapped(right_from: int = 12) -> RunData:
    """40 frames; at the 10th the robot is carried 4 m, and right again from one on; lost in the two before that."""
    truth = true_samples(40)
    truth.values[10:, 0] += 4.0
    poses = truth.values.copy()
    poses[10:right_from, 0] -= 4.0
    status = np.zeros(40, dtype=np.int8)
    status[right_from - 2 : right_from] = list(Status).index(Status.LOST)
    data = run_data(40, 0, [])
    table = replace(data.table, trajectory=Samples(truth.stamp_ns, poses), status=status)
    return RunData(table, data.field, truth)


def test_a_kidnap_is_seen_in_the_truth_and_its_recovery_is_told(tmp_path: Path) -> None:
    data = kidnapped(14)
    assert data.kidnaps_s() == [1.0]
    assert data.recoveries_s() == [pytest.approx(0.4)]
    wrong = data.wrong_while_tracking()
    assert wrong is not None
    assert (wrong.frames, wrong.seconds) == (2, pytest.approx(0.2))
    assert kidnapped(40).recoveries_s() == [None]
    page, _ = write(tmp_path, data=data)
    for tile in ("right again after a kidnap</dt><dd>1 of 1", "recovery time, median</dt><dd>0.40", "<dd>0.20<span> s"):
        assert tile in page
    assert page_data_of(page)["gaps"] == [10]
    assert {"t": 1.0, "label": "kidnap"} in page_data_of(page)["events"]


def test_events_that_the_recording_tells_are_marked_from_the_first_frame_on() -> None:
    late = replace(run_data(20, 0, []).table, trajectory=Samples(true_samples(20).stamp_ns + 10**10, np.zeros((20, 3))))
    told = [{"t": 10.5, "kind": "kidnap"}, {"t": 11.0, "kind": "slip"}]
    data = RunData(late, open_field("msl-18x12"), events=told)
    assert [tuple(event) for event in data.happened()] == [(0.5, "kidnap"), (1.0, "slip")]
    assert [event["label"] for event in tree_of(data)["events"]] == ["kidnap", "shove"]


@pytest.mark.parametrize("odd", [np.inf, np.nan])
def test_an_uncertainty_that_is_no_number_leaves_the_band_out(odd: float, tmp_path: Path) -> None:
    data = run_data(20, 0, [])
    table = replace(
        data.table, covariance=np.full((20, 6), odd, np.float32), residual_m=np.full(20, np.nan, np.float32)
    )
    tree = page_data_of(write(tmp_path, frames=20, data=replace(data, table=table))[0])
    assert tree["charts"][0]["series"][0]["band"] == [None] * 20
    assert tree["charts"][0]["range"][1] > 0.0


def test_long_series_keep_their_peaks() -> None:
    data = run_data(100_000, 0, [])
    errors = data.errors
    assert errors is not None
    errors.values[:] = 0.0
    errors.values[[77_777, 12_345], 0] = 9.0, -4.0
    rows = shown_rows(data)
    assert len(rows) <= MAX_ROWS
    assert {77_777, 12_345} <= set(rows.tolist())
    assert np.all(np.diff(rows) > 0)


def test_every_frame_is_in_the_histogram_of_times_and_the_first_ones_apart() -> None:
    """Whether all frames take about as long, or the last of a hundred takes the longest."""
    for spent_ms in (np.linspace(1.0, 1.01, 50), np.geomspace(0.5, 900.0, 50)):
        total = Durations(median=float(np.median(spent_ms)), p99=float(spent_ms.max()))
        told = Latency(total=total, first_left_out=3)
        tree = latency_tree(spent_ms, told)
        assert (sum(tree["later"]), sum(tree["first"])) == (47, 3)
        median, p99 = tree["marks"]
        assert tree["low"] < median["ms"] < p99["ms"] < tree["high"]
        assert median["label"].startswith("median ")
