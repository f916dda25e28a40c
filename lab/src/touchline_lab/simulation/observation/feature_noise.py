"""How well the observation level's features are seen: by a mirror's detector, and by nimbro-lines' on a humanoid."""

from pathlib import Path

from pydantic import Field

from touchline.config import Settings
from touchline.files.yaml_text import read_yaml_mapping


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

    outwards_px: float = Field(0.137, ge=0, description="size of a crossing's error in the image (pixels), outwards")
    across_px: float = Field(0.283, ge=0, description="the same at right angles to that")
    tail: float = Field(1.4, gt=0, description="how much heavier than normal all errors' tails are: k of sinh(k z) / k")
    orientation_deg: float = Field(0.56, ge=0, description="size of the error of a crossing's orientation")
    found_ratio: float = Field(0.59, ge=0, le=1, description="share of the crossings near by that are found")
    found_half_m: float = Field(5.5, gt=0, description="range at which half of these are found")
    found_slope_m: float = Field(0.37, gt=0, description="how fast that changes with the range (logistic)")
    found_half_px: float = Field(0.0, ge=0, description="width of a crossing's thinner arm at which half are found")
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
    net_ratio: float = Field(0.0, ge=0, le=1, description="share of coloured goals with a thread taken for a line")

    posts: LandmarkNoise = LandmarkNoise()
    white_posts: LandmarkNoise = LandmarkNoise()
    poles: LandmarkNoise = LandmarkNoise()
    marks: LandmarkNoise = _NEVER
    circle: LandmarkNoise = _NEVER

    lean_deg: float = Field(0.0, ge=0, description="error of roll and pitch that an image's features share; of the IMU")
    farthest_m: float = Field(6.5, gt=0, description="range beyond which nothing is found")
    height_m: float = Field(0.8, gt=0, description="height of the view: how far bodies hide the ground")


# Of a humanoid's camera, fitted to what nimbro-lines' detector finds in rendered images.
PINHOLE_FEATURES = FeatureNoise(**read_yaml_mapping(Path(__file__).with_name("pinhole_features.yaml")))
