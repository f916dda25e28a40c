"""A check by the monitor of our own system: which sensor contradicts the others, or the field, while it runs."""

from collections.abc import Iterator
from itertools import islice

from touchline.checks.findings import Finding, Severity, too_few
from touchline.checks.survey import Survey
from touchline.errors import InputError
from touchline.evaluation.runner import Said, SaidLog, robot_setup
from touchline.messages import counted, listed
from touchline.sources import Recording
from touchline.sources.description import CAMERA, FIELD
from touchline.systems import DEFAULT_SYSTEM, open_system
from touchline.systems.ordered import OrderedSystem
from touchline.types import Problem, ProblemCode, Status

_MAX_FRAMES = 2_000  # some ten seconds of work
_MIN_FRAMES = 25
_SPOILS = 0.1  # of the images: a fault in more of them is an error
# what a team can't mend, and what another check measures
_NO_FAULT = ProblemCode.END_UNDECIDED, ProblemCode.STAMPS_LATE_CORRECTED
# what is at fault, or a code -> where to look
_FILES = {"odometry": "odometry.csv", ProblemCode.END_BY_COMPASS: "imu.csv", "camera": CAMERA}
_FILES |= dict.fromkeys(("field", "end", "sensors"), FIELD)
_OTHER_FILE = "images.csv"
_ADVICE = "Mend it before a match; docs/integrity.md says how each statistic tells it."


def images_to_run(recording: Recording) -> int:
    """How many images the check looks at, for a progress bar."""
    return min(len(recording), _MAX_FRAMES)


def check_consistency(survey: Survey) -> Iterator[Finding]:
    """Run our own system over the recording and tell every fault that it names, with its images."""
    recording = survey.recording
    if survey.field is None or recording.linear:
        return
    try:
        system = OrderedSystem(open_system(DEFAULT_SYSTEM, robot_setup(recording)))
    except InputError:
        return  # the camera's own check says so
    problems, looked, tracked = SaidLog(), 0, 0
    for frame in islice(recording.again(), _MAX_FRAMES):
        estimate = system.step(frame)
        looked, tracked = looked + 1, tracked + (estimate.status is Status.TRACKING)
        for problem in estimate.problems:
            if problem.code not in _NO_FAULT:
                problems.add(problem, estimate.stamp_ns)
        unnamed = [] if estimate.problems else [name for name, value in estimate.statistics.items() if value >= 1.0]
        if unnamed:
            sentence = f"sensors and field contradict each other, by {listed(unnamed)}"
            problems.add(Problem(ProblemCode.SENSORS_DISAGREE, sentence), estimate.stamp_ns)
        survey.progress()
    if looked < _MIN_FRAMES:
        yield too_few("consistency", _OTHER_FILE, "whether the sensors agree", looked, _MIN_FRAMES)
        return
    yield from _findings(problems, looked, survey)
    if not problems.stretches and tracked:
        what = f"sensors, images and field agree in {counted(looked, 'image')}, tracked in {tracked}"
        yield Finding("consistency", Severity.OK, _OTHER_FILE, what)


def _findings(problems: SaidLog, looked: int, survey: Survey) -> Iterator[Finding]:
    """One for each code, its stretches together."""
    alike: dict[str, list[Said]] = {}
    for one in problems.stretches:
        alike.setdefault(one.problem.code, []).append(one)
    for code, stretches in alike.items():
        problem, images = stretches[-1].problem, sum(one.images for one in stretches)
        since_s = stretches[0].first_ns / 1e9 - survey.stamps_s[0]
        where = _FILES.get(code, _FILES.get(problem.at_fault, _OTHER_FILE))
        text = f"{problem} (in {images} of {counted(looked, 'image')}, first {since_s:.1f} s after the beginning)"
        severity = Severity.ERROR if images > _SPOILS * looked else Severity.WARNING
        yield Finding("consistency", severity, where, text, _ADVICE, code)
