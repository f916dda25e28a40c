"""Colour tables: learned from marks and without, saved, loaded, shown, and used by the detector."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from synthetic import line_field, mirror_camera, paint_ground
from syrupy.assertion import SnapshotAssertion

from touchline.calibration.colour import calibrate_marked, calibrate_unmarked, read_regions
from touchline.camera import OmniCamera
from touchline.cli import main
from touchline.errors import InputError
from touchline.perception import self_learning
from touchline.perception.colour import GREEN, OTHER, WHITE, ColourModel
from touchline.perception.colour_ellipses import FIXED, USUAL_BLACK, Ellipse, learned_names
from touchline.perception.colour_file import load_colours, save_colours
from touchline.perception.line_graph import colour_classes as line_graph
from touchline.perception.line_graph.colour_classes import colour_codes
from touchline.perception.self_learning import LearningSettings, SelfLearningDetector
from touchline.types import Frame, ImageArray

LINES = [(1.0, 0.0, 1.5), (0.0, 1.0, -1.0), (0.0, 1.0, 2.0)]
CARPET, PAINT, SHIRT, BALL = (60, 140, 70), (225, 230, 228), (190, 40, 200), (30, 120, 235)


@pytest.fixture(scope="module")
def camera() -> OmniCamera:
    return mirror_camera()


@pytest.fixture(scope="module")
def image(camera: OmniCamera) -> ImageArray:
    return paint_ground(camera, line_field(LINES), noise=2.0, samples=2)


@pytest.fixture(scope="module")
def colours(camera: OmniCamera, image: ImageArray) -> ColourModel:
    return calibrate_unmarked([image], camera, "scene").colours


def patches(folder: Path) -> Path:
    """An image of four colours in four quarters, noisy, and regions that mark each with a box or a polygon."""
    picture = np.zeros((80, 80, 3))
    for k, colour in enumerate((CARPET, PAINT, SHIRT, BALL)):
        picture[40 * (k // 2) : 40 * (k // 2) + 40, 40 * (k % 2) : 40 * (k % 2) + 40] = colour
    picture += np.random.default_rng(0).normal(0.0, 3.0, picture.shape)
    data = cv2.imencode(".png", np.clip(picture, 0, 255).astype(np.uint8))[1].tobytes()
    (folder / "patches.png").write_bytes(data)
    rows = [
        {"file": "patches.png", "class": "green", "polygon": [[2, 2], [37, 2], [37, 37], [2, 37]]},
        {"file": "patches.png", "class": "white", "box": [43, 3, 77, 37]},
        {"file": "patches.png", "class": "magenta", "box": [3, 43, 37, 77]},
        {"file": "patches.png", "class": "orange", "polygon": [[43, 43], [77, 43], [77, 77]]},
    ]
    (folder / "regions.yaml").write_text(yaml.safe_dump(rows))
    return folder / "regions.yaml"


# --- learning ---------------------------------------------------------------------------------------------------------


def test_marked_colours_come_out_as_they_were_marked(tmp_path: Path) -> None:
    calibration = calibrate_marked(tmp_path, patches(tmp_path))
    classes = calibration.colours.classify(calibration.image)
    wanted = np.repeat(np.repeat([[GREEN, WHITE], [OTHER, OTHER]], 40, axis=0), 40, axis=1)
    assert np.mean(classes == wanted) > 0.995
    assert calibration.colours.green == pytest.approx(CARPET, abs=1.0)
    assert calibration.colours.white == pytest.approx(PAINT, abs=1.0)


def test_marked_colours_set_the_ellipses_and_black(tmp_path: Path) -> None:
    """Olive is no usual yellow, and a grey dome no usual black; both are once they are marked."""
    olive, dome = (60, 95, 105), (48, 50, 52)
    picture = np.zeros((40, 120, 3))
    for k, colour in enumerate((CARPET, olive, dome)):
        picture[:, 40 * k : 40 * k + 40] = colour
    picture = np.clip(picture + np.random.default_rng(1).normal(0.0, 3.0, picture.shape), 0, 255).astype(np.uint8)
    (tmp_path / "patches.png").write_bytes(cv2.imencode(".png", picture)[1].tobytes())
    boxes = [("green", [2, 2, 37, 37]), ("yellow", [43, 3, 77, 37]), ("black", [83, 3, 117, 37])]
    rows = [{"file": "patches.png", "class": kind, "box": box} for kind, box in boxes]
    (tmp_path / "regions.yaml").write_text(yaml.safe_dump(rows))
    colours = calibrate_marked(tmp_path, tmp_path / "regions.yaml").colours
    assert learned_names(colours.ellipses) == ("yellow",)
    seen = np.array([olive, dome, [1.3 * value for value in olive]], dtype=np.float64)
    assert colour_codes(seen, colours).tolist() == [line_graph.YELLOW, line_graph.BLACK, line_graph.YELLOW]
    unmarked = replace(colours, ellipses=FIXED, black=USUAL_BLACK)
    assert colour_codes(seen, unmarked).tolist() == [line_graph.OTHER] * 3


# --- files ------------------------------------------------------------------------------------------------------------


def test_a_table_survives_its_file(colours: ColourModel, tmp_path: Path) -> None:
    file = tmp_path / "colours.npz"
    save_colours(colours, file)
    loaded = load_colours(file)
    assert np.array_equal(loaded.table, colours.table)
    for name in ("green", "white", "signal"):
        assert np.array_equal(getattr(loaded, name), getattr(colours, name))
    assert (loaded.noise, loaded.ellipses, loaded.black) == (colours.noise, colours.ellipses, colours.black)


def test_other_files_are_refused(colours: ColourModel, tmp_path: Path) -> None:
    file = tmp_path / "colours.npz"
    with pytest.raises(InputError, match="cannot be read"):
        load_colours(file)
    file.write_bytes(b"not at all")
    with pytest.raises(InputError, match="is not a colour table"):
        load_colours(file)
    np.savez(file, table=np.zeros(3))
    with pytest.raises(InputError, match="is not a colour table"):
        load_colours(file)
    file.unlink()
    save_colours(colours, file)
    whole = dict(np.load(file))
    np.savez(file, **(whole | {"format": np.array("other 7")}))
    with pytest.raises(InputError, match="another format"):
        load_colours(file)
    np.savez(file, **({name: whole[name] for name in whole if name != "ellipses"} | {"format": "touchline colours 1"}))
    with pytest.raises(InputError, match=r"another format \(touchline colours 1\); make it anew"):
        load_colours(file)
    for name, value in (("u", 1e300), ("uu", -4.0), ("uv", 1e4)):
        ellipses = whole["ellipses"].copy()
        ellipses[1, Ellipse._fields.index(name)] = value
        np.savez(file, **(whole | {"ellipses": ellipses}))
        with pytest.raises(InputError, match="the ellipse of yellow in 'ellipses' is none"):
            load_colours(file)
    np.savez(file, **(whole | {"black": np.array(7.0)}))
    with pytest.raises(InputError, match="'black' is no ratio"):
        load_colours(file)
    np.savez(file, **(whole | {"green": np.array([np.nan, 1.0, 1.0])}))
    with pytest.raises(InputError, match="damaged: 'green'"):
        load_colours(file)
    np.savez(file, **(whole | {"table": whole["table"] + np.uint8(7)}))
    with pytest.raises(InputError, match="classes that are not known"):
        load_colours(file)
    file.unlink()
    save_colours(colours, file)
    file.write_bytes(file.read_bytes()[:900])
    with pytest.raises(InputError, match="is not a colour table"):
        load_colours(file)


# --- regions.yaml -----------------------------------------------------------------------------------------------------


def test_what_is_wrong_with_regions_is_told(tmp_path: Path, snapshot: SnapshotAssertion) -> None:
    file, told = tmp_path / "regions.yaml", []
    for text in (
        "[",
        "{}",
        "- green",
        "- {class: green, box: [1, 2, 3, 4]}",
        "- {file: a.png, class: gren, box: [1, 2, 3, 4]}",
        "- {file: a.png, class: green}",
        "- {file: a.png, class: green, box: [1, 2, 3, 4], polygon: [[1, 2]]}",
        "- {file: a.png, class: green, polygon: [[1, 2], [3, 4]]}",
        "- {file: a.png, class: green, box: [1, 2, here, 4]}",
        "- {file: a.png, class: green, box: [1, 2, .nan, 4]}",
    ):
        file.write_text(text)
        with pytest.raises(InputError) as refused:
            read_regions(file)
        told.append(str(refused.value).replace(str(tmp_path), ""))
    rows = yaml.safe_load(patches(tmp_path).read_text())
    for change in (
        {"file": "lost.png"},
        {"box": [900, 900, 950, 950], "polygon": None},
        {"class": "yellow"},
        {"box": [43, 3, 77, 37], "polygon": None},
    ):
        changed = {key: value for key, value in (rows[0] | change).items() if value is not None}
        file.write_text(yaml.safe_dump([changed, *rows[1:]]))
        with pytest.raises(InputError) as refused:
            calibrate_marked(tmp_path, file)
        told.append(str(refused.value).replace(str(tmp_path), ""))
    assert told == snapshot


# --- use --------------------------------------------------------------------------------------------------------------


def test_a_kept_table_is_never_learned_anew(
    camera: OmniCamera, image: ImageArray, colours: ColourModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    save_colours(colours, tmp_path / "colours.npz")
    monkeypatch.setattr(self_learning, "FADED_FRAMES", 1)
    learning = LearningSettings(colour_file=str(tmp_path / "colours.npz"), frames=2)
    detector = SelfLearningDetector(camera, learning=learning)
    dim, warm = ((image * light).astype(np.uint8) for light in (0.5, (0.7, 1.0, 1.3)))
    for stamp, picture in enumerate((image, image, warm, dim, dim, dim)):
        detector.observe(Frame(stamp, image=picture))
        assert detector.detector.colours is not None
        assert np.array_equal(detector.detector.colours.table, colours.table)
        assert np.array_equal(detector.detector.colours.green, colours.green)


# --- the command ------------------------------------------------------------------------------------------------------


def test_the_command_learns_from_an_image(small_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = small_data / "real" / "omni"
    output = tmp_path / "colours.npz"
    camera_file = str(folder / "nubot_a.camera.yaml")
    photo = str(folder / "nubot_a.png")
    assert main(["calibrate", "colour", photo, "--camera", camera_file, "--output", str(output)]) == 0
    assert "without marks: green" in capsys.readouterr().out
    assert cv2.imread(str(tmp_path / "colours.png")).shape == (680, 1280, 3)
    marks = json.loads((folder / "nubot_a.json").read_text())
    classes = load_colours(output).classify(cv2.imread(photo).astype(np.uint8))
    assert np.mean([classes[v, u] == GREEN for u, v in marks["green_not_line"]]) >= 0.95
    assert main(["calibrate", "colour", photo, "--output", str(tmp_path / "b.npz")]) == 2
    assert "--camera FILE" in capsys.readouterr().err
