"""`touchline simulate`: a scenario becomes a recording."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from touchline.errors import InputError

if TYPE_CHECKING:
    from touchline.simulation.run import Simulation

_LONG_ENOUGH = 20  # images to calibrate a perspective camera with


def simulate(
    scenario: Annotated[
        str | None,
        typer.Argument(metavar="NAME|FILE", help="A scenario by name, or a file of your own.", show_default=False),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="DIR", help="The new recording's folder (default: NAME).", show_default=False
        ),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(min=0, help="Another run of the same kind (default: the scenario's).", show_default=False),
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(min=0.0, help="Length of the run (default: the scenario's).", show_default=False)
    ] = None,
    changes: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Change one key of the scenario; may be repeated."),
    ] = None,
    level: Annotated[
        str, typer.Option(metavar="images|points", help="Render images, or write what a detector would find in them.")
    ] = "images",
    listing: Annotated[bool, typer.Option("--list", help="List the scenarios and stop.")] = False,
) -> None:
    """Simulate a robot on a field and write a recording: images (or observations), sensors and the true poses.

    touchline simulate match --output runs/match --seconds 10   writes one; touchline run runs/match localises it.
    touchline simulate match --set others.robots=3 --set camera.motion_blur=true   changes what the scenario says.

    The same seed gives the same bytes. Without a name, the scenarios are listed.

    A recording that was simulated, in place of the name, is made again.
    """
    if listing or scenario is None:
        _list_scenarios()
        return
    from touchline.cli.console import output as console
    from touchline.simulation.run import Simulation
    from touchline.simulation.scenario import open_scenario

    chosen = open_scenario(scenario, seed, seconds, changes or ())
    folder = output if output is not None else Path(chosen.name)
    if folder.exists():
        raise InputError(f"{folder}: exists already and is not overwritten; choose another name with --output")
    try:
        simulation = Simulation(chosen, level)
    except InputError as error:
        raise InputError(f"{scenario}: {error}") from None
    started = time.perf_counter()
    _write_with_progress(simulation, folder)
    rate = len(simulation) / (time.perf_counter() - started)
    console().print(
        f"{folder}: {len(simulation)} images, {chosen.seconds:g} s of {chosen.name}, seed {chosen.seed} "
        f"({rate:.{0 if rate >= 10 else 1}f} images per second)",
        markup=False,
    )
    for line in _advice(simulation, folder):
        console().print(line, markup=False, style="dim")


def _advice(simulation: Simulation, folder: Path) -> Iterator[str]:
    """What to do with a recording, as commands that work with it."""
    beside = [name for name in ("marks.csv", "regions.yaml") if (folder / name).is_file()]
    if beside:
        yield f"for calibration: {', '.join(beside)}"
    if simulation.level == "points":
        yield f"touchline run {folder} localises it"
        return
    if simulation.camera_kind != "omni":
        if "marks.csv" not in beside:
            yield f"touchline run {folder} localises it"
        elif len(simulation) < _LONG_ENOUGH:
            yield f"touchline check {folder} tells what it holds"
        else:
            name = "imu" if simulation.scenario.calibration.kind == "fixed-marks" else "camera"
            yield f"touchline calibrate {name} {folder} --output camera.yaml calibrates its camera"
        return
    if "regions.yaml" in beside:
        yield f"touchline calibrate colour {folder} --output colours.npz learns the colours from the marked regions"
    if "marks.csv" in beside:
        yield f"touchline calibrate range {folder} --output camera.yaml fits the ranges to the marks"
    whole_turn = len(simulation) >= simulation.scenario.motion.points
    if simulation.scenario.calibration.kind == "strip" and whole_turn:
        yield f"touchline calibrate mirror {folder} --output camera.yaml measures the mirror as it is built"
    yield f"touchline run {folder} localises it"


def _write_with_progress(simulation: Simulation, folder: Path) -> None:
    from rich.progress import Progress

    from touchline.cli.console import errors_console
    from touchline.simulation.recording import write_recording

    console = errors_console()
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("simulating", total=len(simulation))
        write_recording(simulation, folder, lambda frame: progress.advance(task))


def _list_scenarios() -> None:
    from rich.table import Table

    from touchline.cli.console import output as console
    from touchline.simulation.scenario import open_scenario, scenario_names

    table = Table(box=None, header_style="dim", pad_edge=False, padding=(0, 2, 0, 0))
    for title in ("scenario", "what it shows", "field", "camera", "seconds"):
        table.add_column(title, overflow="fold")
    for name in scenario_names():
        scenario = open_scenario(name)
        table.add_row(name, scenario.description, scenario.field, scenario.camera.kind, f"{scenario.seconds:g}")
    out = console()
    out.print(table, soft_wrap=False)
    out.print("touchline simulate NAME --output DIR writes a recording", style="dim")
