"""`touchline calibrate lines --model pinhole`: a perspective camera from lines at places nobody measured."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from touchline.calibration import perspective_lines
from touchline.calibration.perspective_bundle import (
    CENTER_V,
    FOCAL,
    HEIGHT,
    NAMES,
    PITCH,
    ROLL,
    Learned,
    PerspectiveFit,
    PerspectiveView,
    Stand,
    camera_at,
    fit_perspective,
)
from touchline.calibration.perspective_lines import calibrate_perspective_lines
from touchline.calibration.perspective_search import find_cameras, place
from touchline.cli import main
from touchline.errors import NoFitError
from touchline.field import open_field
from touchline.geometry import FloatArray, Pose
from touchline.localization.registration.registration import Registration
from touchline.localization.search.pose_search import PoseSearch
from touchline.types import LinePoints, Lines, Observation

FIELD = open_field("hsl-s-9x6")
SIZE = (640, 480)
TRUE = np.array([0.02, 0.40, math.log(0.62), math.log(505.0), -0.08, 1.0, -1.5, 0.01, 0.0, 0.0])
POSES = [
    Pose(*pose)
    for pose in (
        (-2.6, 0.8, 0.2),
        (-1.5, -1.2, 2.8),
        (2.0, 1.5, -0.5),
        (0.5, -2.2, 1.9),
        (-3.2, 1.9, -1.0),
        (1.2, 0.3, 3.0),
    )
]


def observed(pose: Pose, seed: int, lean: FloatArray | None = None, noise_px: float = 0.3) -> Observation:
    """What a camera shows."""
    camera, rng = camera_at("pinhole", SIZE, TRUE, lean), np.random.default_rng(seed)
    points, ends = [], []
    for number, line in enumerate(FIELD.polylines(0.04)):
        ground = pose.inverse().transform(line)
        ground = ground[(ground[:, 0] > 0.2) & (np.hypot(*ground.T) < 5.0)]
        pixels = camera.image_from_ground(ground) if len(ground) else np.zeros((0, 2))
        pixels = pixels[camera.sees(pixels)]
        if len(pixels) < 5:
            continue
        pixels = pixels[:: max(len(pixels) // 25, 1)]
        points.append(pixels + noise_px * rng.standard_normal(pixels.shape))
        if number < len(FIELD.segments):
            ends.append(pixels[[0, -1]])
    seen, lines = np.concatenate(points), np.array(ends).reshape(-1, 2, 2)
    ones, nothing = np.ones(len(seen)), np.zeros((len(seen), 2))
    spreads = np.tile(1e-4 * np.eye(2), (len(seen), 1, 1))
    of_lines = Lines(np.zeros_like(lines), np.zeros((*lines.shape, 2)), np.ones(len(lines)), lines)
    return Observation(0, LinePoints(nothing, spreads, ones, seen), of_lines)


@pytest.fixture(scope="module")
def seen() -> list[Observation]:
    return [observed(pose, k) for k, pose in enumerate(POSES)]


def upright(pose: Pose) -> Stand:
    return Stand(pose, np.zeros(3))


def z_scores(state: FloatArray, covariance: FloatArray) -> FloatArray:
    scores: FloatArray = (state - TRUE) / np.sqrt(np.diag(covariance))
    return scores


def test_the_bundle_finds_the_camera_and_says_how_well(seen: list[Observation]) -> None:
    start = TRUE + np.array([0.01, -0.02, 0.04, 0.04, 0.08, -1.0, 1.5, -0.01, 0.0, 0.0])
    off = np.array([0.04, -0.03, 0.02])
    views = [
        PerspectiveView(one.points.pixels, upright(Pose(*(pose.as_array() + off).tolist())))
        for one, pose in zip(seen, POSES, strict=True)
    ]
    fit = fit_perspective(views, start, FIELD, "pinhole", SIZE)
    assert np.abs((fit.state - TRUE)[[ROLL, PITCH]]).max() < math.radians(0.4)
    assert np.abs((fit.state - TRUE)[[HEIGHT, FOCAL]]).max() < 0.015
    assert np.abs(z_scores(fit.state, fit.covariance)).max() < 3.0
    assert fit.on_lines.min() > 0.9


@pytest.fixture
def few_cameras(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fewer of them are searched."""
    of_search = "touchline.calibration.perspective_search."
    monkeypatch.setattr(of_search + "HEIGHTS_M", np.array([0.42, 0.62, 0.92]))
    monkeypatch.setattr(of_search + "PITCHES_DEG", np.arange(12.0, 36.0, 4.0))


@pytest.mark.usefixtures("few_cameras")
def test_a_camera_is_found_from_nothing(seen: list[Observation]) -> None:
    search = PoseSearch(FIELD, Registration(FIELD.distance_map()))
    best = find_cameras(seen, "pinhole", SIZE, search)[0].state
    assert math.exp(best[HEIGHT]) == 0.62
    assert abs(best[FOCAL] - TRUE[FOCAL]) < 0.15
    assert abs(best[PITCH] - TRUE[PITCH]) < math.radians(3.0)
    pose, _ = place(seen[0], "pinhole", SIZE, TRUE, search)
    assert pose is not None
    assert min(pose.distance_to(one) for one in (POSES[0], POSES[0].mirrored())) < 0.05


def fit_of(state: FloatArray, poses: Sequence[Pose], on_lines: Sequence[float]) -> PerspectiveFit:
    stands = [upright(pose) for pose in poses]
    return PerspectiveFit(
        state, 1e-6 * np.eye(10), stands, np.array(on_lines), 0.01, Learned(0.006, 0.006, 0.001, 0.3, 0.005)
    )


@pytest.mark.parametrize(
    ("found_again", "last_on_lines", "paint_m"), [(6, 0.5, 0.005), (3, 0.5, 0.005), (0, 0.5, 0.005), (6, 1.0, 0.03)]
)
def test_poses_are_looked_for_again_where_refuted(
    seen: list[Observation],
    monkeypatch: pytest.MonkeyPatch,
    found_again: int,
    last_on_lines: float,
    paint_m: float,
) -> None:
    """Of all images, of three that fit better, or none: the camera that more images fit is kept. One that moves the
    field's lines is refuted, too.
    """
    asked = []

    def fitted(
        _: object,
        shown: list[Observation],
        state: FloatArray,
        known: dict[int, Stand],
        leans: FloatArray | None = None,
    ) -> object:
        asked.append(len(known))
        assert known or (leans is not None and leans.shape == (6, 3))
        refuted = len(asked) == 1
        if not known and not found_again:
            raise NoFitError("no camera that is usual puts the points on this field's lines")
        number = 6 if known else found_again
        on_lines = [1.0] * 6 if not refuted else [1.0] * 5 + [last_on_lines]
        fit = fit_of(state, POSES[:number], on_lines[:number])
        fit = fit._replace(learned=fit.learned._replace(paint_m=paint_m if refuted else 0.005))
        return perspective_lines._Fitted(fit._replace(cost=0.2 if known else 0.01), tuple(range(number)), shown)

    work = perspective_lines._Calibration
    monkeypatch.setattr(work, "look", lambda *_: seen)
    monkeypatch.setattr(
        work, "first", lambda _: perspective_lines._Fitted(fit_of(TRUE, POSES, [1.0] * 6), tuple(range(6)), seen)
    )
    monkeypatch.setattr(work, "fitted", fitted)
    blank = [np.zeros((SIZE[1], SIZE[0], 3), dtype=np.uint8)] * 6
    assert calibrate_perspective_lines(blank, FIELD, "pinhole").used == tuple(range(6))
    assert asked[:2] == [6, 0]


def found_with(lean_deg: float, **deviations: float) -> perspective_lines.PerspectiveLines:
    """From six images of a body that leans by so much, a standard deviation; deviations: of the images besides."""
    fit = fit_of(TRUE, POSES, [1.0] * 6)
    fit.covariance[ROLL, ROLL] += math.radians(lean_deg) ** 2 / 6.0
    for name, deviation in deviations.items():
        fit.covariance[NAMES.index(name), NAMES.index(name)] += deviation**2
    swayed = fit._replace(learned=Learned(math.radians(lean_deg), 0.0006, 0.001, 0.3, 0.002))
    return perspective_lines.PerspectiveLines(camera_at("pinhole", SIZE, TRUE), swayed, tuple(range(6)), ())


@pytest.mark.parametrize(
    ("lean_deg", "deviations", "reason"),
    [
        (4.2, {}, "leans by 4.2°.*leave the camera's roll open"),
        (4.2, {"height": 0.1}, "leave the camera's roll open"),
        (0.3, {"roll": 0.01}, "don't tell the camera's roll:"),
        (2.2, {"pitch": 0.014, "height": 0.05}, "don't tell the camera's pitch and height:"),
    ],
)
def test_what_stays_open_is_named_with_its_cause(lean_deg: float, deviations: dict[str, float], reason: str) -> None:
    """Sway leaves the mean of rolls open, whatever six images show."""
    with pytest.raises(NoFitError, match=reason):
        perspective_lines.check(found_with(lean_deg, **deviations), 6)


def test_a_body_that_sways_is_not_refused() -> None:
    """Its rolls' mean is known to 0.9°, a third of what localization expects, and said to be."""
    found = found_with(2.2)
    perspective_lines.check(found, 6)
    assert math.degrees(found.deviations[ROLL]) == pytest.approx(0.9, abs=0.01)
    assert found.image_deviations[ROLL] < math.radians(0.1)


def test_the_principal_point_may_make_up_for_pitch() -> None:
    found = found_with(0.3)
    moved = np.zeros(10)
    moved[[PITCH, CENTER_V]] = math.radians(1.0), math.radians(1.0) * math.exp(TRUE[FOCAL])
    found.fit.covariance[:] += np.outer(moved, moved)
    perspective_lines.check(found, 6)
    assert math.degrees(found.deviations[PITCH]) == pytest.approx(1.0, abs=0.01)
    assert found.image_deviations[PITCH] < math.radians(0.1)


def test_images_of_a_few_pixels_are_refused() -> None:
    with pytest.raises(NoFitError, match="images of 8 x 6 pixels"):
        calibrate_perspective_lines([np.full((6, 8, 3), 90, dtype=np.uint8)], FIELD, "fisheye")


@pytest.mark.parametrize("count", [1, 3])
def test_too_few_lines_are_refused(count: int) -> None:
    told: list[str] = []
    images = [np.full((SIZE[1], SIZE[0], 3), (60, 120, 40), dtype=np.uint8)] * count
    with pytest.raises(
        NoFitError, match="fewer than 6 lines are seen in " + ("1 image," if count == 1 else "3 images,")
    ):
        calibrate_perspective_lines(images, FIELD, "pinhole", told.append)
    assert told[:count] == [f"looks for lines in image {k + 1} of {count}" for k in range(count)]


@pytest.mark.parametrize(
    ("model", "words"), [("telescope", "'telescope' is not one of"), ("pinhole", "--model pinhole needs images")]
)
def test_wrong_calls_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str], model: str, words: str) -> None:
    points = tmp_path / "points.csv"
    points.write_text("u_px,v_px\n1,2\n")
    output = tmp_path / "camera.yaml"
    call = ["calibrate", "lines", str(points), "--field", "hsl-s-9x6", "--output", str(output), "--model", model]
    assert main(call) == 2
    assert words in " ".join(capsys.readouterr().err.split())
    assert not output.exists()
