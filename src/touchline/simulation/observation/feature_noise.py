"""How well the observation level's features are seen: by a mirror's detector, and by nimbro-lines' on a humanoid."""

from __future__ import annotations

from pydantic import Field

from touchline.config import Settings


class LandmarkNoise(Settings):
    """How well one kind of landmark is seen."""

    found_ratio: float = Field(0.85, ge=0, le=1, description="share of those near by that are found")
    found_half_m: float = Field(99.0, gt=0, description="range at which half of these are found")
    found_slope_m: float = Field(0.37, gt=0, description="how fast that changes with the range (logistic)")
    outwards_px: float = Field(0.137, ge=0, description="size of the error in the image (pixels), outwards")
    across_px: float = Field(0.283, ge=0, description="the same at right angles to that")


_NEVER = LandmarkNoise(found_ratio=0.0)


class FeatureNoise(Settings):
    """How well features are seen. The defaults are of a camera with a mirror; crossings as they were measured there."""

    outwards_px: float = Field(
        0.137, ge=0, description="size of a crossing's error in the image (pixels), outwards from the robot"
    )
    across_px: float = Field(0.283, ge=0, description="the same at right angles to that")
    tail: float = Field(1.4, gt=0, description="how much heavier than normal all errors' tails are: k of sinh(k z) / k")
    orientation_deg: float = Field(0.56, ge=0, description="size of the error of a crossing's orientation")
    found_ratio: float = Field(0.59, ge=0, le=1, description="share of the crossings near by that are found")
    found_half_m: float = Field(5.5, gt=0, description="range at which half of these are found")
    found_slope_m: float = Field(0.37, gt=0, description="how fast that changes with the range (logistic)")
    found_half_px: float = Field(
        0.0, ge=0, description="width in the image of a crossing's thinner arm at which half of these are found"
    )
    found_log_slope: float = Field(0.2, gt=0, description="how fast that changes with the logarithm of the width")
    ring_m: float = Field(0.0, ge=0, description="radius of the ground about a crossing that must be in view")
    farthest_crossing_m: float = Field(99.0, gt=0, description="range beyond which no crossing is found")
    wrong_kind_ratio: float = Field(0.03, ge=0, le=1, description="share of crossings taken for another kind; set")

    line_ratio: float = Field(0.95, ge=0, le=1, description="share of the lines in view that are found")
    line_half_px: float = Field(0.0, ge=0, description="length in the image at which half of these are found")
    line_log_slope: float = Field(0.2, gt=0, description="how fast that changes with the logarithm of the length")
    shortest_line_m: float = Field(0.6, gt=0, description="visible length below which a line is not found")
    thinnest_px: float = Field(0.0, ge=0, description="width in the image below which a line is not seen")
    line_px: float = Field(0.2, ge=0, description="size of a line's error in the image, across it")
    line_end_m: float = Field(0.02, ge=0, description="size of the error of a line's ends along it")
    false_lines: float = Field(0.0, ge=0, description="mean number of lines per image, partly in view, that are none")
    net_ratio: float = Field(
        0.0, ge=0, le=1, description="share of coloured goals in view of whose nets a thread is taken for a line"
    )

    posts: LandmarkNoise = LandmarkNoise()
    white_posts: LandmarkNoise = LandmarkNoise()
    poles: LandmarkNoise = LandmarkNoise()
    marks: LandmarkNoise = _NEVER
    circle: LandmarkNoise = _NEVER

    lean_deg: float = Field(
        0.0, ge=0, description="error of roll and of pitch that all features of an image share; measured on the IMU"
    )
    farthest_m: float = Field(6.5, gt=0, description="range beyond which nothing is found")
    height_m: float = Field(0.8, gt=0, description="height of the view: how far bodies hide the ground")


LEAN_DEG = 0.25  # what the IMU tells of a walking body less the truth
PINHOLE_FEATURES = FeatureNoise(
    outwards_px=0.18,
    across_px=0.285,
    tail=1.21,
    orientation_deg=0.3,
    found_ratio=0.995,
    found_half_m=99.0,
    found_half_px=1.83,
    found_log_slope=0.36,
    ring_m=0.2,
    farthest_crossing_m=5.0,
    wrong_kind_ratio=0.0,
    line_ratio=0.995,
    line_half_px=66.0,
    line_log_slope=0.4,
    shortest_line_m=0.35,
    thinnest_px=1.12,
    line_px=0.041,
    line_end_m=0.033,
    false_lines=0.05,
    posts=LandmarkNoise(found_ratio=0.995, found_half_m=8.5, found_slope_m=1.6, outwards_px=0.4, across_px=0.42),
    white_posts=LandmarkNoise(found_ratio=0.94, found_half_m=5.4, found_slope_m=0.43, outwards_px=1.12, across_px=0.45),
    poles=LandmarkNoise(found_ratio=0.945, outwards_px=0.29, across_px=1.41),
    marks=LandmarkNoise(found_ratio=0.98, found_half_m=4.4, found_slope_m=0.24, outwards_px=0.48, across_px=0.3),
    circle=LandmarkNoise(found_ratio=0.97, outwards_px=0.21, across_px=0.7),
    farthest_m=8.0,
    lean_deg=LEAN_DEG,
    height_m=1.1,
)
"""Of a humanoid's camera, fitted to nimbro-lines' detector by `benchmarks/fit_features.py`."""
