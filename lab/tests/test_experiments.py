"""touchline experiment: the frame, and the figures that each experiment must reach, with fewer runs than by default."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from touchline.cli import main
from touchline.errors import InputError
from touchline.evaluation.metrics import ErrorTable
from touchline.geometry import Pose
from touchline_lab.experiments import (
    EXPERIMENTS,
    Experiment,
    ExperimentResult,
    chosen_experiments,
    faults,
    harness,
    kidnap,
    lighting,
    occlusion,
)
from touchline_lab.experiments.drives import Track
from touchline_lab.experiments.harness import (
    NOTHING,
    RUNS,
    Headline,
    Kept,
    interval,
    percent,
    progress_to,
    rate,
    result_page,
    resumed,
    seed_range,
    spread,
    wilson,
    with_row,
    write_result,
)
from touchline_lab.experiments.samples import PLACE, descents, searches, xiong_convergence, xiong_samples
from touchline_lab.experiments.timing import lu2013_timing


def result(name: str = "one", ours: str = "1 cm") -> ExperimentResult:
    figure = Figure(figsize=(1, 1))
    return ExperimentResult(
        "A title", ("what", "paper", "ours"), (("mean | max", "2", "1"),), Headline("mean", "2 cm", ours), ("A note.",),
        (("map", figure),), name, 5,
    )  # fmt: skip


# --- the frame --------------------------------------------------------------------------------------------------------


def test_spread_is_mean_and_standard_deviation_over_the_seeds() -> None:
    assert spread([1.0, 2.0, 3.0]) == "2.00 ± 1.00"
    assert spread([2.5]) == "2.50"
    assert percent([0.98, 1.0]) == "99.0 ± 1.4 %"


def test_rates_have_wilsons_interval_and_means_one_by_bootstrap() -> None:
    assert rate(40, 40) == "100.0 % [91.2, 100.0]"
    assert rate(0, 10) == "0.0 % [0.0, 27.8]"
    assert wilson(8, 10) == pytest.approx((0.490, 0.943), abs=1e-3)
    low, high = (float(v) for v in interval(np.arange(10.0)).partition("[")[2].rstrip("]").split(", "))
    assert low == pytest.approx(2.7, abs=0.25)
    assert high == pytest.approx(6.3, abs=0.25)
    assert interval([2.5]) == "2.50"


def test_a_run_replaces_its_row_of_the_results_and_keeps_the_others_in_order() -> None:
    page = with_row(with_row("", result("b")), result("a"), ["a", "b"])
    again = with_row(page, result("b", "3 cm"), ["a", "b"])
    rows = [line for line in again.splitlines() if line.startswith("| [")]
    assert [row[3:4] for row in rows] == ["a", "b"]
    assert "3 cm" in rows[1]
    assert "1 cm" not in rows[1]


def test_every_file_of_a_result_is_written_and_named(tmp_path: Path) -> None:
    files = write_result(result(), tmp_path / "results")
    assert [path.name for path in files] == ["one.md", "one-map.png", "results.md"]
    assert all(path.stat().st_size > 0 for path in files)
    page = files[0].read_text(encoding="utf-8")
    assert "![one](one-map.png)" in page
    assert "mean \\| max" in page
    assert page == result_page(result(), ["one-map.png"])


def test_a_folder_that_cannot_be_written_is_told_plainly(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="--output"):
        write_result(result(), tmp_path / "file" / "results")


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_every_experiment_tells_how_far_it_has_come(name: str) -> None:
    """The first thing of all is told before anything takes long: whoever hears it can end the experiment."""

    class HeardError(Exception):
        pass

    heard: list[str] = []

    def listen(progress: str) -> None:
        heard.append(progress)
        raise HeardError

    with pytest.raises(HeardError):
        EXPERIMENTS[name].run(3, listen)
    assert re.fullmatch(r"[a-z ]+, 1 of \d+", heard[0])


def test_seeds_begin_where_they_are_asked_to() -> None:
    with progress_to(None, first_seed=7):
        assert list(seed_range(3)) == [7, 8, 9]
        assert list(seed_range(2, 10)) == list(range(70, 90))
    assert list(seed_range(2)) == [0, 1]
    first, later = (EXPERIMENTS["schulz-imu"].run(1, first_seed=first) for first in (0, 3))
    assert (later.seeds, later.first_seed) == (1, 3)
    assert first.rows != later.rows
    assert with_row("", later).splitlines()[-1].endswith("| 1 from 3 |")


def test_all_goes_on_where_it_was_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """What a folder holds of these seeds by this commit is left; other seeds are run."""
    runs: list[tuple[str, int, int]] = []

    def run(self: Experiment, seeds: int, *_: object, first_seed: int) -> ExperimentResult:
        runs.append((self.name, seeds, first_seed))
        return replace(result(self.name), first_seed=first_seed)

    monkeypatch.setattr(Experiment, "run", run)
    monkeypatch.setattr("touchline_lab.experiments.EXPERIMENTS", {name: EXPERIMENTS[name] for name in ("own", "nees")})
    command = ["experiment", "all", "--output", str(tmp_path), "--seeds", "2"]
    assert main(command) == 0
    (tmp_path / RUNS).write_text("".join((tmp_path / RUNS).read_text().splitlines(keepends=True)[:1]))
    assert main(command) == 0
    assert runs == [("own", 2, 0), ("nees", 2, 0), ("nees", 2, 0)]
    assert "own: done before" in capsys.readouterr().out
    assert main([*command, "--first-seed", "100"]) == 0
    assert runs[3:] == [("own", 2, 100), ("nees", 2, 100)]
    assert main(command) == 0  # the pages are of the other seeds now
    assert runs[5:] == [("own", 2, 0), ("nees", 2, 0)]
    (tmp_path / "own.md").unlink()
    with (tmp_path / RUNS).open("a") as file:
        file.write('{"name": "ne')  # cut off
    assert main(command) == 0
    assert runs[7:] == [("own", 2, 0)]
    (tmp_path / RUNS).write_text("nothing\n")
    assert main(command) == 2


@pytest.mark.parametrize(("first_s", "runs"), [(60.0, [1, 11]), (240.0, [1, 2]), (900.0, [1]), (0.0, [1, 30])])
def test_a_budget_is_so_many_seeds_as_fit(
    first_s: float, runs: list[int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Twelve minutes, and a first seed that takes one, four, fifteen and none; begun again, nothing is run twice."""
    found, now_s, stops = [], 0.0, True

    def run(self: Experiment, seeds: int, *_: object, first_seed: int) -> ExperimentResult:
        nonlocal now_s, stops
        if stops and found:
            stops = False
            raise InputError("stopped behind the first seed")
        found.append(seeds)
        now_s += first_s * seeds
        return replace(result(self.name), seeds=seeds, first_seed=first_seed)

    monkeypatch.setattr(Experiment, "run", run)
    monkeypatch.setattr("touchline_lab.experiments.EXPERIMENTS", {"own": EXPERIMENTS["own"]})
    monkeypatch.setattr("touchline_lab.cli.experiment.time.monotonic", lambda: now_s)
    command = ["experiment", "all", "--output", str(tmp_path), "--seeds", "30", "--budget"]
    codes = [main([*command, "12"]), main([*command, "12"]), main([*command, "6"])]
    assert codes == [0 if runs == [1] else 2, 0, 0]
    assert found == runs
    stops = False
    assert main(["experiment", "own", *command[2:], "12"]) == 0  # one that is named is run whatever is there
    assert found == [*runs, *runs]


def test_results_of_other_seeds_and_of_another_commit_do_not_count(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, computed = tmp_path / "faults.jsonl", []

    def square(item: int) -> int:
        computed.append(item)
        return item**2

    def found(items: list[int], part: str = "") -> list[int]:
        computed.clear()
        with progress_to(None, kept=Kept(path, part)):
            return resumed(square, items, "squares")

    monkeypatch.setattr(harness, "commit", lambda: "a")
    assert found([1, 2]) == [1, 4]
    assert (found([2, 3]), computed) == ([4, 9], [3])
    assert (found([5, 6], "5"), computed) == ([25, 1, 4, 9], [5])
    monkeypatch.setattr(harness, "commit", lambda: "b")
    assert (found([1, 2]), computed) == ([1, 4], [1, 2])
    assert (sorted(found([1], NOTHING)), computed) == ([1, 4, 9, 25], [])


def test_seeds_of_faults_from_another_first_one_are_other_robots() -> None:
    with progress_to(None, first_seed=5):
        later = {task[3] for task in faults.tasks(5)}
    assert later.isdisjoint(task[3] for task in faults.tasks(5))


def test_the_commit_is_git_s_and_empty_without_a_repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if (Path(__file__).parents[1] / ".git").exists():
        assert re.fullmatch("[0-9a-f]{12}", harness.commit())
    monkeypatch.setattr(harness, "__file__", str(tmp_path / "src" / "touchline" / "experiments" / "harness.py"))
    assert harness.commit() == ""


def test_a_mistyped_experiment_is_answered_with_the_nearest() -> None:
    with pytest.raises(InputError, match="did you mean 'lu2013-kidnap'"):
        chosen_experiments("lu2013-kidnp")
    assert len(chosen_experiments("all")) == len(EXPERIMENTS)


def test_the_command_lists_the_experiments_and_runs_one(tmp_path: Path, capsys: Any) -> None:
    assert main(["experiment"]) == 0
    listed = capsys.readouterr().out
    assert [name for name in EXPERIMENTS if name not in listed] == []
    assert main(["experiment", "xiong-samples", "--seeds", "2", "--output", str(tmp_path / "out")]) == 0
    assert "315" in capsys.readouterr().out
    assert "[xiong-samples](xiong-samples.md)" in (tmp_path / "out" / "results.md").read_text(encoding="utf-8")
    assert main(["experiment", "nonsense"]) == 2


# --- the experiments --------------------------------------------------------------------------------------------------


def test_black_sectors_cover_the_stated_share_of_the_view() -> None:
    shares = [sum(high - low for low, high in condition.sectors) / 360.0 for condition in occlusion.CONDITIONS[:5]]
    assert shares == [0.0, 0.125, 0.25, 0.5, 0.5]


@cache
def errors_under(number: int, ideal: bool = True) -> ErrorTable:
    errors = occlusion.drive(occlusion.CONDITIONS[number], seed=0, ideal=ideal).errors
    assert errors is not None
    return errors


# mean and largest position error (m), mean heading error (rad): twice what is measured at the most
IDEAL_BOUNDS = (
    (0.0049, 0.0163, 0.00055), (0.0061, 0.025, 0.00083), (0.0065, 0.025, 0.00099), (0.008, 0.068, 0.00117),
    (0.0113, 0.0505, 0.00177), (0.0086, 0.028, 0.0014), (0.0112, 0.039, 0.00198),
)  # fmt: skip


@pytest.mark.parametrize("number", range(7), ids=[condition.name for condition in occlusion.CONDITIONS])
def test_errors_with_up_to_half_the_view_hidden(number: int) -> None:
    errors = errors_under(number)
    assert errors.frames == 551
    position_m, farthest_m, heading_rad = IDEAL_BOUNDS[number]
    assert errors.position.mean <= position_m
    assert errors.position.max <= farthest_m
    assert errors.heading.mean <= heading_rad


@pytest.mark.parametrize(("number", "bounds"), [(0, (0.0139, 0.049, 0.00196)), (4, (0.0317, 0.171, 0.0045))])
def test_errors_of_a_robot_as_built(number: int, bounds: tuple[float, float, float]) -> None:
    errors = errors_under(number, ideal=False)
    assert errors.frames > 540
    assert errors.position.mean <= bounds[0]
    assert errors.position.max <= bounds[1]
    assert errors.heading.mean <= bounds[2]


def test_particles_alone_as_the_paper_prints_them_are_less_exact_than_particles_and_matching() -> None:
    alone = occlusion.drive(occlusion.CONDITIONS[5], seed=0, ideal=True, paper=True).errors
    assert alone is not None
    assert alone.position.mean > 4.6 * errors_under(0).position.mean


@pytest.mark.parametrize(("system", "covered"), [("nubot-mcl", 3), ("nubot-mcl", 0), ("nubot-mti", 3)])
def test_kidnapped_robots_are_right_within_10_cycles(system: str, covered: int) -> None:
    every = kidnap.random_kidnaps(system, 0, 5.0, covered)
    assert len(every) == 40
    assert all(one.success for one in every)
    noticed = [one for one in every if one.waited is not None]
    assert len(noticed) >= 39
    assert not any(one.waited for one in noticed)


def test_a_kidnap_that_nobody_notices_and_that_is_wrong_is_no_success() -> None:
    """Both of its figures come from the truth, not from what the system says of itself."""
    one = kidnap.kidnap("nubot-mcl", (Pose(-3.0, 1.0, 0.0), Pose(4.0, -2.0, 2.0)), 0.0, 3, (0,))
    assert one.success
    assert one.found.distance_to(one.truth) < 0.0045
    assert one.truth.distance_to(Pose(4.0, -2.0, 2.0)) < 0.5


@pytest.mark.parametrize("system", ["nubot-mcl", "nubot-mti"])
def test_a_look_alike_place_with_a_like_heading_is_noticed_in_full_view(system: str) -> None:
    """At the goal line much looks as at the halfway line: the points lie 0.3 m off, and the compass agrees."""
    places = Pose(-0.54, -3.71, 2.32), Pose(8.11, -4.2, -0.16)
    one = kidnap.kidnap(system, places, math.radians(5.0), 0, (4, 9, 50))
    assert one.success
    assert one.right.all() if one.waited is None else one.waited <= 5  # found in the first image there, or doubted


def test_a_kidnap_never_noticed_counts_by_where_the_robot_is_tracked() -> None:
    """Carried by a hand's breadth, the robot is found by matching alone."""
    one = kidnap.kidnap("nubot-mcl", (Pose(2.0, 1.0, 0.0), Pose(2.3, 1.1, 0.0)), 0.0, 0, (0,))
    assert one.waited is None
    assert one.success
    assert one.found.distance_to(one.truth) < 0.0058


@pytest.mark.parametrize("ideal", [True, False], ids=["ideal", "as built"])
def test_the_search_of_figure_7_has_315_samples_of_which_the_nearest_is_the_best(ideal: bool) -> None:
    for search in searches(3, ideal=ideal):
        assert len(search.round.errors) == 315
        best = search.round.samples_m[int(np.argmin(search.round.errors))]
        assert math.hypot(best[0] - search.truth.x, best[1] - search.truth.y) < 0.15
        assert search.taken.distance_to(search.truth) < (0.0044 if ideal else 0.0176)


def test_figure_7_shows_the_papers_form_and_ideal_robots_beside_ours() -> None:
    found = xiong_samples(2)
    assert found.headline.ours.startswith("100.0 %")
    assert found.columns[-4:] == ("pose is off by: paper", "its form here", "ours", "ideal robot")


def test_rprop_settles_within_20_steps_from_next_to_it_and_wrong_ends_have_far_more_error() -> None:
    ends = [end for search in searches(3, ideal=True) for end in descents(search)]
    near = [end for end in ends if end.right]
    beside = [end for end in near if math.dist(end.start_m, PLACE) < 0.94]  # two of the grid's samples
    assert len(beside) == 6
    assert max(end.steps for end in beside) <= 20
    assert min(end.after for end in ends if not end.right) > 34.0 * max(end.after for end in near)


def test_figure_9_compares_like_with_like() -> None:
    found = xiong_convergence(1)
    names = [row[0] for row in found.rows[:6]]
    assert names[:4] == ["the paper", "ours", "ours, c = 2.55 m", "its form here, c = 2.55 m"]
    assert "c = 2.55 m" in found.headline.ours


def test_timing_reports_every_part_and_the_curve() -> None:
    found = lu2013_timing(1)
    assert [row[0] for row in found.rows[:3]] == [
        "particles: one cycle, 600 x 100", "particles: the same with five refined clusters",
        "matching: one cycle, 100 points",
    ]  # fmt: skip
    names = [row[0] for row in found.rows]
    assert names[3:5] == ["particles: weights alone, 600 x 100", "particles: weights alone, plain NumPy"]
    assert "particles: 100000 x 100" in names
    assert names[-1] == "particles: 600 x 1000"
    assert len(found.pictures) == 2


# --- lu2013-lighting --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def first_case(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, tuple[float, float]]:
    """The colour table of the first case, and the settings that its light asks for."""
    colours = tmp_path_factory.mktemp("lighting") / "colours.npz"
    return colours, lighting.learned_colours(1, colours, seconds=12.0, ideal=True)


def mean_m(run: lighting.Run) -> float:
    """Mean position error."""
    assert run.errors is not None
    return run.errors.position.mean


def ideal(colours: Path) -> lighting.Robot:
    return lighting.Robot(1, colours, ideal=True)


def test_lamps_off_start_a_search_for_more_light_and_cost_nothing(
    first_case: tuple[Path, tuple[float, float]],
) -> None:
    """Lamps off from 10 s on: a twenty-fifth of the light is left."""
    run = lighting.drive(lighting.THIRD, ideal(first_case[0]), None, seconds=12.0)
    dark = np.arange(len(run.track.points)) >= round(lighting.SWITCH_S * lighting.RATE_HZ) - 1
    assert run.track.tracking.all()
    assert mean_m(run) < 0.0074
    assert run.track.points[dark].mean() > 0.8 * run.track.points[~dark].mean()
    assert np.flatnonzero(run.searched).tolist() == [0, np.flatnonzero(dark)[0]]
    assert run.stops[dark].min() > run.stops[~dark].max() + 2.0


def test_points_left_without_lamps_are_told_for_each_level() -> None:
    """150 images: dark from image 24 on for 25 images at 20 lx, then lamps, then 10 lx, then lamps, then 20 lx."""
    points = np.full(150, 100)
    points[24:49], points[74:99], points[124:149] = 90, 10, 70
    blank = np.zeros(150)
    still = np.zeros((150, 3))
    track = Track(np.arange(150.0), still, still, blank > 0, points=points)
    run = lighting.Run(track, blank, blank > 0)
    assert "off: 80 % at 20 lx, 10 % at 10 lx." in lighting._switched_off([run])


def test_control_keeps_the_line_points_in_a_dark_that_takes_them_without(
    first_case: tuple[Path, tuple[float, float]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A hundredth of the light."""
    monkeypatch.setattr(lighting, "PLACES", 2)
    lamps, dark = lighting.points_in_the_dark(1, *first_case, levels=(0.01,))
    assert lamps.min() > 120
    assert dark[0] < 0.017 * lamps[0]
    assert dark[1] > 0.8 * lamps[1]


def test_patches_of_sun_cost_little_with_colours_learned_under_lamps(
    first_case: tuple[Path, tuple[float, float]],
) -> None:
    sun = lighting.drive(lighting.SECOND, ideal(first_case[0]), None, seconds=6.0)
    assert sun.track.tracking.all()
    assert mean_m(sun) < 0.0064
    assert sun.track.points.mean() > 120


def test_under_the_sun_through_clear_glass_a_robot_in_a_patch_sees_the_lines_in_the_shade(
    first_case: tuple[Path, tuple[float, float]],
) -> None:
    """Patches are white all over; what lies behind them is still the field."""
    run = lighting.drive(lighting.GLASS, lighting.Robot(0, first_case[0], ideal=True), None, seconds=4.0)
    assert run.track.tracking.all()
    assert mean_m(run) < 0.0123
    assert run.track.points.min() > 46


def test_the_papers_ratios_come_by_the_formula_of_ours() -> None:
    ratios = [lighting.paper_ratio(case) for case in (lighting.SECOND, lighting.THIRD)]
    assert ratios == pytest.approx([1.010, 0.772], abs=5e-4)


def test_every_lighting_states_its_levels() -> None:
    """What the notes say of light is what is simulated."""
    said = " ".join(lighting._NOTES)
    levels = ((lighting.SECOND, "6 times"), (lighting.DULL, "0.2"), (lighting.GLASS, "76 times"))
    for case, level in levels:
        assert level in said
        assert str(case.light.sun or case.light.ambient).removesuffix(".0") in level
    changed = lighting.THIRD.light.changes
    assert [change.lamps for change in changed[:2]] == [0.0, 1.0]
    assert [change.ambient for change in changed[::2]] == [20 / 500, 10 / 500, 20 / 500]
    assert "20 lx of safety lighting" in said
    assert "10 lx, the least among spectators (0.02;" in said


# --- the page of the last results -------------------------------------------------------------------------------------


def test_every_experiment_has_its_row_section_and_pictures_on_the_results_page() -> None:
    docs = Path(__file__).parents[2] / "docs"
    page = (docs / "results.md").read_text(encoding="utf-8")
    rows = {line.partition("](")[0].removeprefix("| ["): line for line in page.splitlines() if line.startswith("| [")}
    assert list(rows) == list(EXPERIMENTS)
    seeds = {name: int(row.rstrip(" |").rpartition("|")[2]) for name, row in rows.items()}
    assert [name for name, count in seeds.items() if count < 5] == ["photographs"]
    assert "Covered: touchline: 122 faults" in page
    pictures = docs / "images" / "results"
    for name in EXPERIMENTS:
        assert f"\n## {name}\n" in page
        assert any(f"(images/results/{path.name})" in page for path in pictures.glob(f"{name}-*.jpg"))
    assert sum(path.stat().st_size for path in pictures.iterdir()) < 2_000_000
