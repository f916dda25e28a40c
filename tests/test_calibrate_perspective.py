"""touchline calibrate camera and imu: from marks back to the cameras that saw them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from small_recordings import write_recording

from touchline.calibration.marks import Marks
from touchline.calibration.perspective import (
    Lens,
    calibrate_camera,
    chessboard_lens,
    lens_of,
    lens_of_marks,
    perspective_yaml,
)
from touchline.camera import PinholeCamera, open_camera
from touchline.cli import main
from touchline.errors import InputError
from touchline.geometry import FloatArray, Pose3
from touchline.motion import LeanFilter
from touchline.palette import ORANGE, bgr
from touchline.sources import open_source
from touchline.types import Frame, Samples

FOUR = np.array([(1.2, 0.5), (1.2, -0.5), (2.5, 0.9), (2.5, -0.9)])
MOUNT = Pose3.from_roll_pitch_yaw(0.03, 0.45, -0.05, (0.06, 0.02, 0.95))
FISHEYE = {
    "model": "fisheye", "width": 640, "height": 480, "fx": 285.0, "fy": 285.0, "cx": 321.4, "cy": 238.2,
    "distortion": [-0.02, 0.003, -0.001, 0.0002],
    "mount": {"x": 0.04, "y": 0.0, "z": 0.52, "roll": 0.0, "pitch": 0.55, "yaw": 0.0},
}  # fmt: skip
DISTORTION = np.array([-0.25, 0.06, 0.0006, -0.0004, 0.0])


def camera(distortion: FloatArray = DISTORTION) -> PinholeCamera:
    return PinholeCamera(752, 480, 493.0, 493.0, 375.5, 239.5, distortion, MOUNT)


def lens(of: PinholeCamera) -> Lens:
    return Lens(of.width, of.height, of.fx, of.fy, of.cx, of.cy, of.distortion, "camera.yaml")


def marks_seen_by(of: PinholeCamera, places: FloatArray = FOUR) -> Marks:
    n = len(places)
    names = tuple(f"mark-{i}" for i in range(n))
    return Marks(
        Path("marks.csv"), ("images/0.jpg",) * n, names, of.image_from_ground(places), places, tuple(range(2, n + 2))
    )


def same_pose(found: Pose3, true: Pose3, tolerance: float) -> None:
    assert found.translation_m == pytest.approx(true.translation_m, abs=tolerance)
    assert found.rotation == pytest.approx(true.rotation, abs=tolerance)


def test_four_marks_place_the_camera() -> None:
    found = calibrate_camera(marks_seen_by(camera()), lens(camera()))
    same_pose(found.camera.base_from_camera, MOUNT, 1e-5)
    assert found.residuals_px.max() < 1e-3
    flat = camera().undistorted(np.array([(300.0, 400.0)]))[0]
    ground = found.homography @ (*flat, 1.0)
    assert ground[:2] / ground[2] == pytest.approx(camera().ground_from_image([(300.0, 400.0)])[0], abs=1e-4)


def test_four_marks_tell_the_focal_length() -> None:
    straight = camera(np.zeros(5))
    marks = marks_seen_by(straight)
    found = calibrate_camera(marks, lens_of_marks(marks, (752, 480)))
    assert found.camera.fx == pytest.approx(493.0, abs=0.1)
    same_pose(found.camera.base_from_camera, MOUNT, 1e-3)


def test_marks_that_tell_nothing_are_refused() -> None:
    with pytest.raises(InputError, match="at least 4"):
        calibrate_camera(marks_seen_by(camera(), FOUR[:3]), lens(camera()))
    in_line = np.column_stack((np.linspace(1.0, 3.0, 5), np.linspace(-0.5, 0.5, 5)))
    with pytest.raises(InputError, match="in one line"):
        calibrate_camera(marks_seen_by(camera(), in_line), lens(camera()))
    with pytest.raises(InputError, match="'fx' is missing"):
        lens_of({"model": "pinhole", "width": 1, "height": 1}, Path("camera.yaml"))
    with pytest.raises(InputError, match="perspective camera"):
        lens_of({"model": "omni"}, Path("camera.yaml"))


def test_an_imu_that_says_nothing_leaves_the_lean_unknown() -> None:
    leaning = LeanFilter()
    leaning.add(Frame(10))
    assert leaning.lean(10) is None


def test_without_rates_the_newest_angles_count_as_in_the_paper() -> None:
    leaning = LeanFilter(rates=False)
    rates = Samples(np.array([0, 10**8]), np.array([[1.0, 2.0, 0.0], [1.0, 2.0, 0.0]]))
    for stamp_ns, roll in ((10**8, 0.1), (2 * 10**8, 0.3)):
        angles = Samples(np.array([stamp_ns - 10**7]), np.array([[roll, -roll]]))
        carried = leaning.at_image(Frame(stamp_ns, tilt=angles, gyro=rates))
        assert carried.tilt is not None
        assert carried.tilt.values.tolist() == [[roll, -roll]]


def test_a_written_camera_is_read_again(tmp_path: Path) -> None:
    (tmp_path / "camera.yaml").write_text(perspective_yaml(camera(), "found\nin a test"))
    again = open_camera(tmp_path / "camera.yaml")
    assert isinstance(again, PinholeCamera)
    same_pose(again.base_from_camera, MOUNT, 1e-9)


def test_the_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    seen = camera().image_from_ground(FOUR)
    rows = [f"a.jpg,m{i},{u},{v},{x},{y}" for i, ((u, v), (x, y)) in enumerate(zip(seen, FOUR, strict=True))]
    (tmp_path / "marks.csv").write_text("\n".join(["file,name,u,v,x_m,y_m", *rows]) + "\n")
    (tmp_path / "lens.yaml").write_text(perspective_yaml(camera(), ""))
    arguments = [str(tmp_path / "marks.csv"), "--output", str(tmp_path / "camera.yaml")]
    assert main(["calibrate", "camera", *arguments]) == 2
    assert "give --camera FILE" in capsys.readouterr().err
    assert main(["calibrate", "camera", *arguments, "--camera", str(tmp_path / "lens.yaml")]) == 0
    same_pose(open_camera(tmp_path / "camera.yaml").base_from_camera, MOUNT, 1e-5)
    assert "95.0 cm high" in capsys.readouterr().out
    drawn = cv2.imread(str(tmp_path / "camera.png"))  # no image lies beside the marks
    assert drawn is not None
    width, height = camera().width, camera().height
    u, v = (seen[0] + 0.5) * 1200 / width - 0.5
    assert drawn.shape[1] == 1200
    assert drawn.shape[0] > 1200 * height // width
    np.testing.assert_array_equal(drawn[round(v), round(u)], bgr(ORANGE))
    mirror = str(Path(__file__).parents[1] / "examples" / "omni_msl_track_short")
    assert main(["calibrate", "imu", mirror, "--output", str(tmp_path / "imu.yaml")]) == 2
    assert "looks at a mirror" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("camera", "a fisheye's lens is not calibrated here; OpenCV's fisheye.calibrate does that"),
        ("imu", "its camera is a fisheye; the IMU's correction is for pinhole cameras"),
    ],
)
def test_a_fisheye_is_refused(name: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_recording(tmp_path / "r", frames=1, camera="fisheye", field="indoor-9x6")
    (folder / "camera.yaml").write_text(yaml.safe_dump(FISHEYE))
    (folder / "marks.csv").write_text("file,name,u,v,x_m,y_m\na.jpg,m1,300,400,1,0\n")
    assert main(["calibrate", name, str(folder), "--output", str(tmp_path / "camera.yaml")]) == 2
    assert words in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "camera.yaml").exists()


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("distortion", ["x"] * 5, "'distortion' must be a list of numbers"),
        ("distortion", [0.1, [0.2]], "'distortion' must be a list of numbers"),
        ("distortion", [0.1], "distortion needs five numbers"),
        ("width", float("inf"), "'width' must be a number"),
        ("fx", 0.1, "'fx' and 'fy' must be 1 to "),
    ],
)
def test_a_lens_that_is_none_is_named(key: str, value: object, said: str) -> None:
    tree = {"model": "pinhole", "width": 752, "height": 480, "fx": 493, "fy": 493, "cx": 375, "cy": 239}
    with pytest.raises(InputError, match=said):
        lens_of(tree | {key: value}, Path("camera.yaml"))


@pytest.mark.parametrize(
    "chessboard",
    [
        None,
        [],
        {"inner_corners": [7, 2], "square_m": 0.1},
        {"inner_corners": [7, 10**9], "square_m": 0.1},
        {"inner_corners": [7, float("inf")], "square_m": 0.1},
        {"inner_corners": [7, 5], "square_m": float("nan")},
    ],
)
def test_a_chessboard_that_is_none_is_named(chessboard: object, tmp_path: Path) -> None:
    recording = open_source(write_recording(tmp_path / "r", frames=1, chessboard=chessboard))
    with pytest.raises(InputError, match=r"needs chessboard: .* 3 to 50 corners a side"):
        chessboard_lens(recording)
