"""`touchline run` and `touchline demo`: a recording in, a run folder out."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from touchline.cli import INTERRUPTED
from touchline.cli.console import DEBUG_VARIABLE, print_errors, say, steps_shown, warn
from touchline.cli.interrupts import interruptible
from touchline.cli.options import (
    BagBase,
    BagCamera,
    BagField,
    BagLate,
    ConfigFile,
    FollowLinks,
    FromZero,
    Overrides,
    OwnHalf,
    Preset,
    Seed,
    StartPose,
    SystemName,
    Topics,
    bag_options,
    numbers,
)
from touchline.errors import InputError, TouchlineError
from touchline.files.new import check_new_path
from touchline.messages import counted, unexpected

if TYPE_CHECKING:
    from touchline.api import PreparedRun
    from touchline.evaluation import Run
    from touchline.evaluation.summary import RunSummary
    from touchline.geometry import Pose

EXAMPLE = "omni_msl_track_short"
_UNMOVED = (
    "no pose is tracked: they fit the images, but the robot has not moved enough to confirm them; "
    "--start or --own-half tell where it was"
)
_MAX_SAID = 5  # phrases of a system; the report has more


class InterruptedRun(TouchlineError):
    """Ctrl-C or SIGTERM, after the folder of the run has been finished."""

    exit_status = INTERRUPTED


def run(
    recording: Annotated[
        Path, typer.Argument(metavar="RECORDING", help="A folder, an MCAP file, a bag; many: touchline season.")
    ],
    system: SystemName = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="New folder for the results (default: runs/NAME-N).")
    ] = None,
    start: StartPose = None,
    own_half: OwnHalf = False,
    config: ConfigFile = None,
    settings: Overrides = None,
    preset: Preset = None,
    seed: Seed = 0,
    follow_links: FollowLinks = False,
    topics: Topics = None,
    field: BagField = None,
    camera: BagCamera = None,
    base: BagBase = None,
    late: BagLate = 0.0,
    from_zero: FromZero = False,
    report: Annotated[bool, typer.Option("--report/--no-report", help="Write report.html.")] = True,
) -> None:
    """Localise a recording: trajectory, estimates, summary and report in a new folder."""
    if start is not None and own_half:
        raise InputError("--start and --own-half exclude each other: give the pose, or only the half")
    from touchline.api import prepare
    from touchline.sources import open_source
    from touchline.systems import DEFAULT_SYSTEM, system_info
    from touchline.types import Prior

    prior = Prior(parse_pose(start) if start is not None else None, own_half)
    name = system or DEFAULT_SYSTEM
    system_info(name)  # an unknown name is told before the recording is read
    bag = bag_options(topics, field, camera, base, late, from_zero)
    source = open_source(recording, follow_links, bag)
    prepared = prepare(source, name, prior=prior, config=config, overrides=settings or (), preset=preset, seed=seed)
    execute(prepared, output, with_report=report)


def demo(
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="New folder for the results (default: runs/demo-N).")
    ] = None,
    copy: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Only copy the recording into this new folder.")
    ] = None,
) -> None:
    """Localise the bundled recording, print the error table, write a report."""
    recording = example_recording()
    if copy is not None:
        _copy_example(recording, copy, output)
        return
    from touchline.api import prepare

    execute(prepare(recording), output, name="demo")


def _copy_example(recording: Path, target: Path, output: Path | None) -> None:
    if output is not None:
        raise InputError("--output and --copy exclude each other: a copy is not localised")
    check_new_path(target)
    shutil.copytree(recording, target)
    say(f"{target}: the bundled recording; touchline run {target} localises it")


def example_recording() -> Path:
    """The bundled recording: beside the sources in a checkout, inside the package when installed."""
    package = Path(__file__).parents[1]
    for folder in (package / "examples" / EXAMPLE, package.parents[1] / "examples" / EXAMPLE):
        if folder.is_dir():
            return folder
    raise TouchlineError(f"the bundled recording {EXAMPLE} is not beside the package in {package}; install it again")


def parse_pose(text: str) -> Pose:
    """The pose written as X,Y,HEADING (m, m, rad). Raises InputError for anything else."""
    from touchline.geometry import Pose

    return Pose(*numbers(text, "--start", "X,Y,HEADING in m, m, rad", "-3,1.5,0"))


def execute(
    prepared: PreparedRun,
    output: Path | None,
    name: str | None = None,
    with_report: bool = True,
) -> None:
    """Run with a progress bar and print what came out. Raises what ended the run, after its folder is finished."""
    from touchline.evaluation.run_folder import new_folder
    from touchline.sources import ProblemKind

    first = ProblemKind.SENSOR_FILE, ProblemKind.BAG, ProblemKind.TOPIC
    problems = [problem for problem in prepared.source.problems if problem.kind in first]
    for notice in (*problems, *prepared.notices):
        warn(f"warning: {notice}")
    source = prepared.source
    folder = new_folder(output, name or source.name)
    with steps_shown(source.name, len(source), compiles=True) as advance, interruptible() as stop:
        wanted = (lambda summary: True) if with_report else None
        finished, failure = prepared.execute(folder, on_frame=[advance], stop=stop, report=wanted)
    print_run(finished)
    if failure is not None:
        if isinstance(failure, TouchlineError) or os.environ.get(DEBUG_VARIABLE):
            raise failure
        raise TouchlineError(
            f"the run failed after {counted(finished.summary.frames, 'frame')}: {unexpected(failure)} "
            "(touchline --debug run … shows the traceback)"
        ) from failure
    frames = finished.summary.frames
    if finished.summary.ended == "interrupted":
        raise InterruptedRun(f"interrupted: {counted(frames, 'image')} done")
    if not finished.summary.status["tracking"] and finished.summary.unmoved_frames:
        say(_UNMOVED, style="yellow")
    elif not finished.summary.status["tracking"]:
        why = finished.summary.why_not_localised or f"`touchline check {source.path}` may tell why"
        raise TouchlineError(f"none of {counted(frames, 'image')} was localised: {why}")


def print_run(finished: Run) -> None:
    """The error table, rates, problems and where the report is."""
    from touchline.evaluation.report import other_side_text
    from touchline.evaluation.runner import said_text

    summary = finished.summary
    if finished.errors is not None:
        print_errors(finished.errors)
    else:
        say(f"no errors to show: {finished.why_no_errors}")
    _print_speed(summary)
    say(_counts(summary.status) or "no images")
    if summary.mode is not None:
        say(f"mode: {_counts(summary.mode)}")
    doubts = [other] if (other := other_side_text(summary)) else []
    if summary.status["tracking"] and (why := summary.why_not_localised):
        doubts.append(f"most images show nothing: {why}")
    doubts += [said_text(one) for one in summary.said[:_MAX_SAID]]
    if problems := summary.problems.counts:
        kinds = ", ".join(f"{count} × {kind}" for kind, count in problems.items())
        doubts.append(f"problems of the recording: {kinds} (touchline check lists them)")
    say(*doubts, style="yellow")
    say(f"report: {finished.report}" if finished.report.is_file() else f"results: {finished.folder}")


def _counts(counts: dict[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in counts.items() if count)


def _print_speed(summary: RunSummary) -> None:
    """The start, which loads code and may learn colours, apart from the rest."""
    from touchline.evaluation.latency import milliseconds

    latency = summary.latency_ms
    total, left_out = latency.total, latency.first_left_out
    if total.median is None or total.p99 is None:
        return
    most_ms = max(total.max or 0.0, latency.start_max or 0.0)
    words = f"{milliseconds(total.median)} ms median, {milliseconds(total.p99)} ms p99"
    words += f" after the first {left_out}; " if left_out else ", "
    words += f"{milliseconds(most_ms)} ms at most"
    if most_ms == latency.start_max:
        words += f" at the start (code is loaded{', colours are learned' if summary.learns_colours else ''})"
    say(f"{counted(summary.frames, 'image')}, time per image: {words}")
