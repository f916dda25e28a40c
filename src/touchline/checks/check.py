"""Everything that is odd about a recording or its calibration, before a match finds out.

A check is a function from a `Survey` to findings. Another one joins by standing in CHECKS.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

from touchline.checks import features, heading, images, late_odometry, lines, projection, sensors, setup, slips
from touchline.checks.consistency import check_consistency, images_to_run
from touchline.checks.findings import Finding, Severity
from touchline.checks.survey import Survey, take_survey
from touchline.sources.folder import Recording

Check = Callable[[Survey], Iterable[Finding]]

CHECKS: list[Check] = [
    lambda survey: slips.find_slips(survey.recording),
    images.check_readable,
    images.check_observations,
    images.check_image_times,
    images.check_light,
    images.check_focus,
    images.check_frozen,
    sensors.check_rows,
    sensors.check_presence,
    sensors.check_stuck,
    sensors.check_wheels,
    heading.check_turns,
    sensors.check_gyro_bias,
    heading.check_compass_lag,
    heading.check_compass,
    setup.check_camera,
    projection.check_view,
    setup.check_mirror,
    setup.check_handedness,
    setup.check_field,
    setup.check_truth,
    lines.check_lines,
    features.check_features,
    late_odometry.check_late_odometry,
    projection.check_projection,
    check_consistency,
]

_ORDER = [Severity.ERROR, Severity.WARNING, Severity.NOTE, Severity.OK]


def steps(source: Recording) -> int:
    """How often `check_recording` calls its `progress` at most."""
    return len(source) + images_to_run(source)


def check_recording(source: Recording | str | Path, progress: Callable[[], None] = lambda: None) -> list[Finding]:
    """Read all of a recording and say what is odd about it, the worst first.

    progress: called after every image, `steps` times in all. Raises InputError if it can't be read at all.
    """
    recording = source if isinstance(source, Recording) else Recording(Path(source))
    survey = take_survey(recording, progress)
    topics = recording.problems.topics
    found = [finding for check in CHECKS for finding in check(survey)]
    findings = [replace(finding, where=topics.get(finding.where, finding.where)) for finding in found]
    return sorted(findings, key=lambda finding: _ORDER.index(finding.severity))
