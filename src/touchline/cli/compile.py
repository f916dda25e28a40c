"""`touchline compile`: the compiled loops of all systems, made ahead of the first match."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from touchline.camera import Camera
    from touchline.geometry import FloatArray
    from touchline.types import ImageArray


def compile_loops(
    simulator: Annotated[
        bool, typer.Option("--simulator", help="Those of the simulator's renderer, too: half a minute more.")
    ] = False,
) -> None:
    """Compile the inner loops of every system once, so that no later start waits for it; for installers and images."""
    from touchline.cli.console import output
    from touchline.systems import SYSTEMS

    console = output()
    for name, info in SYSTEMS.items():
        started = time.perf_counter()
        if "omni" in info.cameras:
            _run_example(name)
        else:
            _walk_example(name)
        console.print(f"{name}: ready after {time.perf_counter() - started:.1f} s")
    started = time.perf_counter()
    _locate_example()
    console.print(f"locate: ready after {time.perf_counter() - started:.1f} s")
    if simulator:
        started = time.perf_counter()
        _render_example()
        console.print(f"simulator: ready after {time.perf_counter() - started:.1f} s")
    console.print("all loops are compiled; their code is kept beside the package, or in NUMBA_CACHE_DIR if that is set")


def _run_example(system: str) -> None:
    """The bundled recording, searched from nowhere and tracked, with its report; then points without an image."""
    import numpy as np

    from touchline.api import prepare
    from touchline.cli.run import example_recording
    from touchline.evaluation.run_folder import new_folder
    from touchline.localizer import Localizer
    from touchline.types import points_at

    with tempfile.TemporaryDirectory() as folder:
        prepare(example_recording(), system).execute(new_folder(Path(folder) / "run", system))
    robot = Localizer("msl-18x12", system=system)
    for k in range(3):
        robot.add_odometry(k * 100_000_000, 0.0, 0.0, 0.0)
        robot.localize(k * 100_000_000, points=points_at(np.ascontiguousarray(_view())))
        robot.localize(k * 100_000_000 + 1, points=_view())


def _walk_example(system: str) -> None:
    """A walking humanoid: what a detector of its own finds, and drawn images."""
    from touchline.geometry import Pose
    from touchline.localizer import Localizer
    from touchline.simulation.run import Simulation
    from touchline.simulation.scenario import open_scenario

    walk = Simulation(open_scenario("humanoid-walk", 0, 2.0), "points")
    robot = Localizer(walk.field, camera=walk.camera, system=system)
    for frame, pose in zip(walk, walk.truth.poses, strict=False):
        robot.add_odometry(frame.stamp_ns, *pose.tolist())
        seen = Pose(*pose.tolist()).inverse()
        lines = [seen.transform(line) for line in walk.field.polylines(0.1)]
        image = _drawn(walk.camera, lines)
        robot.add_attitude(frame.stamp_ns, 0.0, 0.0)
        robot.localize(frame.stamp_ns, observation=frame.observation)
        robot.localize(frame.stamp_ns + 1, image)


def _drawn(camera: Camera, lines: list[FloatArray]) -> ImageArray:
    """An image of carpet and lines, polylines (M, 2) in the robot frame (m), as a camera on a level robot sees them."""
    import cv2
    import numpy as np

    image = np.full((camera.height, camera.width, 3), (60, 140, 50), np.uint8)
    for line in lines:
        pixels = camera.image_from_ground(line)
        near = np.hypot(*line.T) < 5.0
        for start, end in zip(pixels[:-1][near[:-1]], pixels[1:][near[:-1]], strict=True):
            if np.isfinite([start, end]).all() and np.abs([start, end]).max() < 5000.0:
                cv2.line(image, start.astype(int).tolist(), end.astype(int).tolist(), (235, 235, 235), 8)
    return image


def _locate_example() -> None:
    from touchline.field import open_field
    from touchline.localization import locate_points

    locate_points(_view(), open_field("msl-18x12"))


def _view() -> FloatArray:
    """Points (N, 2) of the lines within 5 m of a robot, robot frame."""
    import numpy as np

    from touchline.field import open_field
    from touchline.geometry import Pose

    lines = np.vstack(list(open_field("msl-18x12").polylines(0.1)))
    seen = Pose(2.0, 1.0, 0.3).inverse().transform(lines)
    return np.ascontiguousarray(seen[np.hypot(*seen.T) < 5.0])


def _render_example() -> None:
    from touchline.simulation.run import Simulation
    from touchline.simulation.scenario import open_scenario

    for name in ("match", "humanoid-walk"):
        for level in ("images", "points"):
            next(iter(Simulation(open_scenario(name, 0, 0.5), level)))
