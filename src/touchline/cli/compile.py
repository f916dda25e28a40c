"""`touchline compile`: the compiled loops of all systems, made ahead of the first match."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from touchline.geometry import FloatArray


def compile_loops(
    simulator: Annotated[
        bool, typer.Option("--simulator", help="Those of the simulator's renderer, too: half a minute more.")
    ] = False,
) -> None:
    """Compile the inner loops of every system once, so that no later start waits for it; for installers and images."""
    from touchline.cli.console import output
    from touchline.systems import SYSTEMS

    console = output()
    for name in SYSTEMS:
        started = time.perf_counter()
        _run_example(name)
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
