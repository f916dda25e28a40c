"""A check by the monitor of our own system: which sensor contradicts the others, or the field, while it runs."""

import re
from collections.abc import Iterator
from itertools import islice

from touchline.checks.findings import Finding, Severity, too_few
from touchline.checks.survey import Survey
from touchline.errors import InputError
from touchline.evaluation.runner import Said, SaidLog, robot_setup
from touchline.messages import counted, listed, without_numbers
from touchline.sources import Recording
from touchline.sources.description import CAMERA, FIELD
from touchline.systems import DEFAULT_SYSTEM, open_system
from touchline.systems.ordered import OrderedSystem
from touchline.types import Status

_MAX_FRAMES = 2_000  # some ten seconds of work
_MIN_FRAMES = 25
_SPOILS = 0.1  # of the images: a fault in more of them is an error
_NO_FAULT = re.compile(r"undecided which end|: corrected$")  # what a team can't mend, and what another check measures
_FILES = (  # what a phrase is about -> where to look
    (re.compile(r"^odometry|^wheels"), "odometry.csv"),
    (re.compile(r"^(the )?images?\b"), "images.csv"),
    (re.compile(r"^(the )?(gyro|compass)"), "imu.csv"),
    (re.compile(r"camera_pose|^the head"), "camera_pose.csv"),
    (re.compile(r"^the camera"), CAMERA),
    (re.compile(r"field|carpet|on no line"), FIELD),
)
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
        for phrase in estimate.problems:
            if not _NO_FAULT.search(phrase):
                problems.add(phrase, estimate.stamp_ns)
        unnamed = [] if estimate.problems else [name for name, value in estimate.statistics.items() if value >= 1.0]
        if unnamed:
            problems.add(f"sensors and field contradict each other, by {listed(unnamed)}", estimate.stamp_ns)
        survey.progress()
    if looked < _MIN_FRAMES:
        yield too_few("consistency", _OTHER_FILE, "whether the sensors agree", looked, _MIN_FRAMES)
        return
    yield from _findings(problems, looked, survey)
    if not problems.stretches and tracked:
        what = f"sensors, images and field agree in {counted(looked, 'image')}, tracked in {tracked}"
        yield Finding("consistency", Severity.OK, _OTHER_FILE, what)


def _findings(problems: SaidLog, looked: int, survey: Survey) -> Iterator[Finding]:
    """One for each phrase, its stretches together."""
    alike: dict[str, list[Said]] = {}
    for one in problems.stretches:
        alike.setdefault(without_numbers(one.what), []).append(one)
    for stretches in alike.values():
        what, images = stretches[-1].what, sum(one.images for one in stretches)
        since_s = stretches[0].first_ns / 1e9 - survey.stamps_s[0]
        where = next((file for pattern, file in _FILES if pattern.search(what)), _OTHER_FILE)
        text = f"{what} (in {images} of {counted(looked, 'image')}, first {since_s:.1f} s after the beginning)"
        severity = Severity.ERROR if images > _SPOILS * looked else Severity.WARNING
        yield Finding("consistency", severity, where, text, _ADVICE)
