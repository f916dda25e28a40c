"""What is simulated today is what was recorded: tests/data/drives, and the last image of every shortened scenario.

`python lab/tests/test_simulated_again.py` renews the images; record_drives.py renews the drives.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from drives import FOLDER
from record_drives import DRIVES, drive_as, packed
from simulated import SECONDS

from touchline.geometry import FloatArray
from touchline.types import ImageArray
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario, scenario_names

IMAGES = Path(__file__).parent / "images.npz"
FEW = ("match", "crowd", "walk-hsl", "walk-falls", "cloud", "lens", "fisheye")
BLOCK_PX = 16


@pytest.mark.parametrize(
    "name", [name if name in FEW else pytest.param(name, marks=pytest.mark.slow) for name in DRIVES]
)
def test_a_drive_is_simulated_as_it_was_recorded(name: str) -> None:
    with np.load(FOLDER / f"{name}.npz") as file:
        was = dict(file)
    now = packed(drive_as(DRIVES[name]))
    assert set(now) == set(was)
    for key, table in was.items():
        if table.dtype.kind == "U":
            assert np.array_equal(table, now[key])
        else:
            np.testing.assert_allclose(_numbers(now[key]), _numbers(table), rtol=1e-5, atol=2e-5, err_msg=key)


def _numbers(table: np.ndarray) -> FloatArray:
    """Numbers of a table in its own units, where it holds those of integers in tenths of a per mille."""
    if table.ndim == 3 and table.dtype == np.uint8:
        kind = {2: np.int16, 4: np.int32}[len(table)]
        table = np.ascontiguousarray(np.moveaxis(table, 0, -1)).view(kind)[..., 0]
    return table * (1e-5 if table.dtype.kind in "iu" and table.ndim > 1 else 1.0)


def looked(name: str) -> ImageArray:
    """An image of a scenario, a block of pixels to one."""
    run = Simulation(open_scenario(name, 3, SECONDS.get(name, 1.5)))
    image = run.image(len(run) - 1)
    return cv2.resize(image, None, fx=1 / BLOCK_PX, fy=1 / BLOCK_PX, interpolation=cv2.INTER_AREA)


@pytest.mark.slow
@pytest.mark.parametrize("name", scenario_names())
def test_an_image_is_rendered_as_it_was(name: str) -> None:
    with np.load(IMAGES) as file:
        was = file[name].astype(np.float64)
    apart = np.abs(looked(name) - was)
    assert apart.max() <= 2.0
    assert apart.mean() < 0.1


if __name__ == "__main__":
    np.savez_compressed(IMAGES, **{name: looked(name) for name in scenario_names()})
