"""Checks of the images: readable, evenly timed, bright, sharp, alive."""

from collections.abc import Iterator

import numpy as np

from touchline.checks.findings import Finding, Severity
from touchline.checks.survey import Survey
from touchline.messages import frames_in_words
from touchline.sources.folder import IMAGE_LIST
from touchline.sources.observations import OBSERVATIONS
from touchline.sources.problems import ProblemKind
from touchline.types import CrossingKind, LandmarkKind, ProblemCode

SPOILED_SHARE = 0.2  # of the images; above it a warning is an error
DARK_MEAN = 40.0
SATURATED_SHARE = 0.15
BLURRED_SHARPNESS = 0.4
LATE_STEP = 1.5  # of the median step between images

_FEATURES = (*(kind.value for kind in CrossingKind), *(kind.value for kind in LandmarkKind), "line")
_IMAGE_ADVICE = {
    ProblemKind.MISSING_IMAGE: "Copy the missing files, or remove their rows.",
    ProblemKind.BROKEN_IMAGE: "Copy these files again; the recorder may have been stopped while writing.",
    ProblemKind.IMAGE_SIZE: "Record at the size that camera.yaml was calibrated for.",
    ProblemKind.LINEAR_IMAGE: "Apply exposure and gain first (docs/how-to-recording.md); it can't be run as it is.",
}


def check_readable(survey: Survey) -> Iterator[Finding]:
    """Missing, broken and unusable images."""
    problems = survey.recording.problems
    total = len(survey.recording)
    if not survey.recording.has_images:
        return
    for kind, advice in _IMAGE_ADVICE.items():
        count = problems.counts[kind]
        if not count:
            continue
        severity = Severity.ERROR if count > SPOILED_SHARE * total else Severity.WARNING
        first = next(problem for problem in problems if problem.kind is kind)
        yield Finding("images", severity, IMAGE_LIST, f"{count} of {total} images: {first.message}", advice)
    if not any(problems.counts[kind] for kind in _IMAGE_ADVICE):
        yield Finding("images", Severity.OK, IMAGE_LIST, f"all {total} images can be decoded")


def check_observations(survey: Survey) -> Iterator[Finding]:
    """What the robot's own detector found."""
    if not survey.recording.has_observations:
        return
    kinds = {kind: count for kind, count in survey.seen.items() if kind != "nothing"}
    if not kinds:
        advice = "Is the detector running? Rows of kind 'none' alone say that it saw nothing."
        yield Finding("observations", Severity.ERROR, OBSERVATIONS, "nothing was found in any image", advice)
        return
    what = ", ".join(f"{count} × {kind}" for kind, count in kinds.items())
    blind, total = survey.seen["nothing"], len(survey.recording)
    what += f" in {total} images" + (f", nothing in {blind} of them" if blind else "")
    without_points = f"no line points; {what}"
    if kinds.get("point"):
        yield Finding("observations", Severity.OK, OBSERVATIONS, what)
    elif any(kinds.get(kind) for kind in _FEATURES):
        advice = "nimbro-lines takes them; for the other systems write points along the lines, too."
        yield Finding("observations", Severity.NOTE, OBSERVATIONS, without_points, advice)
    else:
        advice = "No system finds a pose by these: write line points, or lines, crossings and posts."
        yield Finding("observations", Severity.ERROR, OBSERVATIONS, without_points, advice)


def check_image_times(survey: Survey) -> Iterator[Finding]:
    """Whether images come as evenly and as often as sequence.yaml says."""
    steps = np.diff(survey.stamps_s)
    if len(steps) == 0:
        yield Finding("image times", Severity.NOTE, survey.recording.frame_list, "holds a single image")
        return
    median, nominal = float(np.median(steps)), 1.0 / survey.recording.rate_hz
    late = (np.flatnonzero(steps > LATE_STEP * median) + 1).tolist()
    what, advice = f"{1.0 / median:.3g} images a second (median)", ""
    if abs(median / nominal - 1.0) > 0.1:
        what += f", where sequence.yaml says rate_hz {survey.recording.rate_hz:g}"
        advice = "Correct rate_hz, or look for lost images."
    if late:
        what += f"; late (up to {steps.max():.3g} s after the one before): {frames_in_words(late)}"
        advice = "Odometry has to carry these gaps; look for lost images if they are not meant."
    yield Finding("image times", Severity.NOTE if advice else Severity.OK, survey.recording.frame_list, what, advice)


def check_light(survey: Survey) -> Iterator[Finding]:
    """Black, dark and overexposed images."""
    seen = np.isfinite(survey.brightness)
    if not seen.any():
        return
    covered = "The camera was covered or not running; the estimate rests on odometry there."
    dark, bright = (survey.brightness < DARK_MEAN) & ~survey.black, survey.saturated > SATURATED_SHARE
    odd = False
    for what, mask, severity, advice in (
        ("black", survey.black, _severity(int(survey.black.sum()), survey), covered),
        (f"dark (mean below {DARK_MEAN:g} of 255)", dark, Severity.WARNING, "Raise exposure or gain."),
        (f"overexposed (over {SATURATED_SHARE:.0%} saturated)", bright, Severity.WARNING,
         "Lower exposure or gain: lines drown in white."),
    ):  # fmt: skip
        if frames := np.flatnonzero(mask).tolist():
            odd = True
            yield Finding("light", severity, IMAGE_LIST, f"{len(frames)} {what}: {frames_in_words(frames)}", advice)
    if not odd:
        lowest, highest = np.min(survey.brightness[seen]), np.max(survey.brightness[seen])
        yield Finding("light", Severity.OK, IMAGE_LIST, f"mean brightness {lowest:.0f} to {highest:.0f} of 255")


def check_focus(survey: Survey) -> Iterator[Finding]:
    """Blurred images: all of them (focus, dirt) or some (motion)."""
    judged = np.isfinite(survey.sharpness)
    if not judged.any():
        return
    median = float(np.median(survey.sharpness[judged]))
    blurred = np.flatnonzero(survey.sharpness < BLURRED_SHARPNESS).tolist()
    if median < BLURRED_SHARPNESS:
        what = f"the images are blurred by about a pixel or more (edge ratio {median:.2f}, in focus 0.5 to 1)"
        yield Finding("focus", Severity.WARNING, IMAGE_LIST, what, "Focus the lens, wipe lens and mirror.")
    elif blurred:
        what = f"{len(blurred)} blurred: {frames_in_words(blurred)}"
        yield Finding("focus", Severity.NOTE, IMAGE_LIST, what, "Motion blur: a shorter exposure helps.")
    else:
        yield Finding("focus", Severity.OK, IMAGE_LIST, f"sharp (edge ratio {median:.2f}, blurred below 0.4)")


def check_frozen(survey: Survey) -> Iterator[Finding]:
    """Images that repeat the one before: no camera's noise does that."""
    repeated = np.flatnonzero(survey.frozen & ~survey.black).tolist()
    if repeated:
        what = f"{len(repeated)} repeat the image before: {frames_in_words(repeated)}"
        advice = "The camera or the recorder hung; what these images show is older than their time stamp."
        severity = _severity(len(repeated), survey)
        yield Finding("frozen", severity, IMAGE_LIST, what, advice, ProblemCode.IMAGES_REPEAT)


def _severity(count: int, survey: Survey) -> Severity:
    return Severity.ERROR if count > SPOILED_SHARE * len(survey.recording) else Severity.WARNING
