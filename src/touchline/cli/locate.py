"""`touchline locate`: the pose of one observation, line points or an image, and the other poses that explain it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from touchline.cli.console import announce_compiling, errors_console, say
from touchline.cli.console import output as output_console
from touchline.cli.options import numbers
from touchline.errors import InputError, NoFitError
from touchline.files.new import PICTURE_ENDINGS

if TYPE_CHECKING:
    from touchline.camera import Camera
    from touchline.field import FieldModel
    from touchline.geometry import FloatArray
    from touchline.localization.one_shot.advice import Better, Scale
    from touchline.localization.one_shot.location import Location
    from touchline.view.look import Look

_ASSUMED_FIELD = "msl-18x12"


def locate(
    source: Annotated[Path, typer.Argument(metavar="POINTS.csv|IMAGE", help="Line points (x_m,y_m), or one image.")],
    field: Annotated[
        str | None, typer.Option(metavar="NAME|FILE", help=f"The field; without it {_ASSUMED_FIELD} is assumed.")
    ] = None,
    camera: Annotated[Path | None, typer.Option(help="camera.yaml of an image.")] = None,
    heading: Annotated[
        float | None, typer.Option(metavar="RAD", help="Compass heading; without it the whole circle.")
    ] = None,
    attitude: Annotated[
        str | None,
        typer.Option(metavar="ROLL,PITCH", help="Lean of the body at an image (rad), for a camera that heeds it."),
    ] = None,
    with_scale: Annotated[
        bool, typer.Option("--fit-scale", help="Fit a factor of all ranges, too: for a camera with wrong ranges.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="PICTURE.png",
            help="New picture: the overlay of an image (without it overlay.png in runs/NAME-locate-N), or the points "
            "on the field.",
        ),
    ] = None,
) -> None:
    """Find the pose from one set of line points, with every other pose that explains them as well.

    Points are in the robot's frame: x forward, y left, metres. Points that fit no pose are refused (exit status 1).
    Of an image crossings, goal posts and marks count, too.
    """
    if source.is_dir():
        raise InputError(
            f"{source}: is a folder; expected one CSV file of line points or one image (touchline run takes recordings)"
        )
    if camera is None and source.suffix.lower() in PICTURE_ENDINGS:
        raise InputError(f"{source}: an image needs its camera model; give it with --camera FILE")
    if output is not None:
        from touchline.view.picture_files import check_new_picture

        check_new_picture(output)
    from touchline.field import open_field

    model = open_field(field if field is not None else _ASSUMED_FIELD)
    console = errors_console()
    with console.status("searching the whole field"), announce_compiling(console.print):
        seen = _seen(source, camera, model, attitude)
        answer = _answer(source, seen, model, heading, with_scale)
        picture = _draw(source, seen, model, answer, output)
    found = answer.found
    if as_json:
        _print_json(answer, model, field is None, picture)
    elif not isinstance(found, NoFitError):
        _print_table(source, model, field is None, found, answer)
    if picture is not None and not as_json:
        say(f"drawn into {picture}")
    if isinstance(found, NoFitError):
        assumed = f" (--field was not given: {model.name} was assumed{_beside(source)})" if field is None else ""
        others = "".join(f". {_better_words(better)}" for better in answer.better)
        raise NoFitError(f"{source}: {found}{assumed}{others}")


def _beside(source: Path) -> str:
    """The field of the recording that a file seems to be of, in words."""
    own = (folder / "field.yaml" for folder in source.absolute().parents[:2])
    return next((f"; its recording has --field {path}" for path in own if path.is_file()), "")


class _Seen(NamedTuple):
    """Line points (N, 2) in m, robot frame, weights (N,) or None, and what else an image has shown."""

    points: FloatArray
    weights: FloatArray | None
    look: Look | None
    camera: Camera | None = None


class _Answer(NamedTuple):
    """A pose, or why there is none; the scale that was fitted to the points (N, 2); what would fit better."""

    found: Location | NoFitError
    points: FloatArray
    scale: Scale | None
    better: tuple[Better, ...]


def _seen(source: Path, camera: Path | None, field: FieldModel, attitude: str | None) -> _Seen:
    if camera is None:
        from touchline.localization.one_shot.points_file import read_points

        return _Seen(*read_points(source), None)
    from touchline.camera import open_camera
    from touchline.localization.registration.weights import WeightSettings, precision_weights
    from touchline.view.look import observe_image

    model = _leaning(open_camera(camera), source, attitude)
    look = observe_image(source, model, field)
    points = look.observation.points
    return _Seen(points.positions_m, precision_weights(points, WeightSettings()), look, model)


def _leaning(camera: Camera, source: Path, attitude: str | None) -> Camera:
    """The camera as it was at an image, roll and pitch (rad) of its body as given."""
    from touchline.camera import PerspectiveCamera, pose_in_base
    from touchline.camera.ground_view import MAX_LEAN_RAD

    if attitude is None and isinstance(camera, PerspectiveCamera) and camera.use_attitude:
        raise InputError(
            f"{source}: nothing tells how the camera leans at this image; give roll and pitch of the body with "
            "--attitude ROLL,PITCH (rad), 0,0 for one that stands upright"
        )
    if attitude is None or not isinstance(camera, PerspectiveCamera):
        return camera
    roll, pitch = numbers(attitude, "--attitude", "roll and pitch of the body (rad)", "0.01,-0.02")
    if not math.hypot(roll, pitch) <= MAX_LEAN_RAD:
        raise InputError(
            f"--attitude {attitude}: no robot leans so far; roll and pitch are in radians, a degree is 0.017"
        )
    pose = pose_in_base(camera, None, roll, pitch)
    return camera if pose is None else replace(camera, base_from_camera=pose, use_attitude=False)


def _answer(source: Path, seen: _Seen, field: FieldModel, heading: float | None, with_scale: bool) -> _Answer:
    from touchline.camera import PerspectiveCamera
    from touchline.localization.one_shot.advice import better_field, better_fits, fit_scale
    from touchline.localization.one_shot.locate import locate, locate_points
    from touchline.localization.one_shot.location import PoorFitError

    points, scale = seen.points, None
    found: Location | NoFitError
    try:
        if with_scale:
            scale = fit_scale(points, field, heading)
            points = scale.factor * points
        if seen.look is None or scale is not None:
            found = locate_points(points, field, heading, seen.weights, camera=seen.camera)
        else:
            found = locate(seen.look.observation, field, heading, camera=seen.camera)
    except NoFitError as error:
        found = error
    best = found.best if isinstance(found, PoorFitError) else None if isinstance(found, NoFitError) else found
    if best is None or (best is found and not best.doubts):
        return _Answer(found, points, scale, ())
    if seen.look is not None and scale is None and isinstance(seen.camera, PerspectiveCamera):
        from touchline.view.look import observe_image

        camera, place = seen.camera, best if best is found else None
        better = better_field(
            lambda other: observe_image(source, camera, other).observation, field, place, heading, camera
        )
    else:
        better = better_fits(points, field, best.pose, heading)
    return _Answer(found, points, scale, better)


def _as_fitted(seen: _Seen, answer: _Answer) -> Look:
    """The look with the camera's attitude, height and focal length as they were fitted with the pose."""
    import numpy as np

    from touchline.camera import GroundView, PerspectiveCamera
    from touchline.view.learned_view import seen_through

    look, found, camera = seen.look, answer.found, seen.camera
    assert look is not None
    if isinstance(found, NoFitError) or found.camera_errors is None or not isinstance(camera, PerspectiveCamera):
        return look
    view = GroundView(camera.corrected(found.camera_errors, np.linspace(0.05, 0.5, 10)))
    return replace(look, view=view, observation=seen_through(look.observation, look.view, view))


def _draw(source: Path, seen: _Seen, field: FieldModel, answer: _Answer, output: Path | None) -> Path | None:
    """The picture that was drawn: that of an image in any case, that of points if it was asked for."""
    found = None if isinstance(answer.found, NoFitError) else answer.found
    if seen.look is None and (output is None or found is None):
        return None
    from touchline.evaluation.run_folder import new_folder
    from touchline.view.picture_files import save_picture

    output = output if output is not None else new_folder(None, f"{source.stem}-locate") / "overlay.png"
    if seen.look is not None:
        pose = None if found is None else found.pose
        save_picture(output, replace(_as_fitted(seen, answer), field_from_robot=pose).overlay())
    elif found is not None:
        save_picture(output, found.draw(field, answer.points))
    return output


def _print_table(source: Path, field: FieldModel, assumed: bool, location: Location, answer: _Answer) -> None:
    say(_summary(source, field, location))
    if answer.scale is not None:
        factor, deviation = answer.scale
        say(f"all ranges were multiplied by {factor:.4f} ± {deviation:.4f} (--fit-scale)")
    if assumed:
        say(f"the field {field.name} is assumed; --field NAME or FILE tells another{_beside(source)}", style="dim")
    output_console().print(location)
    say(*map(_better_words, answer.better), style="yellow")


def _better_words(better: Better) -> str:
    left = f"{100 * better.mean_distance_m:.1f} cm from the lines on average"
    if better.scale is None:
        return f"The points fit the field {better.preset} far better, {left}: --field {better.preset}"
    return f"With all ranges times {better.scale.factor:.3f} the points fit far better, {left}: --fit-scale"


def _summary(source: Path, field: FieldModel, location: Location) -> str:
    return (
        f"{source.name} on {field.name}: {location.points} different points, {100 * location.mean_distance_m:.1f} cm "
        f"from the nearest line on average (median {100 * location.median_distance_m:.1f} cm); "
        f"{location.chance.significance:.0f} deviations better than chance"
    )


def _print_json(answer: _Answer, field: FieldModel, assumed: bool, picture: Path | None) -> None:
    import json

    from touchline.localization.one_shot.location import PoorFitError

    found, tree = answer.found, dict[str, Any]()
    if isinstance(found, NoFitError):
        tree = {"pose": None, "refused": str(found)}
        if isinstance(found, PoorFitError):
            tree["best_refused"] = {**found.best.pose.to_dict(), "mean_distance_m": found.best.residual_m}
            tree["deviations_better_than_chance"] = found.chance.significance
    else:
        tree = found.to_dict()
    if answer.scale is not None:
        tree["scale"] = answer.scale._asdict()
    tree["better"] = [
        ({"field": one.preset} if one.scale is None else {"scale": one.scale._asdict()})
        | {"mean_distance_m": one.mean_distance_m}
        for one in answer.better
    ]
    tree |= {"field": field.name, "field_assumed": assumed}
    if picture is not None:
        tree["picture"] = str(picture)
    typer.echo(json.dumps(tree, indent=2))
