"""`touchline fields`: the preset fields, one field shown and drawn, and a team's own field."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from rich.table import Table
from typer.core import TyperGroup

from touchline.cli.console import output as output_console
from touchline.cli.console import plain_table, say, warn
from touchline.errors import InputError, NoFitError
from touchline.files.new import check_new_file, file_name

if TYPE_CHECKING:
    from touchline.calibration.field_sizes.measure import FieldMeasurement
    from touchline.field import FieldModel
    from touchline.types import LinePoints


class _FieldsGroup(TyperGroup):
    """A first word that is no subcommand is the name of a field, shown by the command `show`."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        named = args[0] in ("new", "measure") or (args[0] == "show" and len(args) > 1)
        return super().resolve_command(ctx, args if named else ["show", *args])


_WIDTH_OF_DESCRIPTIONS = 76  # characters: with fewer, the presets are listed without them

fields_app = typer.Typer(cls=_FieldsGroup, subcommand_metavar="[NAME|FILE | new NAME ... | measure RECORDING ...]")


@fields_app.callback(invoke_without_command=True)
def fields(ctx: typer.Context) -> None:
    """List the preset fields; with NAME or FILE show one field; with new make your own, with measure measure it.

    touchline fields show msl-18x12 -o field.png   shows and draws one.
    """
    if ctx.invoked_subcommand is None:
        _list_presets()


@fields_app.command("show")
def show(
    name: Annotated[str, typer.Argument(metavar="NAME|FILE", help="A preset, a field.yaml or a recording.")],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="PICTURE.png", help="Draw the field into a new picture.")
    ] = None,
    scale: Annotated[float, typer.Option(min=1.0, max=500.0, help="Pixels per metre of the picture.")] = 50.0,
) -> None:
    """Show one field: its sizes, lines, crossings, posts and poles; the word show may be left out."""
    from touchline.field import open_field

    field = open_field(name)
    say(f"{field.name}: {field.description}" if field.description else field.name)
    _print_tables(field)
    if output is not None:
        from touchline.field.drawing import draw_field
        from touchline.view.picture_files import check_new_picture, save_picture

        check_new_picture(output)
        save_picture(output, draw_field(field, scale))
        say(f"drawn into {output}")


@fields_app.command("new")
def new(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of the new field.")],
    letters: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="LETTER=METRES...",
            help="Sizes by the Middle Size League's letters, as A=18 B=12. The rest is as in the base field; "
            "0 leaves a part out. touchline fields msl-22x14 explains each letter.",
        ),
    ] = None,
    base: Annotated[str, typer.Option(help="The field that the other sizes are taken from.")] = "msl-22x14",
    measured_to: Annotated[
        Literal["edge", "middle"], typer.Option(help="What the sizes reach to: the lines' outer edge or middle.")
    ] = "edge",
    goal_width: Annotated[
        float | None,
        typer.Option(
            metavar="METRES", help="Between the insides of a goal's posts, which no letter names (default: the base's)."
        ),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE", help="The new file (default: NAME.yaml).")
    ] = None,
) -> None:
    """Write a field.yaml of your own field from a few rulebook letters."""
    sizes = _parse_letters(letters or [])
    if name != file_name(name):
        raise InputError(f"{name}: is no name of a field; a name as msl-18x12, and --output says where the file goes")
    from touchline.field import field_from_letters, open_field, preset_names

    field = field_from_letters(name, sizes, base, measured_to, goal_width)
    path = output if output is not None else Path(f"{name}.yaml")
    check_new_file(path, (".yaml", ".yml"), "a field")
    field.to_yaml(path)
    _print_tables(field)
    kept = {key: metres for key, metres in open_field(base).letters.items() if key not in sizes and metres > 0.0}
    words = ", ".join(f"{key}={metres:g}" for key, metres in kept.items())
    say(f"as in {base}: {words or 'nothing'}; give the others as LETTER=METRES")
    if name in preset_names():
        warn(f"warning: {name} is the name of a preset, too; where a field is asked for, {name} means the preset")
    say(f"written to {path}; touchline fields {path} shows it")


def _print_tables(field: FieldModel) -> None:
    output_console().print(_sizes(field))
    output_console().print(_counts(field))


def _parse_letters(items: list[str]) -> dict[str, float]:
    letters: dict[str, float] = {}
    for item in items:
        letter, separator, text = item.partition("=")
        try:
            metres = float(text)
        except ValueError:
            separator = ""
        if not separator:
            raise InputError(f"{item}: expected LETTER=METRES, for example A=18")
        key = letter.strip().upper()
        if key in letters:
            raise InputError(f"{item}: the letter {key} is given twice")
        letters[key] = metres
    return letters


def _list_presets() -> None:
    from touchline.field import open_field, preset_names

    out = output_console()
    narrow = out.width < _WIDTH_OF_DESCRIPTIONS
    titles = ("name",) if narrow else ("name", "description")
    rows = []
    for name in preset_names():
        field = open_field(name)
        sizes = [f"{size:g} m" for size in (field.length, field.width, field.line_width)]
        words = (name,) if narrow else (name, field.description)
        rows.append((*words, *sizes, *map(str, _crossing_counts(field))))
    table = _table(*titles, "length", "width", "line", "L", "T", "X", rows=rows, numbers_from=len(titles))
    table.columns[0].no_wrap = True
    if narrow:  # names are for typing: rather let the terminal break a line than cut one
        out.width = max(out.width, out.measure(table, options=out.options.update(width=200)).maximum)
    out.print(table)
    say("sizes include the lines; L, T, X: crossings. touchline fields NAME shows one", style="dim")


def _sizes(field: FieldModel) -> Table:
    """Rulebook letters where they are known, otherwise the four sizes that each field has."""
    from touchline.field import LETTERS

    sizes = {"length": field.length, "width": field.width, "line width": field.line_width, "border": field.border}
    rows = [("", meaning, metres) for meaning, metres in sizes.items()]
    if field.letters:
        rows = [(letter, meaning, field.letters.get(letter, 0.0)) for letter, meaning in LETTERS.items()]
    shown = [(*row, f"{metres:g}" if metres > 0.0 or not field.letters else "none") for *row, metres in rows]
    return _table("", "size, including the lines", "metres", rows=shown, numbers_from=2)


def _counts(field: FieldModel) -> Table:
    goal_posts = [post for post in field.posts if post.kind == "goal"]
    poles = [post for post in field.posts if post.kind == "pole"]
    corners, tees, crosses = _crossing_counts(field)
    inside_m = (round(max(goal.y_posts) - min(goal.y_posts) - goal.post_width, 6) for goal in field.goals)
    goals = sorted({(goal.height, goal.depth, wide) for goal, wide in zip(field.goals, inside_m, strict=True)})
    rows = (
        ("segments, circles, arcs", f"{len(field.segments)}, {len(field.circles)}, {len(field.arcs)}"),
        ("marks", str(len(field.discs))),
        ("crossings L, T, X", f"{corners}, {tees}, {crosses}"),
        ("goal posts", _with_colors(goal_posts)),
        *(("goals", f"{width:g} m wide inside, {high:g} m high, {deep:g} m deep") for high, deep, width in goals),
        ("poles", _with_colors(poles)),
        ("same after half a turn", "yes" if field.is_symmetric else "no"),
    )
    return _table("what", "count", rows=rows)


def _with_colors(posts: list[Any]) -> str:
    looks = sorted({"-".join(post.colors_from_ground) for post in posts})
    return f"{len(posts)} ({', '.join(looks)})" if posts else "0"


def _crossing_counts(field: FieldModel) -> tuple[int, int, int]:
    kinds = [crossing.kind.value for crossing in field.crossings]
    return kinds.count("L"), kinds.count("T"), kinds.count("X")


def _table(*titles: str, rows: Iterable[Sequence[str]], numbers_from: int | None = None) -> Table:
    table = plain_table(*titles, rows=rows, numbers_from=numbers_from)
    for column in table.columns[numbers_from if numbers_from is not None else len(titles) :]:
        column.no_wrap = True
    return table


# --- measure ----------------------------------------------------------------------------------------------------------


@fields_app.command("measure")
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
    _print_measured(measured, model, max(scale, 1e-4))
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


def _print_measured(measured: FieldMeasurement, field: FieldModel, scale: float) -> None:
    import numpy as np

    from touchline.calibration.field_sizes.measure import MIN_PLACES, Verdict

    fit = measured.fit
    say(
        f"{field.name}: {measured.places} of {measured.seen} observations tell their place; "
        f"{100 * float(np.median(fit.residuals_m)):.1f} cm from the lines (median)"
    )
    output_console().print(_measured_table(measured))
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


def _measured_table(measured: FieldMeasurement) -> Table:
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
