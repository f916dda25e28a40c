"""`touchline locate`: the pose of one observation, line points or an image, and the other poses that explain it."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from touchline.errors import InputError, NoFitError, TouchlineError

if TYPE_CHECKING:
    from rich.table import Table

    from touchline.field import FieldModel
    from touchline.geometry import FloatArray, Pose
    from touchline.localization import Location
    from touchline.types import ImageArray

_ASSUMED_FIELD = "msl-18x12"


def locate(
    source: Annotated[
        Path,
        typer.Argument(metavar="POINTS.csv|IMAGE", help="Line points (x_m,y_m), or one image.", show_default=False),
    ],
    field: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|FILE", help=f"The field; without it {_ASSUMED_FIELD} is assumed.", show_default=False
        ),
    ] = None,
    camera: Annotated[Path | None, typer.Option(help="camera.yaml of an image.", show_default=False)] = None,
    heading: Annotated[
        float | None,
        typer.Option(metavar="RAD", help="Compass heading; without it the whole circle.", show_default=False),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="PICTURE.png",
            help="New picture: the overlay of an image (without it overlay.png in runs/NAME-locate-N), or the points "
            "on the field.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Find the pose from one set of line points, with every other pose that explains them as well.

    Points are in the robot's frame: x forward, y left, metres. Points that fit no pose are refused (exit status 1).
    """
    if source.is_dir():
        raise InputError(
            f"{source}: is a folder; expected one CSV file of line points or one image (touchline run takes recordings)"
        )
    from touchline.view.picture_files import PICTURE_ENDINGS, check_new_picture

    if camera is None and source.suffix.lower() in PICTURE_ENDINGS:
        raise InputError(f"{source}: an image needs its camera model; give it with --camera FILE")
    if output is not None:
        check_new_picture(output)
    from touchline.field import open_field

    model = open_field(field if field is not None else _ASSUMED_FIELD)
    find = _from_points if camera is None else _from_image
    with _searching():
        found, picture = find(source, camera, model, heading, output)
    with _whole_output():
        if as_json:
            _print_json(found, model, field is None, picture)
        elif not isinstance(found, NoFitError):
            _print_table(source, model, field is None, found)
        if picture is not None and not as_json:
            _console().print(f"drawn into {picture}", markup=False)
    if isinstance(found, NoFitError):
        assumed = f" (--field was not given: {model.name} was assumed)" if field is None else ""
        raise NoFitError(f"{source}: {found}{assumed}")


@contextmanager
def _searching() -> Iterator[None]:
    """A terminal shows that something is going on: a million points take a second or two, the first start ten."""
    from touchline.cli.console import errors_console, told_of_compiling

    console = errors_console()
    with console.status("searching the whole field"), told_of_compiling(console.print):
        yield


@contextmanager
def _whole_output() -> Iterator[None]:
    """What is printed inside arrives, or one message says why not. A full disk shows when the buffer is emptied."""
    try:
        yield
        sys.stdout.flush()
    except BrokenPipeError:
        raise
    except OSError as error:
        with Path(os.devnull).open("w") as nowhere:  # what is still in the buffer must not fail again at the end
            os.dup2(nowhere.fileno(), sys.stdout.fileno())
        raise TouchlineError(f"the output cannot be written ({error.strerror})") from None


def _from_points(
    source: Path, camera: Path | None, field: FieldModel, heading: float | None, output: Path | None
) -> tuple[Location | NoFitError, Path | None]:
    """The location of the points in a file, or why there is none, and the picture that was drawn."""
    from touchline.localization import locate_points
    from touchline.localization.one_shot.points_file import read_points
    from touchline.view.picture_files import save_picture

    points, weights = read_points(source)
    try:
        location = locate_points(points, field, heading, weights)
    except NoFitError as error:
        return error, None
    if output is not None:
        save_picture(output, _field_picture(field, location.pose, points))
    return location, output


def _from_image(
    source: Path, camera: Path | None, field: FieldModel, heading: float | None, output: Path | None
) -> tuple[Location | NoFitError, Path | None]:
    """As `_from_points`, of an image: the overlay picture is drawn in any case."""
    from touchline.camera import open_camera
    from touchline.evaluation.run_folder import new_folder
    from touchline.localization import WeightSettings, locate_points, precision_weights
    from touchline.view.look import observe_image
    from touchline.view.picture_files import save_picture

    assert camera is not None, "the caller chose this function because there is one"
    look = observe_image(source, open_camera(camera), field)
    points = look.observation.points
    found: Location | NoFitError
    try:
        found = locate_points(points.positions_m, field, heading, precision_weights(points, WeightSettings()))
    except NoFitError as error:
        found = error
    pose = None if isinstance(found, NoFitError) else found.pose
    path = output if output is not None else new_folder(None, f"{source.stem}-locate") / "overlay.png"
    save_picture(path, replace(look, field_from_robot=pose).overlay())
    return found, path


def _print_table(source: Path, field: FieldModel, assumed: bool, location: Location) -> None:
    out = _console()
    out.print(_summary(source, field, location), markup=False)
    if assumed:
        out.print(f"the field {field.name} is assumed; --field NAME or FILE tells another", style="dim", markup=False)
    out.print(_table(location))
    if not location.hypotheses:
        out.print("no other pose explains the points as well", style="dim")


def _summary(source: Path, field: FieldModel, location: Location) -> str:
    return (
        f"{source.name} on {field.name}: {location.points} different points, {100 * location.mean_distance_m:.1f} cm "
        f"from the nearest line on average (median {100 * location.median_distance_m:.1f} cm); "
        f"{location.chance.significance:.0f} deviations better than chance"
    )


def _table(location: Location) -> Table:
    """The pose and the other hypotheses, m and degrees, with standard deviations of the pose."""
    import numpy as np
    from rich.table import Table

    table = Table(box=None, header_style="dim", pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column("")
    for title in ("x (m)", "y (m)", "heading (rad)", "heading (°)", "mean distance (cm)"):
        table.add_column(title, justify="right")
    rows = [("pose", location.pose, location.mean_distance_m)]
    rows += [(f"hypothesis {k}", other.pose, other.residual_m) for k, other in enumerate(location.hypotheses, start=1)]
    for name, pose, distance_m in rows:
        degrees = float(np.degrees(pose.heading))
        numbers = (f"{pose.x:.3f}", f"{pose.y:.3f}", f"{pose.heading:.4f}", f"{degrees:.2f}", f"{100 * distance_m:.1f}")
        table.add_row(name, *numbers)
    sigma = np.sqrt(np.diag(location.covariance))
    table.add_row(
        "± of the pose",
        *(f"{s:.3f}" for s in sigma[:2]),
        f"{sigma[2]:.4f}",
        f"{np.degrees(sigma[2]):.2f}",
        "",
        style="dim",
    )
    return table


def _print_json(found: Location | NoFitError, field: FieldModel, assumed: bool, picture: Path | None) -> None:
    import json

    from touchline.localization import PoorFitError

    tree: dict[str, Any]
    if isinstance(found, NoFitError):
        tree = {"pose": None, "refused": str(found)}
        if isinstance(found, PoorFitError):
            tree["best_refused"] = {**_pose_tree(found.best.pose), "mean_distance_m": found.best.residual_m}
            tree["deviations_better_than_chance"] = found.chance.significance
    else:
        tree = {
            "pose": _pose_tree(found.pose),
            "covariance": found.covariance.tolist(),
            "mean_distance_m": found.mean_distance_m,
            "median_distance_m": found.median_distance_m,
            "error": found.error,
            "points": found.points,
            "deviations_better_than_chance": found.chance.significance,
            "hypotheses": [
                {**_pose_tree(other.pose), "mean_distance_m": other.residual_m} for other in found.hypotheses
            ],
        }
    tree |= {"field": field.name, "field_assumed": assumed}
    if picture is not None:
        tree["picture"] = str(picture)
    typer.echo(json.dumps(tree, indent=2))


def _pose_tree(pose: Pose) -> dict[str, float]:
    return {"x_m": pose.x, "y_m": pose.y, "heading_rad": pose.heading}


def _field_picture(field: FieldModel, pose: Pose, points: FloatArray) -> ImageArray:
    """The field from above with the points (N, 2), robot frame, where the pose puts them, and the robot."""
    import cv2
    import numpy as np

    from touchline.field.drawing import draw_field, field_view
    from touchline.localization.one_shot.whole_field import different

    canvas = draw_field(field)
    view = field_view(field)
    pixels = np.rint(view.picture_from_field(pose.transform(points)))
    for u, v in pixels[different(pixels)].astype(int):
        cv2.circle(canvas, (int(u), int(v)), 3, (255, 120, 0), -1, cv2.LINE_AA)
    ends = np.rint(view.picture_from_field(pose.transform(np.array([[0.0, 0.0], [0.6, 0.0]])))).astype(int)
    robot, ahead = ((int(u), int(v)) for u, v in ends)
    cv2.circle(canvas, robot, 12, (0, 0, 220), 3, cv2.LINE_AA)
    cv2.arrowedLine(canvas, robot, ahead, (0, 0, 220), 3, cv2.LINE_AA)
    return canvas


def _console() -> Any:
    from touchline.cli.console import output

    return output()
