"""docs/how-to-humanoid.md does what it says: every command in it is run, every file in it is read."""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from small_recordings import write_sensors

from touchline.camera import PinholeCamera, open_camera
from touchline.cli import main
from touchline.geometry import FloatArray, Pose3
from touchline.types import ImageArray

PAGE = (Path(__file__).parents[1] / "docs" / "how-to-humanoid.md").read_text(encoding="utf-8")
FRAMES = 7
CORNERS, SQUARE_M = (7, 5), 0.06
SIZE = (752, 480)
MATRIX = np.array([[493.0, 0.0, 375.5], [0.0, 493.0, 239.5], [0.0, 0.0, 1.0]])
TILTS = ((0.0, 0.0), (0.5, 0.1), (-0.5, 0.0), (0.1, 0.5), (0.0, -0.5), (0.4, 0.4))


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.M | re.S)


def commands() -> list[str]:
    return [line for block in blocks("sh") for line in block.splitlines() if line]


def short_walk(small_data: Path, folder: Path) -> None:
    """The first images of the humanoid's recording."""
    shutil.copytree(small_data / "humanoid_9x6_walk", folder)
    rows = (folder / "images.csv").read_text().splitlines()[: FRAMES + 1]
    (folder / "images.csv").write_text("\n".join(rows) + "\n")


def board_image(tilt: tuple[float, float]) -> ImageArray:
    """A chessboard as a camera without distortion sees it."""
    columns, rows = CORNERS[0] + 1, CORNERS[1] + 1
    checks = np.indices((rows, columns)).sum(axis=0) % 2 * 220 + 20
    flat = np.pad(np.kron(checks, np.ones((30, 30))), 20, constant_values=240).astype(np.uint8)
    turn = cv2.Rodrigues(np.array([*tilt, 0.1]))[0]
    metres = SQUARE_M / 30.0
    middle = 0.5 * np.array([flat.shape[1], flat.shape[0]]) * metres
    on_board = np.array([[metres, 0.0, -middle[0]], [0.0, metres, -middle[1]], [0.0, 0.0, 1.0]])
    places = np.column_stack((turn[:, 0], turn[:, 1], (0.0, 0.0, 0.7)))
    grey = cv2.warpPerspective(flat, MATRIX @ places @ on_board, SIZE, borderValue=(90,))
    return np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), dtype=np.uint8)


def describe(folder: Path, **keys: Any) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    about = {"format": 1, "field": "humanoid-kid-9x6", "rate_hz": 8} | keys
    (folder / "sequence.yaml").write_text(yaml.safe_dump(about))


def board(folder: Path) -> None:
    describe(folder, camera="pinhole", chessboard={"inner_corners": list(CORNERS), "square_m": SQUARE_M})
    (folder / "images").mkdir()
    rows = ["t,file"]
    for k, tilt in enumerate(TILTS):
        cv2.imwrite(str(folder / f"images/{k:06d}.jpg"), board_image(tilt))
        rows.append(f"{k},images/{k:06d}.jpg")
    (folder / "images.csv").write_text("\n".join(rows) + "\n")
    (folder / "marks.csv").write_text(next(block for block in blocks("csv") if "near left" in block))


def in_place(folder: Path) -> None:
    """A robot that leans to and fro before two marks; its images are not looked at."""
    describe(folder, camera="pinhole")
    (folder / "camera.yaml").write_text(blocks("yaml")[0])
    camera = open_camera(folder / "camera.yaml")
    assert isinstance(camera, PinholeCamera)
    write_sensors(folder, 2)
    marks, images, imu = ["file,name,u,v,x_m,y_m"], ["t,file"], ["t,roll,pitch,yaw,gx,gy,gz"]
    for k in range(200):
        roll, pitch = lean(k / 50.0)
        rates = (np.array(lean(k / 50.0 + 0.01)) - lean(k / 50.0 - 0.01)) / 0.02
        imu.append(f"{k / 50.0},{lean(k / 50.0 - 0.02)[0]},{lean(k / 50.0 - 0.02)[1]},0,{rates[0]},{rates[1]},0")
        if k % 7 == 6:
            body = Pose3.from_roll_pitch_yaw(roll, pitch).compose(camera.base_from_camera)
            images.append(f"{k / 50.0},images/{k}.jpg")
            for name, (u, v) in zip("abcd", camera.image_from_ground(MARKED, body), strict=True):
                marks.append(f"images/{k}.jpg,{name},{u},{v},,")
    for name, lines in (("marks", marks), ("images", images), ("imu", imu)):
        (folder / f"{name}.csv").write_text("\n".join(lines) + "\n")


MARKED: FloatArray = np.array([(1.2, 0.5), (1.2, -0.5), (2.5, 0.9), (2.5, -0.9)])


def lean(time_s: float) -> tuple[float, float]:
    return 0.06 * float(np.sin(6.0 * time_s)), 0.03 * float(np.sin(4.1 * time_s))


def features(folder: Path) -> None:
    describe(folder, camera="none")
    (folder / "observations.csv").write_text(blocks("csv")[1])


def test_every_command_does_what_the_page_says(
    small_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    short_walk(small_data, tmp_path / "walk")
    board(tmp_path / "board")
    in_place(tmp_path / "in-place")
    features(tmp_path / "features")
    assert len(commands()) >= 9
    for line in commands():
        words = shlex.split(line)
        assert words[0] == "touchline"
        status = main(words[1:])
        told = capsys.readouterr()
        if "calibrate self" in line:  # of a longer walk: test_calibrate_self_perspective.py
            assert status == 1
            assert "not calibrated: the recording leaves the camera's" in told.err
            continue
        assert status == 0, f"{line}\n{told.out}\n{told.err}"
        if "calibrate camera" in line:
            assert "4 marks agree to 0." in told.out, told.out
    assert (tmp_path / "stages" / "stages.png").is_file()
    found = open_camera(tmp_path / "camera.yaml")
    assert isinstance(found, PinholeCamera)
    assert found.fx == pytest.approx(493.0, rel=0.02)
    report = (tmp_path / "again" / "report.html").read_text()  # the worst image may be one of the five chosen evenly
    assert report.count("<strong>The field at") == report.count("<strong>Image ") >= 5


def test_a_run_that_sees_nothing_says_why(small_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A start that was told is not believed before something confirms it."""
    short_walk(small_data, tmp_path / "walk")
    (tmp_path / "walk" / "imu.csv").unlink()
    command = ["run", str(tmp_path / "walk"), "--system", "nimbro-lines", "--output", str(tmp_path / "run")]
    assert main([*command, "--start=-2.6,-1.2,0.3"]) == 1
    told = " ".join(capsys.readouterr().err.split())
    assert f"none of {FRAMES} images was localised: in {FRAMES} of them, nothing tells how the camera leans" in told


def test_the_python_of_the_page_runs(capsys: pytest.CaptureFixture[str]) -> None:
    (block,) = blocks("python")
    exec(compile(block, "how-to-humanoid.md", "exec"), {})
    assert "searching" in capsys.readouterr().out
