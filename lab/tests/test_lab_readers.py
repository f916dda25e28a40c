"""Hostile files are read or refused by the lab's readers, too; those of the core: tests/test_fuzz.py."""

from __future__ import annotations

import io
import shutil
import warnings
from pathlib import Path

import cv2
import numpy as np
import pytest
from fuzz_mutations import mutated_archive
from fuzz_reader import SEQUENCE, Reader, new_folder, small_recording
from fuzzing import hostile, outcome, turns

from touchline.sources import open_source
from touchline_lab.points.point_set import read_point_set
from touchline_lab.simulation.cameras.image_sensor import LinearImageCamera
from touchline_lab.simulation.scenario import SCENARIO_FOLDER, open_scenario

SENSOR = "gamma: 2.2, linear_png: true, linear_radiance_at_65535: 4.0, optics_blur_sigma_px: 0.5"


def point_set() -> bytes:
    arrays = {"offsets": np.array([0, 3, 6]), "points": np.ones((6, 2)), "is_outlier": np.zeros(6, np.bool_)}
    poses = {"truth": np.zeros((2, 3)), "init": np.zeros((2, 3)), "compass": np.zeros(2)}
    lines = {"segments": np.array([[-3.0, 2.0, 3.0, 2.0]]), "arcs": np.array([[0.0, 0.0, 1.0, 0.0, 3.0]])}
    packed = io.BytesIO()
    np.savez(packed, **arrays, **poses, **lines)
    return packed.getvalue()


def lab_readers(workplace: Path) -> list[Reader]:
    linear = small_recording(new_folder(workplace, "linear"))
    (linear / "sequence.yaml").write_text(SEQUENCE.replace("gamma: 2.2", SENSOR))
    deep = np.random.default_rng(3).integers(0, 65535, (24, 32, 3), dtype=np.uint16)
    (linear / "images/000000.jpg").write_bytes(cv2.imencode(".png", deep)[1].tobytes())
    scenarios = [path.read_bytes() for path in sorted(SCENARIO_FOLDER.glob("*.yaml"))]
    readers = [
        Reader("scenario", workplace / "scenario.yaml", scenarios, open_scenario),
        Reader("point set", workplace / "points.npz", [point_set()], read_point_set, 1.0, mutated_archive),
    ]
    for name in ("sequence.yaml", "images/000000.jpg"):
        copy = Path(shutil.copytree(linear, workplace / f"linear-{Path(name).name}"))

        def linear_image(_: Path, folder: Path = copy) -> None:
            LinearImageCamera.open(open_source(folder), 0)

        readers.append(Reader(f"linear image, {name}", copy / name, [(copy / name).read_bytes()], linear_image, 0.5))
    return readers


@pytest.mark.slow
def test_hostile_files_are_read_or_refused(tmp_path: Path) -> None:
    readers = lab_readers(tmp_path)
    for reader in readers:
        reader.try_one(reader.seeds[0])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = [outcome(one, k, hostile(one, 0, k)) for one, k in turns(readers, 150)]
    assert [one for one in found if one.fault] == []
