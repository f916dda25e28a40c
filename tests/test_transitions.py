"""Line points by colour transitions, the papers' detector, beside that by profiles."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from touchline.geometry import FloatArray
from touchline.perception.colour import GREEN, WHITE
from touchline.perception.line_points import LinePointDetector, LinePointPaper, LinePointSettings
from touchline.perception.scan_lines import ScanLines, build_scan_lines
from touchline.perception.transitions import find_transitions
from touchline.sources import open_source

SHORT = Path(__file__).parents[1] / "examples" / "omni_msl_track_short"
OTHER = 0


@cache
def detector(kind: str) -> LinePointDetector:
    recording = open_source(SHORT)
    paper = LinePointPaper(detector=kind, more_scan_lines=False)  # type: ignore[arg-type]
    made = LinePointDetector(recording.camera, LinePointSettings(paper=paper), recording.field.line_width)
    made.learn([frame.image for frame, _ in zip(recording, range(3), strict=False) if frame.image is not None])
    return made


def off_lines_m(kind: str) -> FloatArray:
    """How far the points of a rendered image that are within 6 m lie from the field's lines."""
    recording = open_source(SHORT)
    frame = next(iter(recording))
    assert frame.image is not None
    assert recording.truth is not None
    points = detector(kind).detect(frame.image).positions_m
    points = points[np.hypot(*points.T) < 6.0]
    pose = recording.truth.nearest(frame.stamp_ns)
    cosine, sine = np.cos(pose.heading), np.sin(pose.heading)
    on_field = points @ np.array([[cosine, sine], [-sine, cosine]]) + (pose.x, pose.y)
    return np.asarray(recording.field.line_distances(on_field))


def test_it_finds_the_lines_of_a_rendered_image_less_precisely_than_profiles() -> None:
    found, profiles = off_lines_m("transitions"), off_lines_m("profiles")
    assert len(found) > 0.85 * len(profiles)
    assert np.mean(found < 0.15) > 0.9
    assert np.median(profiles) < np.median(found) < 0.02


def test_both_learn_the_same_colours() -> None:
    ours, papers = detector("profiles").colours, detector("transitions").colours
    assert ours is not None
    assert papers is not None
    assert np.array_equal(ours.green, papers.green)
    np.testing.assert_allclose(ours.white, papers.white, atol=2.0)  # of lines that each sees at its own samples
    assert np.mean(ours.table == papers.table) > 0.998


def lines() -> ScanLines:
    camera = detector("transitions").camera
    return build_scan_lines(camera, 8, 0, 60.0, 160.0, fill_from=1.0)


def painted(scan_lines: ScanLines, path: int, runs: dict[int, slice]) -> np.ndarray:
    """Classes of all samples: carpet but for runs of other classes on one path."""
    classes = np.full(len(scan_lines.samples), GREEN, dtype=np.uint8)
    for kind, run in runs.items():
        classes[scan_lines.starts[path] + run.start : scan_lines.starts[path] + run.stop] = kind
    return classes


@pytest.mark.parametrize(
    ("runs", "count"),
    [
        ({WHITE: slice(40, 45)}, 1),
        ({OTHER: slice(38, 47), WHITE: slice(40, 45)}, 1),  # blurred edges
        ({OTHER: slice(30, 55), WHITE: slice(40, 45)}, 0),  # no green beside it
        ({WHITE: slice(0, 5)}, 0),  # nothing before it
        ({WHITE: slice(95, 100)}, 0),  # nor behind
        ({WHITE: slice(20, 82)}, 0),  # longer than any line
    ],
)
def test_green_is_wanted_on_both_sides_of_a_short_run_of_white(runs: dict[int, slice], count: int) -> None:
    scan_lines, camera = lines(), detector("transitions").camera
    found = find_transitions(scan_lines, painted(scan_lines, 4, runs), camera, 60)
    assert len(found) == count
    if count:
        middle = scan_lines.samples[scan_lines.starts[4] + 42]
        assert found[0, 2:4] == pytest.approx(middle)
        assert found[0, :2] == pytest.approx(camera.ground_from_image(middle[np.newaxis])[0])
        assert found[0, 6] == 4


def test_nothing_is_found_without_colours() -> None:
    scan_lines, camera = lines(), detector("transitions").camera
    for kind in (OTHER, GREEN, WHITE):
        assert len(find_transitions(scan_lines, np.full(len(scan_lines.samples), kind, np.uint8), camera, 60)) == 0
