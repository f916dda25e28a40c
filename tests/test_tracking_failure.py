"""Detection of wrong localization, and the correction of the compass."""

from __future__ import annotations

import math

import pytest

from touchline.published.nubot.compass_correction import CompassCorrection
from touchline.published.nubot.failure import FailureDetector, FailurePaper, FailureSettings

PAPERS_RULE = FailureSettings(paper=FailurePaper(single_criterion_failure=False))

GOOD, POOR, AWFUL = 0.05, 0.3, 0.5
STRAIGHT, ASTRAY = 0.05, 0.6


def judged(detector: FailureDetector, *frames: tuple[int, float, float | None]) -> list[bool]:
    return [detector.update(*frame) for frame in frames]


def test_five_frames_far_off_in_deviation_and_heading_mean_failure() -> None:
    assert judged(FailureDetector(), *[(60, POOR, ASTRAY)] * 6) == [False, False, False, False, True, True]


@pytest.mark.parametrize("frame", [(60, POOR, STRAIGHT), (60, GOOD, ASTRAY), (60, POOR, None), (60, GOOD, None)])
def test_one_of_both_alone_is_no_failure(frame: tuple[int, float, float | None]) -> None:
    assert not any(judged(FailureDetector(), *[frame] * 20))


def test_one_good_frame_starts_the_count_anew() -> None:
    frames = [(60, POOR, ASTRAY)] * 4 + [(60, GOOD, STRAIGHT)] + [(60, POOR, -ASTRAY)] * 4
    assert not any(judged(FailureDetector(), *frames))


def test_a_very_large_deviation_needs_no_compass() -> None:
    assert judged(FailureDetector(), *[(60, AWFUL, STRAIGHT)] * 5)[-1]
    assert judged(FailureDetector(), *[(60, AWFUL, None)] * 5)[-1]


def test_frames_without_usable_points_mean_failure_by_themselves() -> None:
    assert judged(FailureDetector(), (3, math.nan, None), (0, math.nan, STRAIGHT)) == [False, True]


def test_a_second_without_odometry_means_failure_by_itself() -> None:
    assert FailureDetector().update(60, GOOD, STRAIGHT, missing_s=1.1)
    assert not FailureDetector().update(60, GOOD, STRAIGHT, missing_s=0.9)
    assert not FailureDetector(PAPERS_RULE).update(60, GOOD, STRAIGHT, missing_s=9.0)


def suspicions(detector: FailureDetector, *frames: tuple[int, float, float | None]) -> list[int]:
    """In which of the frames it is time to look for a better place."""
    found = []
    for k, frame in enumerate(frames):
        detector.update(*frame)
        found += [k] * detector.suspicious
    return found


def test_a_suspect_deviation_calls_for_a_second_opinion() -> None:
    assert suspicions(FailureDetector(), *[(60, 0.2, STRAIGHT)] * 12) == [4, 9]
    assert suspicions(FailureDetector(), *[(60, 0.2, None)] * 4, (60, GOOD, None), *[(60, 0.2, None)] * 4) == []
    assert suspicions(FailureDetector(PAPERS_RULE), *[(60, 0.2, STRAIGHT)] * 12) == []


def test_after_a_reset_the_count_starts_anew() -> None:
    detector = FailureDetector()
    judged(detector, *[(60, POOR, ASTRAY)] * 4)
    detector.reset()
    assert not any(judged(detector, *[(60, POOR, ASTRAY)] * 4))
    judged(detector, (0, math.nan, None))
    detector.reset()
    assert not detector.update(0, math.nan, None)


def test_the_compass_is_corrected_after_five_good_frames() -> None:
    one = CompassCorrection()
    corrected = [one.update(GOOD, 1.0, 0.9) for _ in range(4)]
    assert corrected == [False] * 4
    assert one.offset_rad == 0.0
    assert one.update(GOOD, 1.0, 0.9)
    assert one.offset_rad == pytest.approx(0.2 * 0.1)


def test_a_poor_frame_or_a_gap_starts_the_count_anew() -> None:
    one = CompassCorrection()
    for interruption in (lambda: one.update(POOR, 1.0, 0.5), one.interrupt):
        for _ in range(4):
            assert not one.update(GOOD, 1.0, 0.9)
        interruption()
    assert one.offset_rad == 0.0


def test_half_a_turn_from_the_compass_is_bad() -> None:
    """At the other end of a symmetric field the lines fit perfectly."""
    detector = FailureDetector()
    assert [detector.update(100, 0.01, math.pi - 0.1) for _ in range(5)] == [False] * 4 + [True]
    paper = FailureDetector(PAPERS_RULE)
    assert not any(paper.update(100, 0.01, math.pi - 0.1) for _ in range(20))


def test_the_compass_is_never_corrected_to_the_wrong_end() -> None:
    one = CompassCorrection()
    assert not any(one.update(0.01, math.pi - 0.2, 0.0) for _ in range(20))
    assert one.offset_rad == 0.0
