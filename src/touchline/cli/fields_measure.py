"""`touchline fields measure`: which sizes of a field the observations want otherwise."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from touchline.cli.console import output as output_console
from touchline.cli.console import plain_table, say
from touchline.errors import InputError, NoFitError
from touchline.files.new import check_new_file

if TYPE_CHECKING:
    from touchline.calibration.field_sizes.measure import FieldMeasurement
    from touchline.field import FieldModel
    from touchline.types import LinePoints


def measure(
    inputs: Annotated[
        list[Path],
        typer.Argument(metavar="RECORDING|IMAGE...", help="A recording, or images of one robot at several places."),
    ],
    field: Annotated[
        str | None, typer.Option(metavar="NAME|FILE", help="The field as it should be (default: the recording's).")
    ] = None,
    camera: Annotated[Path | None, typer.Option(help="camera.yaml of images.")] = None,
    range_error: Annotated[
        float | None,
        typer.Option(
            metavar="RATIO",
            min=0.0,
            max=0.1,
            help="By what share all ranges of the camera may be wrong in common: 0.003 after calibrate mirror "
            "(default: as camera.yaml states it, else 0.01).",
        ),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE", help="The new field.yaml to write.")
    ] = None,
) -> None:
    """Say which of a field's sizes the lines want otherwise, by how much and how surely; write the field as it is."""
    if output is not None:
        check_new_file(output, (".yaml", ".yml"), "a field")
    seen, model, stated = _seen(inputs, field, camera)
    from touchline.calibration.field_sizes.fit import USUAL_SCALE
    from touchline.calibration.field_sizes.measure import measure_field

    scale = range_error if range_error is not None else stated if stated is not None else USUAL_SCALE
    try:
        measured = measure_field(seen, model, max(scale, 1e-4), output.stem if output is not None else None)
    except NoFitError as error:
        raise NoFitError(f"{inputs[0]}{' ...' if len(inputs) > 1 else ''}: not measured: {error}") from None
    _print(measured, model, max(scale, 1e-4))
    if output is not None:
        measured.field.to_yaml(output)
        say(f"written to {output}; touchline fields {output} shows it")


def _seen(
    inputs: list[Path], field: str | None, camera: Path | None
) -> tuple[list[LinePoints], FieldModel, float | None]:
    """Line points of each place, the field, and the camera's stated scale error, if it states one."""
    from touchline.calibration.field_sizes.measure import image_points, recording_points
    from touchline.camera import open_camera
    from touchline.field import open_field
    from touchline.files.images import read_image
    from touchline.sources import is_recording, open_source

    if is_recording(inputs[0]):
        if len(inputs) > 1 or camera is not None:
            raise InputError("one recording is measured at a time, with its own camera; --camera is for images")
        source = open_source(inputs[0])
        model = source.field if field is None else open_field(field)
        return recording_points(source), model, _stated(source.camera if source.camera_file is not None else None)
    if field is None or camera is None:
        raise InputError(f"{inputs[0]}: images need the field (--field NAME) and their camera (--camera FILE)")
    model, mirror = open_field(field), open_camera(camera)
    images = [read_image(path) for path in inputs]
    return image_points(images, mirror, model.line_width), model, _stated(mirror)


def _stated(camera: object) -> float | None:
    """The scale error of ranges that a camera.yaml states."""
    stated = getattr(camera, "stated_uncertainty", None)
    return None if stated is None else float(stated.range_ratio)


def _print(measured: FieldMeasurement, field: FieldModel, scale: float) -> None:
    import numpy as np

    from touchline.calibration.field_sizes.measure import MIN_PLACES, Verdict

    fit = measured.fit
    say(
        f"{field.name}: {measured.places} of {measured.seen} observations tell their place; "
        f"{100 * float(np.median(fit.residuals_m)):.1f} cm from the lines (median)"
    )
    output_console().print(_table(measured))
    wrong = [one for one in measured.sizes if one.verdict is Verdict.OTHERWISE]
    unsure = [one for one in measured.sizes if one.verdict is Verdict.UNSURE]
    if not wrong:
        say("No size is surely otherwise." + (" More places would tell of those in doubt." if unsure else ""))
    if measured.places < MIN_PLACES:
        say(f"From fewer than {MIN_PLACES} places no size is surely otherwise: the mirror may be what differs.")
    say(
        "Lines can't tell a larger field from a camera with longer ranges: these are taken to be right to "
        f"± {100 * scale:.1f} % (--range-error), and look {100 * abs(fit.scale):.1f} ± "
        f"{100 * fit.scale_deviation:.1f} % too {'short' if fit.scale > 0 else 'long'}."
    )


def _table(measured: FieldMeasurement) -> Table:
    from touchline.calibration.field_sizes.measure import Verdict

    table = plain_table("", "size", "as given (m)", "measured (m)", "differs (cm)", "", numbers_from=2)
    table.columns[-1].justify = "left"
    for one in measured.sizes:
        size = one.size
        if one.verdict is Verdict.NOT_OBSERVED:
            table.add_row(size.letter, size.meaning, f"{size.value_m:.3f}", "", "", "not observed", style="dim")
            continue
        differs = f"{100 * one.change_m:+.1f} ± {100 * one.deviation_m:.1f}"
        style = "bold" if one.verdict is Verdict.OTHERWISE else None
        value = f"{size.value_m + one.change_m:.3f}"
        table.add_row(size.letter, size.meaning, f"{size.value_m:.3f}", value, differs, one.verdict.value, style=style)
    return table
