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

from touchline import palette
from touchline.evaluation.estimates import EstimateTable, read_estimates
from touchline.evaluation.metrics import ErrorTable, error_table
from touchline.evaluation.report import Picture, path_key, write_report
from touchline.evaluation.run_data import RunData, carried_rows
from touchline.evaluation.run_folder import RunFolder
from touchline.evaluation.runner import Thumbnail, run_frames
from touchline.evaluation.summary import Durations, Latency, RunSummary, SaidPhrase
from touchline.evaluation.timeline import (
    MAX_ROWS,
    axis_limit,
    dot_colors,
    error_charts,
    latency_tree,
    page_data,
    run_tree,
    shown_rows,
    truth_tree,
)
from touchline.field import open_field
from touchline.types import Estimate, Frame, Hypothesis, Mode, Samples, Status

MODE_NAMES = {Mode.OMNIVISION: "omnivision", Mode.BOTH: "both", Mode.ODOMETRY: "odometry"}
VOID = {"meta", "img", "br", "hr", "link", "input"}


class Page(HTMLParser):
    """Collects what a page refers to, and checks that its elements are closed in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.references: list[str] = []
        self.headings: list[str] = []
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
        if self._open and self._open[-1] in ("h1", "h2"):
            self.headings.append(data)


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


def test_every_section_is_there(page: str) -> None:
    assert Page(page).headings == [
        "walk <1>",
        "Path",
        "Over time",
        "Errors",
        "Latency",
        "Images",
        "Problems of the recording",
        "Settings",
    ]
    assert page.count("<svg") == page.count("id='histogram'") == 1
    assert page_data_of(page)["charts"]


def test_ids_of_the_figures_do_not_clash_and_are_all_defined(page: str) -> None:
    ids = Page(page).ids
    assert len(ids) == len(set(ids))
    referred = set(re.findall(r'url\(#([^)]+)\)|href="#([^"]+)"', page))
    assert {first or second for first, second in referred} <= set(ids)


def test_figures_take_their_colours_from_the_page(page: str) -> None:
    used = set(re.findall(r"var\(--([a-z-]+)\)", page[page.index("</style>") :]))
    used |= {color for run in page_data_of(page)["runs"] for color in run["dots"] or () if color}
    used |= set(re.findall(r'bar\("([a-z]+)"\)', page))
    style = page[: page.index("</style>")]
    assert style.count("prefers-color-scheme: dark") == 1
    day, night = style.split("prefers-color-scheme: dark")
    assert {"truth", "tracking", "carpet", "bar"} <= used
    used |= {series["color"] for chart in page_data_of(page)["charts"] for series in chart["series"]}
    used |= {"searching", "lost", *re.findall(r'css\("([a-z]+)"\)', page)}
    assert {"series-x", "series-heading", "soft", "grid"} <= used
    for variable in used:
        assert f"--{variable}:" in day
        assert f"--{variable}:" in night


def test_the_figures_of_the_table_are_printed(tmp_path: Path) -> None:
    page, errors = write(tmp_path)
    assert errors is not None
    for _, values in errors.rows():
        for value in values:
            assert f"<td>{value}</td>" in page
    assert "27 frames counted; left out: 1 before the first estimate, 2 black images" in page


def test_the_speed_leaves_the_start_out_and_the_page_tells_one_p99(tmp_path: Path) -> None:
    class Starting(FakeSystem):
        def step(self, frame: Frame) -> Estimate:
            return replace(super().step(frame), perception_ms=642.0 if len(self.seen) <= 10 else 28.0)

    page, _ = write(tmp_path, system=Starting(np.random.default_rng(0)))
    assert "time per image, median, first 10 left out" in page
    assert "time per image, p99, first 10 left out" in page
    tile, line = re.search(r"p99, first 10 left out</dt><dd>([\d.]+)<", page), re.search(r"p99 ([\d.]+) ms", page)
    assert tile is not None
    assert line is not None
    assert tile[1] == line[1]
    assert float(tile[1]) == pytest.approx(28.5, rel=0.01)


def test_text_from_the_recording_is_escaped(page: str) -> None:
    assert "walk &lt;1&gt;" in page
    assert "Black &amp; white" in page
    assert "imu.csv, line 9: &lt;gap&gt;" in page


def test_settings_seed_and_versions_are_told(page: str) -> None:
    assert "<th>matching.c_m</th><td>0.25</td>" in page
    assert "seed 5 · a processor · touchline 0.1.0" in page


def test_without_truth_the_page_says_so(tmp_path: Path) -> None:
    page, _ = write(tmp_path, truth=False)
    headings = Page(page).headings
    assert next(chart["title"] for chart in page_data_of(page)["charts"]).startswith("Residual")
    assert "Over time" in headings
    assert "holds no truth" in page


def test_a_robot_that_was_never_located_has_no_path_and_no_error_curve(tmp_path: Path) -> None:
    page, _ = write(tmp_path, searching=30, why_no_errors="no frame is left: the robot was never located")
    assert "<p>No frame is left: the robot was never located.</p>" in page
    assert "holds no truth" not in page
    assert "The truth alone" in page
    assert not any(chart["title"].startswith("Error") for chart in page_data_of(page)["charts"])
    assert "first located" not in page


def test_probabilities_are_told_where_a_system_knows_them(tmp_path: Path) -> None:
    class Unsure(FakeSystem):
        def step(self, frame: Frame) -> Estimate:
            estimate = super().step(frame)
            twin = Hypothesis(estimate.pose.mirrored(), 0.02, 0.125)
            return replace(estimate, probability=0.875, hypotheses=(twin,))

    assert "probability" not in write(tmp_path / "silent")[0]
    page, _ = write(tmp_path / "told", system=Unsure(np.random.default_rng(0)))
    assert "probability of the pose, median</dt><dd>87.5<span> %" in page
    assert "probability of its twin, median</dt><dd>12.5<span> %" in page


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
    assert "alt='Stanford diagram: error against protection level' src='data:image/png;base64," in shown
    assert "1.00 to 1.90 s (10 images): odometry turns the wrong way <code>odometry-turn-sign</code>" in shown
    assert "Stanford diagram" not in page, "a system without a monitor has none"
    assert "Consistency" not in page


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


def with_modes(data: RunData) -> RunData:
    """The same, fused in every mode in turn, lost in the last rows."""
    rows = len(data.table)
    modes = (np.arange(rows) % len(Mode)).astype(np.int8)
    status = data.table.status.copy()
    status[-2:] = list(Status).index(Status.LOST)
    return replace(data, table=replace(data.table, mode=modes, status=status))


def test_the_key_of_the_path_names_every_colour_that_is_drawn() -> None:
    data = run_data(20, 5, [])
    assert path_key(data) == [("truth", "truth"), ("tracking", "tracking"), ("first located", "first-located")]
    fused = with_modes(data)
    shown = [("truth", "truth"), *((mode.value, name) for mode, name in MODE_NAMES.items()), ("lost", "lost")]
    assert sorted(path_key(fused)) == sorted([*shown, ("first located", "first-located")])
    assert {name for _, name in shown} == {"truth", *filter(None, dot_colors(fused))}


def test_the_key_of_the_path_is_text_of_the_page_and_cannot_be_cut_off(page: str) -> None:
    (key,) = re.findall(r"<span class='keys'>.*?</span></span>", page)
    assert re.sub(r"<[^>]*>", "", key).split() == ["truth", "tracking", "first", "located"]
    style = page[: page.index("</style>")]
    assert all(f".key.{name} " in style for name in re.findall(r"class='key ([a-z-]+)'", page))


@pytest.mark.parametrize("learns", [True, False])
def test_colours_are_said_to_be_learned_only_where_they_are(tmp_path: Path, learns: bool) -> None:
    page, _ = write(tmp_path, learns_colours=learns)
    assert ("colours are learned" in page) is learns


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


def test_one_kidnap_does_not_flatten_the_curves() -> None:
    chart = error_charts(kidnapped(), np.arange(40))[0]
    assert chart.calm is not None
    limit, largest = axis_limit(chart)
    assert limit < 1000.0
    assert largest is None or largest == pytest.approx(400.0)
    calm = replace(chart, curves=[chart.curves[0]._replace(values=np.where(chart.calm[0], 1.0, 400.0), two_sigma=None)])
    assert axis_limit(calm) == (pytest.approx(1.6), pytest.approx(400.0))


@pytest.mark.parametrize("odd", [np.inf, np.nan])
def test_an_uncertainty_that_is_no_number_leaves_the_band_out(odd: float, tmp_path: Path) -> None:
    data = run_data(20, 0, [])
    table = replace(
        data.table, covariance=np.full((20, 6), odd, np.float32), residual_m=np.full(20, np.nan, np.float32)
    )
    tree = page_data_of(write(tmp_path, frames=20, data=replace(data, table=table))[0])
    assert tree["charts"][0]["series"][0]["band"] == [None] * 20
    assert tree["charts"][0]["range"][1] > 0.0


def test_the_true_path_has_a_gap_where_the_robot_was_carried() -> None:
    data = kidnapped()
    assert data.truth is not None
    assert carried_rows(data.truth.values).tolist() == [10]
    assert tree_of(data)["gaps"] == [10]


def test_an_unknown_side_of_the_field_is_told(tmp_path: Path) -> None:
    page, _ = write(tmp_path, either_side={"count": 7, "other_pose": [1.0, -2.0, np.pi / 2], "probability": None})
    assert "in 7 of 30 images the robot may as well stand at the other end" in page
    assert "x 1.00 m, y -2.00 m, heading 90.0°" in page
    assert "--own-half" in page
    assert "at the other end" not in write(tmp_path / "sure")[0]


def test_a_told_end_that_nothing_confirms_is_not_called_known(tmp_path: Path) -> None:
    found = {"count": 7, "other_pose": [1.0, -2.0, np.pi / 2], "probability": 0.047}
    page, _ = write(
        tmp_path,
        either_side=found,
        prior={"pose": None, "own_half": True},
        said=[SaidPhrase(t=1.0, until=1.0, code="it-is", what="so")],
    )
    assert "undecided which end of the field it is: in 7 of 30 images nothing but the start that was told" in page
    assert "(the other: 5 %, at last x 1.00 m" in page
    assert "1.00 s: so" in page


@pytest.mark.parametrize(("ended", "said"), [("interrupted", "was interrupted"), ("failed", "The run failed: Why")])
def test_a_run_that_did_not_end_well_says_so(tmp_path: Path, ended: str, said: str) -> None:
    page, _ = write(tmp_path, ended=ended, failure="Why")
    assert said in page


def test_a_run_of_no_frames_has_a_page(tmp_path: Path) -> None:
    page, _ = write(tmp_path, frames=0)
    assert "Path" not in Page(page).headings


def test_a_run_of_one_frame_has_a_page(tmp_path: Path) -> None:
    page, _ = write(tmp_path, frames=1, truth=False)
    assert "Over time" in Page(page).headings
    assert "1 image in 0.0 s" in page
    assert "first 10 left out" not in page


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


def test_a_long_run_makes_no_longer_page(tmp_path: Path) -> None:
    short, long = (len(write(tmp_path / name, frames=frames)[0]) for name, frames in (("b", 1500), ("c", 7500)))
    assert long < 1.7 * short


def test_two_thousand_images_make_a_page_of_four_megabytes_at_most(tmp_path: Path) -> None:
    data = run_data(2_000, 3, [])
    rows = shown_rows(data)
    assert len(rows) == 2_000
    small = [Thumbnail(STEP_NS * 20 * k, bytes(14_000)) for k in range(100)]  # as those of a mirror robot
    runs = [run_tree("estimate", data, rows), truth_tree(data, rows)]
    text = page_data(data, error_charts(data, rows), [run for run in runs if run is not None], rows, small)
    assert len(text) < 3_900_000 - 6 * 200_000  # six large pictures, styles and scripts stand beside


def test_the_page_has_the_colours_of_all_figures(page: str) -> None:
    day = page[: page.index("prefers-color-scheme: dark")]
    for number, color in enumerate(palette.SERIES):
        assert f"--run-{number}:{color}" in day
    for name, color in (("tracking", palette.BLUE), ("searching", palette.ORANGE), ("lost", palette.VERMILLION)):
        assert f"--{name}:{color}" in day
    assert palette.bgr("#010203") == (3, 2, 1)


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
