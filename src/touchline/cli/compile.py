"""`touchline compile`: the compiled loops of all systems, made ahead of the first match."""

from __future__ import annotations

import time
from typing import Annotated

import typer


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
    """Half of the bundled recording, searched from nowhere and then tracked: every loop is called once."""
    from touchline.api import prepare
    from touchline.cli.run import example_recording

    prepared = prepare(example_recording(), system)
    for index, frame in enumerate(prepared.source):
        prepared.system.step(frame)
        if index >= 12:
            break


def _locate_example() -> None:
    import numpy as np

    from touchline.field import open_field
    from touchline.geometry import Pose
    from touchline.localization import locate_points

    field = open_field("msl-18x12")
    seen = Pose(2.0, 1.0, 0.3).inverse().transform(np.vstack(list(field.polylines(0.1))))
    locate_points(np.ascontiguousarray(seen[np.hypot(*seen.T) < 5.0]), field)


def _render_example() -> None:
    from touchline.simulation.run import Simulation
    from touchline.simulation.scenario import open_scenario

    for name in ("match", "humanoid-walk"):
        for level in ("images", "points"):
            next(iter(Simulation(open_scenario(name, 0, 0.5), level)))
