"""Everything that is odd about a recording or its calibration, before a match finds out.

A check is a function from a `Survey` to findings. Another one joins by standing in CHECKS.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from touchline.checks.features import check_features
from touchline.checks.findings import Finding, Severity
from touchline.checks.heading import check_compass, check_compass_lag, check_turns
from touchline.checks.images import (
    check_focus,
    check_frozen,
    check_image_times,
    check_light,
    check_observations,
    check_readable,
)
from touchline.checks.late_odometry import check_late_odometry
from touchline.checks.lines import check_lines
from touchline.checks.projection import check_projection, check_view
from touchline.checks.sensors import check_gyro_bias, check_presence, check_rows, check_stuck, check_wheels
from touchline.checks.setup import check_camera, check_field, check_handedness, check_mirror, check_truth
from touchline.checks.slips import check_slips
from touchline.checks.survey import Survey, take_survey
from touchline.sources.folder import Recording

Check = Callable[[Survey], Iterable[Finding]]

CHECKS: list[Check] = [
    check_slips,
    check_readable,
    check_observations,
    check_image_times,
    check_light,
    check_focus,
    check_frozen,
    check_rows,
    check_presence,
    check_stuck,
    check_wheels,
    check_turns,
    check_gyro_bias,
    check_compass_lag,
    check_compass,
    check_camera,
    check_view,
    check_mirror,
    check_handedness,
    check_field,
    check_truth,
    check_lines,
    check_features,
    check_late_odometry,
    check_projection,
]

_ORDER = [Severity.ERROR, Severity.WARNING, Severity.NOTE, Severity.OK]


def check_recording(source: Recording | str | Path, progress: Callable[[], None] | None = None) -> list[Finding]:
    """Read all of a recording and say what is odd about it, the worst first.

    progress: called after every image. Raises InputError if it can't be read at all.
    """
    recording = source if isinstance(source, Recording) else Recording(Path(source))
    survey = take_survey(recording, progress)
    findings = [finding for check in CHECKS for finding in check(survey)]
    return sorted(findings, key=lambda finding: _ORDER.index(finding.severity))
