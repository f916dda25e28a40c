"""Runs of one recording side by side: what they reach, what differs in their settings, where they part."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from touchline.config import leaves
from touchline.errors import InputError
from touchline.evaluation.metrics import associate
from touchline.evaluation.run import Run
from touchline.evaluation.run_data import RIGHT_M, RIGHT_RAD, RunData
from touchline.evaluation.summary import RunSummary
from touchline.evaluation.timeline import Chart, Curve, page_data, run_tree, shown_rows, truth_tree
from touchline.evaluation.web_page import html_page
from touchline.geometry import BoolArray, FloatArray, IntArray, runs_of, wrap_angles
from touchline.sources import Recording
from touchline.types import Status

MAX_RUNS = 6  # so many colours can be told apart
COLUMNS = ("position (cm)", "largest (cm)", "heading (°)", "tracked (%)", "wrong (s)", "time (ms)", "p99 (ms)")
_MAX_STRETCHES = 5


class Stretch(NamedTuple):
    """From when to when (s since the first image) a run is elsewhere than the first one, and how far at most (m)."""

    begin_s: float
    end_s: float
    largest_m: float
    images: int


@dataclass(frozen=True, eq=False, slots=True)
class Compared:
    """One of the runs: its name, folder, data, and for each image of the first run its own row (N,), -1 for none."""

    name: str
    run: Run
    data: RunData
    row: IntArray


@dataclass(frozen=True, eq=False, slots=True)
class Comparison:
    """Runs of one recording, by its name; why_no_truth says why errors are missing, if they are."""

    runs: Sequence[Compared]
    recording: str
    why_no_truth: str

    @property
    def first(self) -> RunData:
        """The data of the run that the others are compared with."""
        return self.runs[0].data

    def figures(self) -> list[tuple[str, list[str]]]:
        """For each run its name and COLUMNS as text: mean and largest position error, mean heading error, ...

        Errors are of all images that count; wrong: how long a wrong pose was called tracking.
        """
        return [(one.name, _figures(one)) for one in self.runs]

    def differing_settings(self) -> list[tuple[str, list[str]]]:
        """What the runs were told otherwise: system, seed, start, versions and settings; each run's value as text.

        A setting that only one of the systems has is left out: "–" is of a version that has it not.
        """
        inputs = [_inputs(one.run.summary) for one in self.runs]
        keys = dict.fromkeys(key for one in inputs for key in one)
        return [(key, [one.get(key, "–") for one in inputs]) for key in keys if _differs(key, inputs)]

    def distances_m(self, index: int) -> FloatArray:
        """How far a run is from the first one at each of its images (N,); NaN where it has none."""
        poses, others = self.first.table.trajectory.values, self._poses(index)
        return np.hypot(*(others[:, :2] - poses[:, :2]).T)

    def apart(self, index: int) -> BoolArray:
        """At which images (N,) a run is more than 30 cm or 10° from the first, or only one of both is tracking."""
        turned = np.abs(wrap_angles(self._poses(index)[:, 2] - self.first.table.trajectory.values[:, 2]))
        with np.errstate(invalid="ignore"):
            apart = (self.distances_m(index) > RIGHT_M) | (turned > RIGHT_RAD)
        one = self.runs[index]
        tracked, first = one.data.table.has_status(Status.TRACKING), self.first.table.has_status(Status.TRACKING)
        apart |= (one.row >= 0) & (tracked[one.row] != first)
        return apart

    def stretches(self, index: int) -> list[Stretch]:
        """Where a run and the first part, in the order of time; at most the five longest."""
        apart = self.apart(index)
        times = self.first.seconds(self.first.table.trajectory.stamp_ns)
        distance = self.distances_m(index)
        found = [
            Stretch(float(times[a]), float(times[b - 1]), float(np.nanmax(distance[a:b])), int(b - a))
            for a, b in runs_of(apart)
        ]
        return sorted(sorted(found, key=lambda one: -one.images)[:_MAX_STRETCHES])

    def is_same(self, index: int) -> bool:
        """Whether a run has the same poses as the first, at the same images."""
        mine, first = self.runs[index].data.table.trajectory, self.first.table.trajectory
        return np.array_equal(mine.stamp_ns, first.stamp_ns) and np.array_equal(mine.values, first.values)

    def _poses(self, index: int) -> FloatArray:
        one = self.runs[index]
        poses = one.data.table.trajectory.values[one.row]
        return np.where((one.row >= 0)[:, np.newaxis], poses, np.nan)


def compare(folders: Sequence[str | Path]) -> Comparison:
    """Two to six runs of one recording, which is looked up for the field and the truth.

    Raises InputError for another number of runs, for runs of different recordings, and if theirs is not found any more.
    """
    if not 2 <= len(folders) <= MAX_RUNS:
        raise InputError(f"compare: expected two to {MAX_RUNS} runs, got {len(folders)}")
    runs = [Run(folder) for folder in folders]
    if len({run.folder.resolve() for run in runs}) < len(runs):
        raise InputError("compare: the same run is given twice")
    for run in runs:
        if not len(run.estimates):
            raise InputError(f"{run.folder}: holds no image to compare")
        if _recording_name(run) != _recording_name(runs[0]):
            raise InputError(
                f"{run.folder} is a run of {_recording_name(run)}, {runs[0].folder} of {_recording_name(runs[0])}; "
                "compare runs of one recording"
            )
    recording = _recording_of(runs)
    truth = None if recording.truth is None else recording.truth.samples()
    stamps = runs[0].estimates.trajectory.stamp_ns
    compared = []
    for name, run in zip(_names(runs), runs, strict=True):
        row = associate(stamps, run.estimates.trajectory.stamp_ns)
        if (row < 0).all():
            raise InputError(
                f"{run.folder} and {runs[0].folder} have no image in common; compare runs of one recording"
            )
        data = RunData(run.estimates, recording.field, truth, run.black_ns(), recording.events)
        compared.append(Compared(name, run, data, row))
    return Comparison(compared, _recording_name(runs[0]), "" if truth is not None else "the recording holds no truth")


def _recording_of(runs: Sequence[Run]) -> Recording:
    """The recording, from the first run that still finds it."""
    gone = ""
    for run in runs:
        try:
            return run.recording()
        except InputError as error:
            gone = gone or str(error)
    raise InputError(f"no run finds its recording, which is needed for the field: {gone}")


def _recording_name(run: Run) -> str:
    return run.summary.recording.name


def _names(runs: Sequence[Run]) -> list[str]:
    """The folders' names, or their whole paths where two are called alike."""
    names = [run.folder.name or str(run.folder) for run in runs]
    return names if len(set(names)) == len(names) else [str(run.folder) for run in runs]


def _figures(one: Compared) -> list[str]:
    data, latency = one.data, one.run.summary.latency_ms.total
    errors = None if data.truth is None else one.run.errors_against(data.truth)
    wrong = data.wrong_while_tracking()
    values = (
        (None if errors is None else 100.0 * errors.position.mean, 2),
        (None if errors is None else 100.0 * errors.position.max, 1),
        (None if errors is None else math.degrees(errors.heading.mean), 3),
        (100.0 * float(data.table.has_status(Status.TRACKING).mean()), 1),
        (None if wrong is None else wrong.seconds, 2),
        (latency.median, 2),
        (latency.p99, 1),
    )
    return ["–" if value is None else f"{value:.{digits}f}" for value, digits in values]


def _inputs(summary: RunSummary) -> dict[str, str]:
    """All that a run was told, each as text."""
    inputs: dict[str, Any] = {"system": summary.system, "seed": summary.seed, "cpu": summary.cpu}
    inputs |= {f"start {key}": value for key, value in summary.prior}
    inputs |= {f"version of {name}": value for name, value in summary.versions.items()}
    inputs |= leaves(summary.settings)
    return {key: "none" if value is None else str(value) for key, value in inputs.items()}


def _differs(key: str, inputs: Sequence[dict[str, str]]) -> bool:
    """Whether two runs have other values of a setting, or two of the same system one of them none."""
    if len({one[key] for one in inputs if key in one}) > 1:
        return True
    has = {one["system"] for one in inputs if key in one}
    return any(one["system"] in has for one in inputs if key not in one)


# --- the page ---------------------------------------------------------------------------------------------------------


_DEGREES = float(np.degrees(1.0))


def comparison_page(compared: Comparison) -> str:
    """The whole page as text."""
    first = compared.first
    rows = shown_rows(first)
    trees = [_tree(one, rows, f"run-{k}") for k, one in enumerate(compared.runs)]
    truth = truth_tree(first, rows)
    data = page_data(first, _charts(compared, rows), [*trees, *([] if truth is None else [truth])], rows)
    names = [one.name for one in compared.runs]
    return html_page(
        "compare.html.jinja",
        data,
        title=f"{names[0]} and others",
        names=names,
        recording=compared.recording,
        columns=list(COLUMNS),
        figures=compared.figures(),
        differing=compared.differing_settings(),
        parting=parting_lines(compared),
        why_no_truth=compared.why_no_truth,
        key=[(name, f"run-{k}") for k, name in enumerate(names)],
    )


def parting_lines(compared: Comparison) -> list[str]:
    """Where each run and the first one part, a sentence each."""
    lines, first = [], compared.runs[0].name
    for index, one in enumerate(compared.runs[1:], start=1):
        if compared.is_same(index):
            lines.append(f"{one.name} and {first}: the same poses in all {len(one.data.table)} images")
            continue
        apart = int(compared.apart(index).sum())
        usual = 100.0 * float(np.nanmedian(compared.distances_m(index)))
        head = f"{one.name} and {first}: {usual:.2f} cm apart (median)"
        if not apart:
            lines.append(f"{head}, nowhere more than 30 cm or 10°, and tracking alike")
            continue
        parted = compared.stretches(index)
        where = ", ".join(f"{s.begin_s:.2f}–{s.end_s:.2f} s (up to {s.largest_m:.2f} m)" for s in parted)
        lines.append(f"{head}; more than 30 cm or 10° apart, or one alone tracking, in {apart} images: {where}")
    return lines


def _tree(one: Compared, rows: IntArray, color: str) -> dict[str, object]:
    """A run's places at the first run's rows; nothing where it has no image."""
    tree = run_tree(one.name, one.data, np.maximum(one.row[rows], 0), color)
    missing = np.flatnonzero(one.row[rows] < 0)
    for key in ("status", "dots", "x", "y", "h"):
        for index in missing:
            tree[key][index] = None
    return tree


def _charts(compared: Comparison, rows: IntArray) -> list[Chart]:
    """Errors of position and heading where the truth is known; the distance from the first run."""
    charts: list[Chart] = []
    tracked = np.array(
        [(one.data.table.has_status(Status.TRACKING)[one.row] & (one.row >= 0)) for one in compared.runs]
    )
    calm = tracked[:, rows]
    if compared.first.errors is not None:
        for title, unit, heading in (("Position error", "cm", False), ("Heading error", "°", True)):
            curves = [Curve(one.name, f"run-{k}", _error(one, heading)[rows]) for k, one in enumerate(compared.runs)]
            charts.append(Chart(title, unit, 2, curves, calm, signed=heading))
    curves = [
        Curve(one.name, f"run-{k}", 100.0 * compared.distances_m(k)[rows])
        for k, one in enumerate(compared.runs)
        if k > 0
    ]
    return [
        *charts,
        Chart(f"Distance from {compared.runs[0].name}", "cm", 2, curves, calm[:1] & calm[1:], signed=False),
    ]


def _error(one: Compared, heading: bool) -> FloatArray:
    """Distance from the truth (cm), or the error of the heading (°), at the first run's rows (N,); NaN for none."""
    own = np.full(len(one.data.table), np.nan)
    errors = one.data.errors_since_located()
    if errors is not None:
        own[errors.rows] = _DEGREES * errors.values[:, 2] if heading else 100.0 * errors.position_m()
    return np.where(one.row >= 0, own[one.row], np.nan)
