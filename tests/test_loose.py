"""Videos, numbered images and odometry of any columns, as recordings."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from touchline.cli import main
from touchline.errors import InputError
from touchline.sources import open_source
from touchline.sources.loose import odometry_rows, parse_columns

FIELD = ("--field", "spl-9x6")


def picture(index: int) -> np.ndarray:
    image = np.full((48, 64, 3), 40, dtype=np.uint8)
    image[:, 4 * index : 4 * index + 8] = 200
    return image


@pytest.fixture
def images(tmp_path: Path) -> Path:
    """Twelve images; by their letters alone, img-10 would come before img-2."""
    folder = tmp_path / "shots"
    folder.mkdir()
    for index in range(12):
        cv2.imwrite(str(folder / f"img-{index}.png"), picture(index))
    return folder


def test_numbered_images_with_a_rate_become_a_recording(images: Path, tmp_path: Path) -> None:
    assert main(["convert", str(images), str(tmp_path / "r"), "--rate", "30", *FIELD]) == 0
    recording = open_source(tmp_path / "r")
    assert recording.image_stamps.tolist() == [round(index * 1e9 / 30) for index in range(12)]
    assert recording.rate_hz == pytest.approx(30.0)
    for index, frame in enumerate(recording):
        assert np.array_equal(frame.image, picture(index))
    assert (tmp_path / "r/images/000002.png").read_bytes() == (images / "img-2.png").read_bytes()


@pytest.mark.parametrize(("name", "code"), [("walk.mp4", "mp4v")])
def test_a_video_becomes_a_recording_with_its_own_times(name: str, code: str, tmp_path: Path) -> None:
    writer = cv2.VideoWriter(str(tmp_path / name), cv2.VideoWriter.fourcc(*code), 25.0, (64, 48))
    for index in range(10):
        writer.write(picture(index))
    writer.release()
    assert main(["convert", str(tmp_path / name), str(tmp_path / "r.mcap"), *FIELD]) == 0
    recording = open_source(tmp_path / "r.mcap")
    assert np.allclose(np.diff(recording.image_stamps), 40_000_000, atol=1000)
    frames = list(recording)
    assert len(frames) == 10
    for index, frame in enumerate(frames):
        assert frame.image is not None
        assert np.abs(frame.image.astype(float) - picture(index)).mean() < 6.0


def test_odometry_of_any_columns_is_beside_the_images(images: Path, tmp_path: Path) -> None:
    lines = ["theta_in_deg;stamp_ns;north;east"]
    lines += [f"{90 + i};{1_763_780_000_000_000_000 + 20_000_000 * i};{0.1 * i:.1f};2.5" for i in range(30)]
    (tmp_path / "odo.csv").write_text("\n".join(lines) + "\n")
    options = ["--odometry", str(tmp_path / "odo.csv"), "--first-image-at", "1763780000.000000000"]
    columns = "theta_deg=theta_in_deg,t_ns=stamp_ns,y=north,x=4"
    command = ["convert", str(images), str(tmp_path / "r"), "--rate", "30", *options, "--columns", columns, *FIELD]
    assert main(command) == 0
    written = (tmp_path / "r/odometry.csv").read_text().splitlines()
    assert written[2] == f"1763780000.02,2.5,0.1,{91 * np.pi / 180!r}"
    second = list(open_source(tmp_path / "r"))[1]
    assert second.odometry is not None
    assert second.odometry.values[0, 2] == pytest.approx(np.radians(91))


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ("t=a,x=b,y=c", "needs t, x, y and theta once each"),
        ("t=a,x=b,x_mm=d,y=c,theta=e", "needs t, x, y and theta once each"),
        ("t=a,x=b,y=c,thta=e", "did you mean 'theta'"),
        ("t=a,x=b,y=c,theta=e", "has no column 'e'; its columns are a, b, c and d"),
        ("t=a,x=b,y=c,theta=d", "line 3: theta reads 'none', which is no number"),
    ],
)
def test_columns_that_do_not_fit_are_told(columns: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "odo.csv").write_text("a,b,c,d\n0,1,2,3\n1,1,2,none\n")
    with pytest.raises(InputError, match=said):
        list(odometry_rows(tmp_path / "odo.csv", parse_columns(columns)))


@pytest.mark.parametrize("number", ["9" * 5000, "²", "0", "5"])
def test_a_column_that_is_none_is_named(number: str, tmp_path: Path) -> None:
    (tmp_path / "odo.csv").write_text("1 2 3 4\n")
    with pytest.raises(InputError, match="has no column"):
        list(odometry_rows(tmp_path / "odo.csv", parse_columns(f"x={number},y=2,t=3,theta=4")))
