"""schulz-accuracy on recordings: images of walking humanoids, beside what the odometry alone makes of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from touchline.evaluation.runner import robot_setup
from touchline.experiments.progress import follow
from touchline.experiments.result import percent, spread
from touchline.experiments.scenes import public_recording
from touchline.experiments.schulz_runs import NEAR_M, Track, Walk, dead_reckoned, seen_in_images, settings, tracked

RECORDINGS = ("humanoid_9x6_walk", "humanoid_hsl_pan")
STARTS = 10
LAST_S = 5.0


def recorded_rows() -> list[tuple[str, ...]]:
    """Rows of schulz-accuracy's table; none of a recording that isn't found."""
    rows: list[tuple[str, ...]] = []
    for name in RECORDINGS:
        walked, by_paper = recorded_walk(name), recorded_walk(name, "paper")
        if walked is None or by_paper is None:
            continue
        tracks = [tracked(walked, settings(), seed) for seed in follow(range(STARTS), f"starts in {name}")]
        paper = [tracked(by_paper, settings("paper"), seed) for seed in range(STARTS)]
        alone = [dead_reckoned(walked)]
        for system, found in (("nimbro-lines", tracks), ("the paper's own form", paper), ("odometry alone", alone)):
            rows.append(_row(name, walked, system, found))
    return rows


def recorded_walk(name: str, preset: str | None = None) -> Walk | None:
    """A recording with what the system, or the paper's own form of it, sees in its images; None where not found."""
    recording = public_recording(name)
    if recording is None:
        return None
    truth = recording.truth
    assert truth is not None, f"{name} holds its truth"
    setup = robot_setup(recording)
    return Walk(setup, seen_in_images(setup, recording, name, settings(preset)), np.asarray(truth.poses))


def recorded_note(found: bool) -> str:
    """What the rows of the recordings are, or where they would come from."""
    if not found:
        return f"{' and '.join(RECORDINGS)} were not found; TOUCHLINE_DATA names the folder of the recordings."
    return (
        f"Recorded: images, {STARTS} starts within 0.3 m and 10° (± over these); in brackets the median over the last "
        f"{LAST_S:g} s. The odometry alone starts at the truth."
    )


def _row(name: str, walked: Walk, system: str, tracks: Sequence[Track]) -> tuple[str, ...]:
    last = tracks[0].times_s > tracks[0].times_s[-1] - LAST_S
    medians = [100.0 * float(np.median(t.distances_m)) for t in tracks]
    ends = [100.0 * float(np.median(t.distances_m[last])) for t in tracks]
    features = "all" if system != "odometry alone" else "none"
    return (
        f"recorded: {name}",
        walked.field.name,
        system,
        features,
        f"{spread(medians, 1)} (last {spread(ends, 1)})",
        percent([float(np.mean(t.distances_m <= NEAR_M)) for t in tracks]),
        spread([100.0 * float(np.quantile(t.distances_m, 0.95)) for t in tracks], 0),
        spread([float(np.degrees(np.median(t.turns_rad))) for t in tracks], 2),
        percent([float(np.mean(t.right & t.tracking)) for t in tracks]),
    )
