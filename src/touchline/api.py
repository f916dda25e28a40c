"""The one-call level: a recording in, a run with its errors and its report out."""

import math
import platform
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from importlib.metadata import version
from pathlib import Path

import numpy as np

from touchline.camera import OmniCamera
from touchline.checks.slips import find_slips
from touchline.config import PAPER, Settings, load_settings, preset_values, settings_tree
from touchline.errors import InputError, TouchlineError
from touchline.evaluation.latency import cpu_name
from touchline.evaluation.run import Run
from touchline.evaluation.run_folder import RunFolder, new_folder, write_summary
from touchline.evaluation.runner import OnFrame, RunTally, robot_setup, run_frames
from touchline.evaluation.summary import ReadingProblems, RunErrors, RunPrior, RunRecording, RunSummary
from touchline.field import FieldModel
from touchline.geometry import Pose, wrap_angle
from touchline.given import given_numbers, given_path, given_seed, given_switch, refused
from touchline.messages import without_numbers
from touchline.sources import SENSOR_FILES, ProblemKind, Recording, open_source
from touchline.sources.observations import OBSERVATIONS
from touchline.systems import (
    DEFAULT_SYSTEM,
    SYSTEMS,
    LocalizationSystem,
    RobotSetup,
    SystemInfo,
    open_system,
    system_info,
)
from touchline.systems.setup import CAMERA_HEIGHT_M
from touchline.types import Prior, Status
from touchline.view.belief import particles_of

_START_MARGIN_M = 3.0  # a robot may well start beside the field
_NO_IMAGE = (
    ProblemKind.MISSING_IMAGE,
    ProblemKind.BROKEN_IMAGE,
    ProblemKind.IMAGE_SIZE,
    ProblemKind.LINEAR_IMAGE,
)
_LIBRARIES = ("touchline", "numpy", "numba", "opencv-python-headless")


def run(
    recording: str | Path | Recording,
    system: str = DEFAULT_SYSTEM,
    *,
    output: str | Path | None = None,
    start: Sequence[float] | None = None,
    own_half: bool = False,
    config: str | Path | Settings | None = None,
    overrides: Sequence[str] = (),
    seed: int = 0,
) -> Run:
    """Localize a recording and write the folder of the run, as `touchline run` does.

    recording: its folder, or what `open_source` made of it. output: the folder, which must not exist; by default a new
    one, runs/NAME-N. start: x, y (m), heading (rad) in the field frame. config: a YAML file of settings, or settings:
    `touchline.systems.paper_settings(system)` are those of the paper's exact form. overrides: `key=value` each. The
    same seed gives the same trajectory.

    Raises InputError for bad input; what the system raises is raised on, after the folder has been finished.
    """
    pose = None if start is None else Pose(*given_numbers("start", "x, y (m), heading (rad)", start, 3))
    prior = Prior(pose, given_switch("own_half", own_half))
    folder_path = None if output is None else given_path("output", "the path of a new folder", output)
    prepared = prepare(recording, system, prior=prior, config=config, overrides=overrides, seed=seed)
    folder = new_folder(folder_path, prepared.source.name)
    finished, failure = prepared.execute(folder)
    if failure is not None:
        raise failure
    return finished


@dataclass(frozen=True, eq=False, slots=True)
class PreparedRun:
    """A run whose input has been checked: nothing is written before `execute`."""

    source: Recording
    system: LocalizationSystem
    info: SystemInfo
    settings: Settings
    prior: Prior
    seed: int
    notices: tuple[str, ...] = ()
    """What the user should know before the run: complete sentences."""
    slips: tuple[str, ...] = ()
    """Those of them that spoil everything: numbers in other units, images without colour."""

    def execute(
        self,
        folder: Path,
        *,
        on_frame: Sequence[OnFrame] = (),
        stop: Callable[[], bool] = lambda: False,
        report: Callable[[RunSummary], bool] | None = lambda summary: True,
    ) -> tuple[Run, BaseException | None]:
        """Run to the end, to a failure, or until `stop` says so; the (new, empty) folder is finished in each case.

        report: whether a run with this summary gets a report; None: no run does, and no pictures are drawn for it.

        Returns the run, and the exception that ended it, if one did. Raises TouchlineError, with the file's name, for
        what cannot be written; what was written before stays whole.
        """
        started = datetime.now(timezone.utc).isoformat(timespec="seconds")
        description = self._description(started)
        with RunFolder(folder, description) as rows:
            rows.sync(RunTally().summary())
            tally = run_frames(
                self.source,
                self.system,
                rows,
                prior=self.prior,
                on_frame=on_frame,
                stop=stop,
                particles=lambda: particles_of(self.system),
                pictures=report is not None,
            )
        try:
            return self._finish(folder, description, tally, report), tally.failure
        except TouchlineError as error:  # on a full disk the rows' own failure says what was lost
            raise (tally.failure if isinstance(tally.failure, TouchlineError) else error) from None

    def _finish(
        self,
        folder: Path,
        description: RunSummary,
        tally: RunTally,
        report: Callable[[RunSummary], bool] | None,
    ) -> Run:
        summary = description.updated(tally.summary())
        summary.problems = _problems(self.source)
        summary.why_not_localised = self._why_not_localised(tally)
        write_summary(folder, summary)
        finished = Run(folder)
        finished.truth = None if self.source.truth is None else self.source.truth.samples()
        summary.why_no_errors = finished.why_no_errors
        if finished.errors is not None:
            summary.errors = RunErrors.model_validate(finished.errors.as_dict())
        finished.summary = summary
        write_summary(folder, summary)
        if report is not None and report(summary):
            _write_report(finished, self.source, tally, self.system)
        return finished

    def _why_not_localised(self, tally: RunTally) -> str | None:
        """The one cause for which no image was localised, or most show nothing; None if none is known."""
        if self.slips and not tally.statuses[Status.TRACKING]:
            return " ".join(self.slips)
        for problem in self.source.problems:
            if problem.kind in _NO_IMAGE and 2 * self.source.problems.counts[problem.kind] > tally.frames:
                return f"in {self.source.problems.counts[problem.kind]} of them there is none to look at. {problem}"
        left_out = self.source.problems.file_counts[ProblemKind.BROKEN_ROW, OBSERVATIONS]
        if not tally.statuses[Status.TRACKING] and 2 * left_out > tally.frames:
            first = next(problem for problem in self.source.problems if problem.file == OBSERVATIONS)
            return f"rows of {OBSERVATIONS} are left out, {left_out} in all. {first}"
        alike = Counter[str]()
        for why, count in tally.unseen.items():
            alike[without_numbers(why)] += count
        for why, count in alike.most_common(1):
            if 2 * count > tally.frames:
                return f"in {count} of them, {next(each for each in tally.unseen if without_numbers(each) == why)}"
        return None

    def _description(self, started: str) -> RunSummary:
        bag = self.source.options
        return RunSummary(
            started=started,
            recording=RunRecording(
                path=str(self.source.path.resolve()),
                bag=bag.to_dict() if bag.given() else None,
                name=self.source.name,
                description=str(self.source.sequence.get("description", "")),
                field=self.source.field.name,
            ),
            system=self.info.name,
            settings=settings_tree(self.settings),
            learns_colours=self.system.detector is not None and self.system.detector.learns_colours,
            notices=list(self.notices),
            prior=RunPrior(pose=self.prior.pose, own_half=self.prior.own_half),
            seed=self.seed,
            versions={"python": platform.python_version(), **{name: version(name) for name in _LIBRARIES}},
            platform=sys.platform,
            cpu=cpu_name(),
        )


def prepare(
    recording: str | Path | Recording,
    system: str = DEFAULT_SYSTEM,
    *,
    prior: Prior | None = None,
    config: str | Path | Settings | None = None,
    overrides: Sequence[str] = (),
    preset: str | None = None,
    seed: int = 0,
) -> PreparedRun:
    """Open everything a run needs and check it. Raises InputError for what is wrong.

    config: a file, or settings of that system. preset: `paper` for the exact form of the system's paper; config and
    overrides win over it.
    """
    info = system_info(system)
    file = None
    if config is not None and not isinstance(config, Settings):
        file = given_path("config", "the path of a YAML file of settings", config)
    if not isinstance(overrides, list | tuple) or not all(isinstance(each, str) for each in overrides):
        raise refused("overrides", "a list of texts 'key=value'", overrides)
    seed = given_seed(seed)
    if isinstance(config, Settings):
        if overrides or preset is not None:
            raise InputError("config: settings are taken as they are; overrides and a preset change those of a file")
        settings = config
    else:
        settings = settings_given(info, file, overrides, preset)
    source = open_source(recording)
    setup = robot_setup(source)
    built = open_system(system, setup, settings, np.random.default_rng(seed))
    prior = checked_prior(prior or Prior(), source.field)
    built.reset(prior)
    slips = tuple(str(slip) for slip in find_slips(source))
    notices = (*_notices(source, info), *_height_notices(setup, info), *slips)
    return PreparedRun(source, built, info, settings, prior, seed, notices, slips)


def settings_given(info: SystemInfo, file: Path | None, overrides: Sequence[str], preset: str | None) -> Settings:
    """A system's settings as a command gives them. Raises InputError for what is wrong, and for an unknown preset."""
    if preset is not None and not preset_values(info.settings, preset):
        raise InputError(f"{info.name} has no preset '{preset}'{_with_preset(preset)}")
    others = {name: other.settings for name, other in SYSTEMS.items() if name != info.name}
    return load_settings(info.settings, file, overrides, elsewhere=others, preset=preset)


def _with_preset(preset: str) -> str:
    """Which systems have it, or the one preset that there is, as the end of a sentence."""
    names = [name for name, info in SYSTEMS.items() if preset_values(info.settings, preset)]
    if names:
        return f"; {', '.join(names)} {'has' if len(names) == 1 else 'have'} one"
    return f"; the one there is: {PAPER}{_with_preset(PAPER)}" if preset != PAPER else ""


def checked_prior(prior: Prior, field: FieldModel) -> Prior:
    """The prior, its heading wrapped. Raises InputError for a start far off the field, or in degrees."""
    if prior.pose is None:
        return prior
    x, y, heading = prior.pose
    if abs(heading) > 2.0 * math.pi:
        raise InputError(f"the start heading {heading:g} is more than a full turn: is it in radians?")
    if abs(x) > field.length / 2 + _START_MARGIN_M or abs(y) > field.width / 2 + _START_MARGIN_M:
        raise InputError(
            f"the start ({x:g}, {y:g}) m lies far off the field {field.name} of {field.length:g} × {field.width:g} m, "
            "whose centre is (0, 0)"
        )
    return Prior(Pose(x, y, wrap_angle(heading)), prior.own_half)


def _notices(source: Recording, info: SystemInfo) -> tuple[str, ...]:
    """Whether the recording lacks sensors that the system needs, and what it uses instead."""
    needs = info.needs
    if needs is None:
        return ()
    files = dict.fromkeys(SENSOR_FILES[sensor] for sensor in needs.sensors)
    missing = [file for file in files if file not in source.sensor_files]
    if "wheels" in needs.sensors and source.wheel_directions_rad is None and "wheels.csv" not in missing:
        missing.append("the wheels' rolling directions (wheels: {a_dir_rad: …, b_dir_rad: …} in sequence.yaml)")
    if not missing:
        return ()
    what = f"{info.name} {needs.purpose}, but the recording lacks {' and '.join(missing)}"
    stand_in = SENSOR_FILES[needs.stand_in]
    if stand_in in source.sensor_files:
        return (f"{what}: {stand_in} is used instead",)
    return (f"{what}, and {stand_in}, which would stand in: {needs.without}",)


def _height_notices(setup: RobotSetup, info: SystemInfo) -> tuple[str, ...]:
    """What a system for perspective cameras assumes where a detector of the robot's own sees, and nobody tells."""
    if OmniCamera in info.cameras or setup.camera is not None or setup.height_m is not None:
        return ()
    return (
        f"nothing tells how high the camera is: {CAMERA_HEIGHT_M:g} m is assumed for what an error of its lean does to "
        "the features; camera: pinhole in sequence.yaml and a camera.yaml beside it tell it",
    )


def _problems(source: Recording) -> ReadingProblems:
    counts = {kind.value: count for kind, count in source.problems.counts.items()}
    return ReadingProblems(counts=counts, messages=[str(problem) for problem in source.problems])


def _write_report(finished: Run, source: Recording, tally: RunTally, system: LocalizationSystem) -> None:
    from touchline.evaluation.report import write_report  # the first frame need not wait for it
    from touchline.evaluation.run_data import RunData
    from touchline.view.run_pictures import run_pictures, thumbnails

    said, black_ns = finished.summary.said, finished.black_ns()
    data = RunData(finished.estimates, source.field, finished.truth, black_ns, source.events, said)
    pictures = run_pictures(source, tally, system)
    write_report(finished.folder, finished.summary, data, finished.errors, pictures, thumbnails(source, tally))
