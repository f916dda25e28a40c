"""Checks of the robot's own sensors: readable, without gaps, alive, and agreeing with each other."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from touchline.camera import is_perspective
from touchline.checks.delay import base_steps
from touchline.checks.findings import Finding, Severity, graded
from touchline.checks.survey import MOTION_COLUMNS, Survey
from touchline.field.association import FieldAssociations
from touchline.geometry import FloatArray, runs_of
from touchline.sources.description import FIELD, finite_number
from touchline.sources.folder import SENSOR_COLUMNS
from touchline.sources.problems import ProblemKind, RecordingProblem
from touchline.types import ProblemCode

_MIN_STUCK_S = 0.5
_MIN_TRAVEL_M = 1.0
_WINDOW_S = 1.0
_STILL_M, _STILL_RAD = 0.0005, math.radians(0.1)
_MIN_STILL_S = 1.0
_NO_COMPASS = "A pose and the one at the other end of the field fit equally well: run with --own-half or --start."
_ENDS_ALIKE = "Tell where the robot starts, --start X,Y,HEADING or --own-half; else each pose is named with its twin."

_ROW_ADVICE = {
    ProblemKind.SENSOR_FILE: "Write it as docs/how-to-recording.md says; a run goes on without this sensor.",
    ProblemKind.BAG: "Let the recorder finish writing before it is switched off.",
    ProblemKind.TOPIC: "Name what is meant: --topic, --camera, --base; a run goes on with what was chosen.",
    ProblemKind.EMPTY_COLUMN: "Find out why the sensor writes nothing.",
    ProblemKind.BROKEN_ROW: "Mend or delete the lines; they are left out.",
    ProblemKind.NOT_A_NUMBER: "Find out why the sensor writes this; the rows are left out.",
    ProblemKind.TIME_ORDER: "Two clocks, or a clock that was set while recording? The rows are left out.",
    ProblemKind.SENSOR_GAP: "Look for a lost connection; what the robot did meanwhile is unknown.",
    ProblemKind.TRUTH: "Evaluation takes the nearest pose in time.",
    ProblemKind.SEQUENCE: "Correct sequence.yaml.",
}


class Agreement(NamedTuple):
    """How a travel compares with another: length, direction, and correlation (0..1) that this explains."""

    scale: float
    angle_rad: float
    correlation: float


def check_rows(survey: Survey) -> Iterator[Finding]:
    """What the reading of the files reported, one finding for each kind and file."""
    problems = survey.recording.problems
    for kind, advice in _ROW_ADVICE.items():
        severity = Severity.ERROR if kind is ProblemKind.SENSOR_FILE else Severity.WARNING
        firsts: dict[str, RecordingProblem] = {}
        for problem in problems:
            if problem.kind is kind:
                firsts.setdefault(problem.file, problem)
        for file, first in firsts.items():
            count = problems.file_counts[kind, file]
            more = "" if count == 1 else f" (and {count - 1} more like it)"
            yield Finding("rows", severity, first.place, f"{first.message.partition(': ')[2]}{more}", advice)
    if not any(problems.counts[kind] for kind in _ROW_ADVICE):
        yield Finding("rows", Severity.OK, "*.csv", "every row can be read, times run forwards, no sensor gap")


def check_presence(survey: Survey) -> Iterator[Finding]:
    """Sensors that are missing, or whose times share nothing with the images'."""
    counts = survey.recording.problems.file_counts
    for file, columns in SENSOR_COLUMNS.items():
        seen = {name: bool(np.isfinite(survey.column(name)).any()) for name in columns}
        if not (survey.recording.folder / file).exists():
            advice = "Without it a pose between images is a guess." if file == "odometry.csv" else ""
            if file == "imu.csv":
                yield from _no_compass(survey, "is not there: no compass, no gyro")
            else:
                yield Finding("sensors", Severity.NOTE, file, "is not there", advice)
        elif counts[ProblemKind.SENSOR_FILE, file]:
            continue  # the check of the rows says so
        elif not any(seen.values()):
            what = "no sample lies between the first and the last image"
            yield Finding("sensors", Severity.ERROR, file, what, "Use one clock for images and sensors.")
        elif file == "imu.csv" and not seen["yaw"]:
            if (imu := survey.recording.problems.topics.get(file)) is not None:
                advice = f"If it is the heading on the field: --topic compass={imu}"
                yield Finding("compass", Severity.NOTE, imu, "its yaw is not used: most robots sum it up", advice)
            yield from _no_compass(survey, "column 'yaw' is empty: no compass")


def _no_compass(survey: Survey, what: str) -> Iterator[Finding]:
    """What a recording without a compass needs; a humanoid's system asks none: only where its ends look alike."""
    recording = survey.recording
    if not is_perspective(recording.camera_kind) and (not recording.has_observations or survey.seen["point"]):
        yield Finding("compass", Severity.WARNING, "imu.csv", what, _NO_COMPASS)
        return
    field = survey.field
    if field is not None and field.is_symmetric and not FieldAssociations(field).tell_ends_apart:
        what = "nothing tells both ends of the field apart: no goal or pole has a colour of its own end"
        yield Finding("ends", Severity.NOTE, FIELD, what, _ENDS_ALIKE, ProblemCode.END_UNDECIDED)


def check_stuck(survey: Survey) -> Iterator[Finding]:
    """Values that stay the same while another sensor sees the robot move."""
    turned = {name: survey.turns(name) for name in ("theta", "yaw")}
    turned["gz"] = survey.turn_rad[1:]
    travelled = {"x": _travel(survey, "x", "y"), "a": _travel(survey, "a", "b")}
    for names, file, own, others, limit, unit in (
        (("theta",), "odometry.csv", "theta", turned, math.radians(15.0), "rad"),
        (("yaw",), "imu.csv", "yaw", turned, math.radians(15.0), "rad"),
        (("gz",), "imu.csv", "gz", turned, math.radians(15.0), "rad"),
        (("x", "y"), "odometry.csv", "x", travelled, 0.3, "m"),
        (("a", "b"), "wheels.csv", "a", travelled, 0.3, "m"),
    ):
        still = ~survey.changed[1:, [MOTION_COLUMNS.index(name) for name in names]].any(axis=1)
        still &= np.isfinite(survey.column(own)[1:])
        for start, stop in runs_of(still):
            seconds = survey.stamps_s[stop] - survey.stamps_s[start]
            seen = float(np.nansum(others[own][start:stop]))  # a gyro may well be constant, in a steady turn
            witnesses = [steps[start:stop] for name, steps in others.items() if name != own]
            moved = [abs(np.nansum(steps) - seen) for steps in witnesses if np.isfinite(steps).all()]
            if seconds >= _MIN_STUCK_S and max(moved, default=0.0) > limit:
                what = (
                    f"{' and '.join(names)} stay the same from t = {survey.stamps_s[start]:.2f} s for {seconds:.1f} s, "
                    f"while another sensor sees {max(moved):.2f} {unit} of motion"
                )
                code = ProblemCode.ODOMETRY_FROZEN if file == "odometry.csv" else ""
                yield Finding("stuck", Severity.WARNING, file, what, "Look at the sensor's plug and driver.", code)
                break


def check_wheels(survey: Survey) -> Iterator[Finding]:
    """Odometry against the measuring wheels."""
    directions = survey.recording.sequence.get("wheels")
    if not np.isfinite(survey.column("a")).any():
        return
    named = [directions.get(key) if isinstance(directions, dict) else None for key in ("a_dir_rad", "b_dir_rad")]
    angles = [angle for value in named if (angle := finite_number(value)) is not None]
    if len(angles) < 2:
        advice = "Write wheels: {a_dir_rad: …, b_dir_rad: …}; without it the wheels are of no use."
        yield Finding("wheels", Severity.WARNING, "sequence.yaml", "names no rolling directions of the wheels", advice)
        return
    matrix = np.array([[math.cos(angle), math.sin(angle)] for angle in angles])
    if abs(np.linalg.det(matrix)) < 0.1:
        what = "a_dir_rad and b_dir_rad are nearly parallel: sideways motion can't be measured"
        yield Finding("wheels", Severity.ERROR, "sequence.yaml", what, "Correct the rolling directions.")
        return
    wheels = np.diff(np.column_stack((survey.column("a"), survey.column("b"))), axis=0) @ np.linalg.inv(matrix).T
    subject = ("wheels", "wheels.csv", "the measuring wheels", "Check the wheels' directions and units.")
    yield from compare_travel(survey, subject, wheels)


def check_gyro_bias(survey: Survey) -> Iterator[Finding]:
    """What the gyro says while nothing moves."""
    steps, turn = np.diff(survey.stamps_s), survey.turn_rad[1:]
    moved = [_travel(survey, "x", "y"), _travel(survey, "a", "b")]
    known = np.isfinite(moved).any(axis=0) & np.isfinite(turn)
    still = known & (np.nan_to_num(moved).max(axis=0) < _STILL_M)
    still &= np.abs(np.nan_to_num(survey.turns("theta"))) < _STILL_RAD
    seconds = float(steps[still].sum())
    if not known.any():
        return
    if seconds < _MIN_STILL_S:
        what = "the gyro's bias is not measured: the robot hardly ever stands still"
        yield Finding("gyro bias", Severity.NOTE, "imu.csv", what, "Record two seconds at rest to have it measured.")
        return
    bias = math.degrees(float(turn[still].sum()) / seconds)
    what = f"gz is {bias:+.2f}°/s while the robot stands ({seconds:.1f} s in all)"
    case = abs(bias) > 2.0, Severity.WARNING, "Let the gyro settle and calibrate it at rest."
    yield graded("gyro bias", "imu.csv", what, case)


def compare_travel(survey: Survey, subject: tuple[str, str, str, str], steps: FloatArray) -> Iterator[Finding]:
    """Findings about a travel (N - 1, 2) from image to image in the base frame (m), compared with odometry's.

    subject: name of the check, file, what measured it, and advice.
    """
    check, file, name, advice = subject
    own, reference = (over_windows(values, survey.stamps_s) for values in (steps, _base_steps(survey)))
    good = np.isfinite(own) & np.isfinite(reference)
    a, b = reference[good], own[good]
    if np.abs(a).sum() < _MIN_TRAVEL_M and np.abs(b).sum() < _MIN_TRAVEL_M:
        what = f"odometry is not compared with {name}: the robot travels less than {_MIN_TRAVEL_M:g} m"
        yield Finding(check, Severity.NOTE, file, what, "Record a few metres of driving to have it compared.")
        return
    found, mirrored = _agreement(a, b), _agreement(np.conj(a), b)
    what = (
        f"{name} measure {found.scale:.3f} × the way of odometry, turned by {math.degrees(found.angle_rad):+.1f}° "
        f"(correlation {found.correlation:.2f})"
    )
    if mirrored.correlation > max(found.correlation + 0.2, 0.8):
        what = f"{name} and odometry are mirror images of each other (correlation {mirrored.correlation:.2f})"
        yield Finding(check, Severity.ERROR, file, what, f"One of them takes y to the right. {advice}")
        return
    turned = abs(found.angle_rad)
    poor = found.correlation < 0.8 or turned > math.radians(20.0) or not 0.7 < found.scale < 1.4
    off = abs(found.scale - 1.0) > 0.08 or turned > math.radians(6.0)
    yield graded(check, file, what, (poor, Severity.ERROR, advice), (off, Severity.WARNING, advice))


def over_windows(steps: FloatArray, stamps_s: FloatArray) -> npt.NDArray[np.complex128]:
    """Travel (N - 1, 2) summed up over about a second each (W,), x + iy; NaN where a step is.

    Noise that grows with the square root of the way would otherwise pass for a difference of scale.
    """
    width = max(round(_WINDOW_S / float(np.median(np.diff(stamps_s)))), 1) if len(steps) else 1
    count = len(steps) // width
    local = steps[: count * width, 0] + 1j * steps[: count * width, 1]
    return np.asarray(local.reshape(count, width).sum(axis=1), dtype=np.complex128)


def _base_steps(survey: Survey) -> FloatArray:
    """(N - 1, 2) odometry's travel between images in the base frame (m); NaN where it turns by more than 0.3 rad."""
    steps = base_steps(np.column_stack([survey.column(name) for name in ("x", "y", "theta")]))[:, :2]
    steps[~(np.abs(survey.turns("theta")) < 0.3)] = np.nan
    return steps


def _agreement(a: npt.NDArray[np.complex128], b: npt.NDArray[np.complex128]) -> Agreement:
    """b against a, the tenth of the steps that fits worst left out (slips)."""
    for _ in range(2):
        power = float(np.sum(np.abs(a) ** 2))
        ratio = complex(np.sum(b * np.conj(a))) / power if power > 0.0 else 0j
        worst = np.abs(b - ratio * a)
        keep = worst <= np.quantile(worst, 0.9)
        a_kept, b_kept = a[keep], b[keep]
        norm = math.sqrt(float(np.sum(np.abs(a_kept) ** 2) * np.sum(np.abs(b_kept) ** 2)))
        if norm == 0.0:
            break
        correlation = abs(complex(np.sum(b_kept * np.conj(a_kept)))) / norm
        a, b = a_kept, b_kept
    else:
        return Agreement(abs(ratio), math.atan2(ratio.imag, ratio.real), correlation)
    return Agreement(0.0, 0.0, 0.0)


def _travel(survey: Survey, first: str, second: str) -> FloatArray:
    return np.hypot(np.diff(survey.column(first)), np.diff(survey.column(second)))
