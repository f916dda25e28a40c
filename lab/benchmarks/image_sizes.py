"""How much longer a larger image takes to its pose: one scenario, simulated with its camera at two sizes.

    python lab/benchmarks/image_sizes.py CAMERA.yaml FACTOR [FACTOR] [--scenario NAME] [--images N] [--rounds N]

CAMERA.yaml is that of a recording (omni or pinhole); each factor multiplies its width, height and what is in pixels.
Images are measured as image_to_pose.py does. A mirror of 1024 x 1024 takes some seconds to render an image.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import yaml
from image_to_pose import LEARNING, measure

from touchline_lab.simulation.recording import write_recording
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario


def scaled(camera: dict[str, Any], factor: float) -> dict[str, Any]:
    """A camera.yaml's content for an image so many times as wide and high, that shows the same."""
    tree = camera | {key: round(factor * camera[key]) for key in ("width", "height")}
    tree |= {key: factor * value for key, value in camera.items() if key in ("fx", "fy") or key.endswith("_px")}
    tree |= {key: (camera[key] + 0.5) * factor - 0.5 for key in ("cx", "cy") if key in camera}
    if "center" in camera:
        tree["center"] = [(value + 0.5) * factor - 0.5 for value in camera["center"]]
        radii = [factor * value for value in camera["range_table"]["radius_px"]]
        tree["range_table"] = camera["range_table"] | {"radius_px": radii}
    return tree


def main() -> None:
    """Print a row for each size."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("camera", type=Path)
    parser.add_argument("factors", type=float, nargs="+", metavar="FACTOR")
    parser.add_argument("--scenario", default="humanoid-walk")
    parser.add_argument("--images", type=int, default=120)
    parser.add_argument("--rounds", type=int, default=3)
    given = parser.parse_args()
    camera, first_ms = yaml.safe_load(given.camera.read_text()), 0.0
    with TemporaryDirectory() as scratch:
        for factor in given.factors:
            tree, folder = scaled(camera, factor), Path(scratch) / f"{factor:g}"
            folder.with_suffix(".yaml").write_text(yaml.safe_dump(tree))
            scenario = open_scenario(given.scenario, changes=[f"camera.file={folder.with_suffix('.yaml')}"])
            scenario = scenario.model_copy(update={"seconds": given.images / scenario.camera.rate_hz})
            write_recording(Simulation(scenario), folder)
            found = measure(folder, ["touchline"], given.images, given.rounds)
            median_ms = float(np.median(found["touchline"][LEARNING:]))
            first_ms = first_ms or median_ms
            print(f"{tree['width']} x {tree['height']}: {median_ms:.2f} ms, {median_ms / first_ms:.2f} times the first")


if __name__ == "__main__":
    main()
