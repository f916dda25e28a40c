"""The pixel-to-centimetre regression: exact on exact pairs, monotone or refused, valid to the last pair."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import yaml
from syrupy.assertion import SnapshotAssertion

from touchline.camera import open_camera
from touchline.cli import main
from touchline.errors import InputError, NoFitError
from touchline.files.images import read_image
from touchline.published.iris_fusion.range_pairs import RangePairs, marked_pairs, recording_pairs
from touchline.published.iris_fusion.range_regression import fit_range
from touchline.sources import open_source
from touchline.view.picture_files import save_picture

CENTER = (200.0, 150.0)
HANDEDNESS, YAW = -1, 0.4
ROUGH = {"model": "omni", "width": 400, "height": 300, "center": list(CENTER)}


def ranges(radius: np.ndarray) -> np.ndarray:
    """A cubic that rises."""
    return 0.2 + 0.004 * radius + 2e-7 * radius**3


def marks(radii: Sequence[float], bearings: int = 8, center: tuple[float, float] = CENTER) -> list[str]:
    """Rows of marks.csv seen through the cubic."""
    rows = ["file,name,u,v,x_m,y_m"]
    for radius in radii:
        for bearing in np.arange(bearings) * 2 * math.pi / bearings:
            angle = HANDEDNESS * (bearing - YAW)
            u, v = center[0] + radius * math.cos(angle), center[1] + radius * math.sin(angle)
            x, y = ranges(np.array(radius)) * math.cos(bearing), ranges(np.array(radius)) * math.sin(bearing)
            rows.append(f"images/000000.jpg,m{len(rows)},{u:.5f},{v:.5f},{x:.6f},{y:.6f}")
    return rows


def invoke(*arguments: object) -> int:
    return main([str(argument) for argument in arguments])


RADII = (40.0, 55.0, 75.0, 90.0, 110.0, 125.0, 140.0)


def written(folder: Path, rows: list[str], **camera: object) -> RangePairs:
    (folder / "marks.csv").write_text("\n".join(rows) + "\n")
    (folder / "camera.yaml").write_text(yaml.safe_dump(ROUGH | camera))
    return marked_pairs(folder / "marks.csv", folder / "camera.yaml")


def test_a_polynomial_is_found_again(tmp_path: Path) -> None:
    regression = fit_range(written(tmp_path, marks(RADII)), 3)
    radii = np.linspace(40.0, 140.0, 50)
    np.testing.assert_allclose(regression.polynomial(radii), ranges(radii), rtol=1e-5)
    assert np.abs(regression.residuals_m).max() < 1e-4
    assert np.hypot(*regression.center_offset_px()) < 0.01


def test_orientation_comes_from_the_marks_unless_camera_yaml_knows_it(tmp_path: Path) -> None:
    optics = written(tmp_path, marks(RADII)).optics
    assert optics.handedness == HANDEDNESS
    assert optics.mount_yaw_rad == pytest.approx(YAW, abs=1e-4)
    optics = written(tmp_path, marks(RADII), handedness=-1, mount_yaw=0.41).optics
    assert optics.mount_yaw_rad == 0.41
    with pytest.raises(InputError, match=r"most marks are seen more than 8° away.*'handedness' and 'mount_yaw'"):
        written(tmp_path, marks(RADII), handedness=1, mount_yaw=0.4)


def test_the_camera_ends_at_the_first_and_the_last_pair(tmp_path: Path) -> None:
    camera = fit_range(written(tmp_path, marks(RADII), inner_radius_px=30.0), 3).camera()
    along = np.array([1.0, 0.0])
    inside = camera.ground_from_image([np.array(CENTER) + r * along for r in (41.0, 100.0, 139.0)])
    np.testing.assert_allclose(np.hypot(*inside.T), ranges(np.array([41.0, 100.0, 139.0])), rtol=1e-4)
    assert np.isnan(camera.ground_from_image([np.array(CENTER) + r * along for r in (38.0, 141.0)])).all()
    assert (camera.inner_radius_px, camera.outer_radius_px) == pytest.approx((40.0, 140.0), abs=1e-3)


def test_the_camera_continues_beyond_its_pairs(tmp_path: Path) -> None:
    regression = fit_range(written(tmp_path, marks(RADII), inner_radius_px=1.0), 3)
    camera, plain = regression.camera(continued=True), regression.camera()
    assert np.all(np.diff(camera.range_m[0]) > 0)
    assert camera.range_m[0, -1] == pytest.approx(2.0 * ranges(np.array(140.0)), rel=0.05)
    assert camera.range_m[0, 0] == pytest.approx(0.5 * ranges(np.array(40.0)), rel=0.1)
    same = np.isin(np.round(camera.radius_px, 6), np.round(plain.radius_px, 6))
    np.testing.assert_array_equal(camera.range_m[0, same], plain.range_m[0])
    for key, limit in (("inner_radius_px", 25.0), ("outer_radius_px", 160.0)):
        ended = fit_range(written(tmp_path, marks(RADII), **{key: limit}), 3).camera(continued=True)
        edge = ended.inner_radius_px if key == "inner_radius_px" else ended.outer_radius_px
        assert edge == pytest.approx(limit, abs=1.0)
    bare = fit_range(written(tmp_path, marks(RADII)), 3).camera(continued=True)
    assert bare.inner_radius_px == pytest.approx(40.0, abs=1e-3)  # where the robot ends is not known


def along(bearings: Sequence[float], handedness: int = HANDEDNESS) -> list[str]:
    """Rows of marks in a few directions."""
    rows = marks(RADII)[:1]
    for bearing in bearings:
        for radius in RADII:
            angle, far = handedness * (bearing - YAW), float(ranges(np.array(radius)))
            u, v = CENTER[0] + radius * math.cos(angle), CENTER[1] + radius * math.sin(angle)
            rows.append(
                f"0.jpg,m{len(rows)},{u:.4f},{v:.4f},{far * math.cos(bearing):.5f},{far * math.sin(bearing):.5f}"
            )
    return rows


@pytest.mark.parametrize("bearings", [(0.3,), (0.3, 0.3 + math.pi)])
def test_marks_in_one_direction_can_t_tell_handedness_or_centre(
    tmp_path: Path, bearings: tuple[float, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    """Before, -1 was written without a word."""
    with pytest.raises(InputError, match=r"can't tell the handedness.*'handedness: 1' into .*camera\.yaml"):
        written(tmp_path, along(bearings))
    command = ["calibrate", "range", tmp_path / "marks.csv", "--output", tmp_path / "o.yaml"]
    assert invoke(*command) == 2
    assert invoke(*command, "--handedness", "1") == 2
    assert "can't tell whether the centre 200.0, 150.0 px is right" in capsys.readouterr().err
    assert invoke(*command, "--handedness", "1", "--keep-center") == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "Straight image" in said
    assert "can't tell the centre: it is taken as camera.yaml has it" in said
    assert open_camera(tmp_path / "o.yaml").handedness == 1
    assert invoke(*command, "--handedness", "2") == 2


def test_a_degree_that_does_not_rise_is_refused(tmp_path: Path) -> None:
    radii = np.array([50.0, 80.0, 85.0, 90.0, 140.0])
    wild = RangePairs(
        radii, np.array([1.0, 1.05, 2.0, 2.95, 3.0]), np.zeros(5), ("",) * 5, "5 marks",
        written(tmp_path, marks(RADII)).optics,
    )  # fmt: skip
    with pytest.raises(NoFitError, match=r"degree 4 does not rise at a radius of \d+ px.*degrees that rise: 1"):
        fit_range(wild, 4)
    assert fit_range(wild).degree < 4


def test_what_marks_cannot_be_is_told(tmp_path: Path, snapshot: SnapshotAssertion) -> None:
    rows, told = marks(RADII), []
    for row in (
        "images/0.jpg,a,12,abc,1,2",
        "images/0.jpg,a,12,13,1",
        "images/0.jpg,a,12,13,1,",
        "images/0.jpg,a,900,13,1,1",
    ):
        with pytest.raises(InputError) as refused:
            written(tmp_path, [*rows[:2], row, *rows[2:]])
        told.append(str(refused.value))
    for radii, degree in (((60.0,), None), (RADII[:3], 4), (RADII, 13)):
        with pytest.raises(InputError) as refused:
            fit_range(written(tmp_path, marks(radii)), degree)
        told.append(str(refused.value))
    cells = rows[20].split(",")
    rows[20] = ",".join((*cells[:4], f"{1.5 * float(cells[4]):.4f}", f"{1.5 * float(cells[5]):.4f}"))
    with pytest.raises(InputError) as refused:
        fit_range(written(tmp_path, rows))
    told.append(str(refused.value))
    assert [words.replace(str(tmp_path), "") for words in told] == snapshot


@pytest.mark.slow
def test_the_public_strip_gives_ranges_good_to_a_per_cent(small_data: Path) -> None:
    regression = fit_range(recording_pairs(open_source(small_data / "omni_calibration")))
    truth = open_camera(small_data / "omni_msl_track" / "camera.yaml")
    radii = np.linspace(52.0, 187.0, 100)
    expected = np.interp(radii, truth.radius_px, truth.range_m[0])
    np.testing.assert_allclose(regression.polynomial(radii), expected, rtol=0.006)
    assert regression.degree == 6


def test_a_recording_without_pairs_says_what_it_lacks(small_data: Path) -> None:
    with pytest.raises(InputError, match=r"neither marks.csv.*nor.*patch_edges_m"):
        recording_pairs(open_source(small_data / "omni_msl_track"))


def test_the_command_writes_camera_and_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    written(tmp_path, marks(RADII))
    output = tmp_path / "fitted.yaml"
    assert invoke("calibrate", "range", tmp_path / "marks.csv", "--output", output, "--degree", "3") == 0
    said = capsys.readouterr().out
    assert "degree 3 fitted to 56 marks of marks.csv" in said
    assert "Known from pairs between" in said
    assert "continued from" in said
    assert "Mirrored image" in said
    camera = open_camera(output)
    at = camera.ground_from_image([(CENTER[0] + 100.0, CENTER[1])])[0]
    assert np.hypot(*at) == pytest.approx(ranges(np.array(100.0)), rel=1e-3)
    assert "range_m = " in output.read_text()
    alone = read_image(tmp_path / "fitted.png")
    assert invoke("calibrate", "range", tmp_path / "marks.csv", "--output", output) == 2
    assert "exists already" in capsys.readouterr().err
    (tmp_path / "images").mkdir()
    save_picture(tmp_path / "images" / "000000.jpg", np.full((camera.height, camera.width, 3), (40, 140, 40), np.uint8))
    assert invoke("calibrate", "range", tmp_path / "marks.csv", "--output", tmp_path / "again.yaml") == 0
    beside = read_image(tmp_path / "again.png")
    assert beside.shape[1] > 1.5 * alone.shape[1]
    assert (np.abs(beside.astype(int) - (40, 140, 40)).max(axis=2) < 6).mean() > 0.15  # the image, with little over it
