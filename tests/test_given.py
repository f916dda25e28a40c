"""What is given to the public functions: taken where it is clear what is meant, else refused in words."""

from __future__ import annotations

import tarfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import touchline
from touchline.errors import InputError, TouchlineError
from touchline.field import FieldModel
from touchline.geometry import Pose
from touchline.given import given_switch
from touchline.types import Frame, Prior, points_at

EXAMPLE = Path(__file__).parents[1] / "examples" / "omni_msl_track_short"
FIELD = touchline.open_field("msl-18x12")
CAMERA = touchline.open_camera(EXAMPLE / "camera.yaml")
AROUND = [[2.0, 0.5], [1.0, -1.0], [-2.0, 0.0]]
JUNK = [3.5, (9, 6), [9, 6], {"length": 9}, object(), b"msl-18x12", np.zeros(3), "no-such", "\0", "x" * 5000, {"a"}]


def system(setup: Any = None, **others: Any) -> Any:
    return touchline.open_system("nubot-mti", setup or touchline.RobotSetup(FIELD), **others)


def run(tmp_path: Path, **others: Any) -> Any:
    """Everything is refused before anything is written."""
    return touchline.run(EXAMPLE, **{"output": tmp_path / "run", "overrides": ["nothing=0"], **others})


REFUSED: dict[str, tuple[str, Callable[[Any], Any]]] = {
    "field": ("field|no such", touchline.open_field),
    "camera": ("camera|: ", touchline.open_camera),
    "recording": ("recording", touchline.open_source),
    "system": ("system", lambda junk: touchline.open_system(junk, touchline.RobotSetup(FIELD))),
    "setup": ("setup: expected a RobotSetup", lambda junk: touchline.open_system("nubot-mti", junk)),
    "settings": ("setting|takes", lambda junk: system(settings=junk)),
    "rng": ("seed: expected a whole number", lambda junk: system(rng=junk)),
    "setup's field": ("field|no such", touchline.RobotSetup),
    "setup's camera": ("camera|: ", lambda junk: touchline.RobotSetup(FIELD, junk)),
    "frame": ("steps a Frame", lambda junk: system().step(junk)),
    "localizer's system": ("system", lambda junk: touchline.Localizer(FIELD, system=junk)),
    "localizer's seed": ("seed", lambda junk: touchline.Localizer(FIELD, seed=junk)),
    "run": ("run", touchline.evaluate),
    "located field": ("field|no such", lambda junk: touchline.locate(AROUND, junk)),
    "points of an observation": ("points: expected LinePoints", lambda junk: touchline.Observation(0, junk)),
}


@pytest.mark.parametrize("junk", JUNK, ids=lambda junk: f"{type(junk).__name__}-{str(junk)[:6]!r}")
@pytest.mark.parametrize("what", REFUSED)
def test_what_cannot_be_meant_is_refused_in_words(what: str, junk: object) -> None:
    told, call = REFUSED[what]
    with pytest.raises(TouchlineError, match=told):
        call(junk)


@pytest.mark.parametrize("name", ["start", "own_half", "config", "overrides", "seed", "system", "output"])
@pytest.mark.parametrize("junk", [object(), (1, 2), "no", {"a": 1}, b"x", 1.5])
def test_a_run_refuses_in_words_and_writes_nothing(name: str, junk: object, tmp_path: Path) -> None:
    if name == "output" and isinstance(junk, str):
        return  # a folder of that name
    with pytest.raises(InputError):
        run(tmp_path, **{name: junk})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("junk", [3, (1, 2, 3), "0.8,-0.8", (0.8, np.nan), {"a_dir_rad": 0.8, "b_dir_rad": -0.8}])
def test_wheels_are_two_angles(junk: Any) -> None:
    with pytest.raises(InputError, match="wheels: expected the two rolling directions"):
        touchline.RobotSetup(FIELD, None, junk)


def test_names_paths_and_numbers_are_taken() -> None:
    assert touchline.open_field(FIELD) is FIELD
    assert touchline.open_camera(CAMERA) is CAMERA
    source = touchline.open_source(EXAMPLE)
    assert touchline.open_source(source) is source
    setup = touchline.RobotSetup("msl-18x12", str(EXAMPLE / "camera.yaml"), [0.8, -0.8])  # type: ignore[arg-type]
    assert isinstance(setup.field, FieldModel)
    assert (setup.field, setup.wheel_directions_rad) == (FIELD, (0.8, -0.8))
    assert setup.camera is not None
    assert setup.camera.model == "omni"
    made = system(setup, settings={"matching.c_m": 0.3}, rng=3)
    assert made.settings.matching.c_m == 0.3
    for pose in ((1.0, 2.0, 0.5), [1, 2, 0.5], np.array([1.0, 2.0, 0.5]), Pose(1.0, 2.0, 0.5)):
        for name in ("nubot-mti", "nubot-mcl", "nubot-mcl-alone", "iris-fusion"):
            told = touchline.open_system(name, setup)
            told.reset(pose)  # type: ignore[arg-type]
            assert told.step(Frame(0)).pose.distance_to(Pose(1.0, 2.0, 0.5)) < 1e-9


@pytest.mark.parametrize("junk", ["own_half", (1, 2), {"pose": (1, 2, 0)}, 3, FIELD])
def test_a_prior_is_a_prior_or_a_pose(junk: Any) -> None:
    with pytest.raises(InputError, match="start pose: expected x, y"):
        system().reset(junk)


def test_positions_are_points() -> None:
    plain = touchline.Observation(0, points_at(np.array(AROUND)))
    for given in (AROUND, np.array(AROUND)):
        taken = touchline.Observation(0, given)  # type: ignore[arg-type]
        np.testing.assert_array_equal(taken.points.covariances_m2, plain.points.covariances_m2)
    lists = touchline.LinePoints(AROUND, np.zeros((3, 2, 2)), [1, 1, 1], AROUND)  # type: ignore[arg-type]
    assert lists.positions_m.shape == (3, 2)
    assert system().step(Frame(0, observation=AROUND)).observation.problem is not None  # type: ignore[arg-type]
    assert Prior() == touchline.types.as_prior(None)


def write_zip(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("sequence.yaml", "format: 1")


def write_tar(path: Path) -> None:
    with tarfile.open(path, "w:gz") as file:
        file.add(EXAMPLE / "sequence.yaml", "sequence.yaml")


@pytest.mark.parametrize(
    ("name", "write", "told"),
    [
        ("match.zip", write_zip, "is a packed archive: unpack it and give the folder"),
        ("match.tgz", write_tar, "is a packed archive: unpack it and give the folder"),
        ("match.mp4", lambda path: path.write_bytes(b"\0\0\0 ftypisom"), "touchline convert 'match.mp4' recording"),
        ("match.avi", lambda path: path.write_bytes(b"RIFF"), "touchline convert 'match.avi' recording"),
        ("match.mcap", lambda path: path.write_bytes(b"half"), "ends like a bag but is none"),
        ("frame.jpg", lambda path: path.write_bytes(b"\xff\xd8\xff"), "is one image"),
        ("images.csv", lambda path: path.write_text("t,file\n"), "is one file of a recording: give its folder, "),
    ],
)
def test_files_are_told_how_to_become_a_recording(
    tmp_path: Path, name: str, write: Callable[[Path], object], told: str
) -> None:
    write(tmp_path / name)
    with pytest.raises(InputError) as raised:
        touchline.open_source(tmp_path / name)
    assert str(raised.value).startswith(f"{tmp_path / name}: ")
    assert told in str(raised.value)


def test_a_switch_is_true_or_false() -> None:
    assert [given_switch("half", value) for value in (True, False, np.True_, np.False_)] == [True, False, True, False]
    for junk in ("no", 1, None, np.zeros(1)):
        with pytest.raises(InputError, match="half: expected True or False"):
            given_switch("half", junk)
