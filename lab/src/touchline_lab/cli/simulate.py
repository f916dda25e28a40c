"""`touchline simulate`: a scenario becomes a recording."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from touchline.cli.console import output as output_console
from touchline.cli.console import plain_table, say, steps_shown
from touchline.errors import InputError

if TYPE_CHECKING:
    from touchline_lab.simulation.run import Simulation

_LONG_ENOUGH = 20  # images to calibrate a perspective camera with


def simulate(
    scenario: Annotated[
        str | None, typer.Argument(metavar="NAME|FILE", help="A scenario by name, or a file of your own.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="DIR", help="The new recording's folder (default: NAME).")
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Another run of the same kind (default: the scenario's).")
    ] = None,
    seconds: Annotated[float | None, typer.Option(min=0.0, help="Length of the run (default: the scenario's).")] = None,
    changes: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Change one key of the scenario; may be repeated."),
    ] = None,
    level: Annotated[
        Literal["images", "points"], typer.Option(help="Render images, or write what a detector would find in them.")
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
    from touchline_lab.simulation.recording import write_recording
    from touchline_lab.simulation.run import Simulation
    from touchline_lab.simulation.scenario import open_scenario

    chosen = open_scenario(scenario, seed, seconds, changes or ())
    folder = output if output is not None else Path(chosen.name)
    if folder.exists():
        raise InputError(f"{folder}: exists already and is not overwritten; choose another name with --output")
    try:
        simulation = Simulation(chosen, level)
    except InputError as error:
        raise InputError(f"{scenario}: {error}") from None
    started = time.perf_counter()
    with steps_shown("simulating", len(simulation)) as advance:
        write_recording(simulation, folder, advance)
    rate = len(simulation) / (time.perf_counter() - started)
    say(
        f"{folder}: {len(simulation)} images, {chosen.seconds:g} s of {chosen.name}, seed {chosen.seed} "
        f"({rate:.{0 if rate >= 10 else 1}f} images per second)"
    )
    say(*_advice(simulation, folder), style="dim")


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


def _list_scenarios() -> None:
    from touchline_lab.simulation.scenario import open_scenario, scenario_names

    scenarios = ((name, open_scenario(name)) for name in scenario_names())
    rows = ((name, each.description, each.field, each.camera.kind, f"{each.seconds:g}") for name, each in scenarios)
    titles = "scenario", "what it shows", "field", "camera", "seconds"
    output_console().print(plain_table(*titles, rows=rows, numbers_from=None, overflow="fold"), soft_wrap=False)
    say("touchline simulate NAME --output DIR writes a recording", style="dim")
