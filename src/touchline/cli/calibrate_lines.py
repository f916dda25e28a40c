"""`touchline calibrate lines`: a camera from the field's own lines."""

from __future__ import annotations

from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from touchline.cli.console import shown_progress, warn
from touchline.cli.new_pair import CAMERA_ENDINGS, NewFile, NewPicture, new_files, write_pair
from touchline.cli.options import turn_in_rad
from touchline.errors import InputError, NoFitError
from touchline.messages import counted

if TYPE_CHECKING:
    from touchline.calibration.lines.calibration import LineCalibration
    from touchline.calibration.perspective_lines import PerspectiveLines
    from touchline.camera import OmniCamera
    from touchline.field import FieldModel
    from touchline.geometry import FloatArray
    from touchline.types import ImageArray

# standard deviations, and of a line's width: from there on it is said that all lines lie aside
_SURELY, _EDGE = 3.0, 0.25
_SWAYING_RAD = 0.005  # deviation of the body's mean lean from which on it is said that it sways
_HANDEDNESS = (
    "Of a mirror, 1: the image shows the field as a map does; -1: mirrored. Lines can't tell; without it 1 is taken, "
    "and said."
)


def calibrate_lines(
    inputs: Annotated[
        list[Path],
        typer.Argument(
            metavar="IMAGE...|PIXELS.csv...",
            help="Images of one robot on the field, or (of a mirror) line points (u_px,v_px), a file for each place.",
        ),
    ],
    field: Annotated[str, typer.Option(metavar="NAME|FILE", help="The field.")],
    output: NewFile,
    model: Annotated[
        Literal["omni", "pinhole", "fisheye"],
        typer.Option(help="Kind of camera: with a mirror, or with a lens alone."),
    ] = "omni",
    handedness: Annotated[Literal["1", "-1"] | None, typer.Option(help=_HANDEDNESS)] = None,
    mount_yaw: Annotated[
        float,
        typer.Option(metavar="RAD", help="mount_yaw of a mirror's camera.yaml: lines can't tell where the front is."),
    ] = 0.0,
    size: Annotated[
        str | None, typer.Option(metavar="WxH", help="[PIXELS.csv] Size of the images, 640x480 for instance.")
    ] = None,
    picture: NewPicture = None,
) -> None:
    """Write a camera.yaml found from the field's lines in one or more images, with no camera.yaml to begin with.

    A mirror may need one image alone.
    A perspective camera needs --model pinhole or fisheye and eight or more images, and may take minutes.
    """
    mount_yaw = turn_in_rad(mount_yaw, "--mount-yaw")
    _refuse_folders(inputs)
    picture = new_files(output, CAMERA_ENDINGS, "a camera", picture)
    from touchline.field import open_field

    on_field = open_field(field)
    from_points = [path.suffix.lower() == ".csv" for path in inputs]
    if any(from_points) and not all(from_points):
        raise InputError("images and files of line points can't be calibrated together: give the one or the other")
    if size is not None and not all(from_points):
        raise InputError("--size is for files of line points: images have their own")
    try:
        if model != "omni":
            text, words, drawn = _with_lens(inputs, on_field, model, any(from_points))
        else:
            text, words, drawn = _with_mirror(
                inputs, on_field, int(handedness) if handedness else None, mount_yaw, size
            )
    except NoFitError as error:
        raise NoFitError(f"{inputs[0]}{' ...' if len(inputs) > 1 else ''}: not calibrated: {error}") from None
    write_pair(output, text, picture, drawn, words)


def _with_mirror(
    inputs: list[Path], field: FieldModel, handedness: int | None, mount_yaw: float, size: str | None
) -> tuple[str, str, ImageArray]:
    """camera.yaml, what to say, and the picture."""
    from touchline.camera.writing import camera_yaml

    hand = handedness or 1
    if inputs[0].suffix.lower() == ".csv":
        camera, lines, drawn = _from_points(inputs, field, hand, mount_yaw, size)
    else:
        camera, lines, drawn = _from_images(inputs, field, hand, mount_yaw)
    words = _words(lines, camera, field, handedness)
    return camera_yaml(camera, words), words, drawn


def _with_lens(inputs: list[Path], field: FieldModel, model: str, from_points: bool) -> tuple[str, str, ImageArray]:
    """The same of a camera with a lens alone."""
    from touchline.calibration.perspective import perspective_yaml
    from touchline.calibration.perspective_bundle import camera_at
    from touchline.calibration.perspective_lines import calibrate_perspective_lines
    from touchline.camera import GroundView
    from touchline.view.learned_view import seen_through
    from touchline.view.overlay import overlay_image

    if from_points:
        raise InputError(f"--model {model} needs images: files of line points do not tell which lines are straight")
    paths, images = _images(inputs)
    with shown_progress("calibrate lines", counted(len(images), "image")) as report:
        found = calibrate_perspective_lines(images, field, model, report)
    _warn_unused(paths, found.used)
    words = _lens_words(found, field)
    best = max(range(len(found.used)), key=lambda k: len(found.seen[k].points))
    pose, lean = found.fit.stands[best]
    level = GroundView(found.camera)
    leaning = GroundView(camera_at(model, (found.camera.width, found.camera.height), found.fit.state, lean))
    shown = seen_through(found.seen[best], level, leaning)
    drawn = overlay_image(images[found.used[best]], leaning, field, pose, shown)
    return perspective_yaml(found.camera, words), words, drawn


def _lens_words(found: PerspectiveLines, field: FieldModel) -> str:
    """What was found, and how sure it is."""
    import math

    from touchline.calibration.perspective_bundle import DISTORTION, FOCAL, HEIGHT, PITCH, ROLL

    camera, sure, learned = found.camera, found.deviations, found.fit.learned
    swaying = ""
    if max(found.mean_lean_deviations[[ROLL, PITCH]]) > _SWAYING_RAD:
        swaying = (
            f" It sways: roll and pitch are its means over {len(found.used)} images, and known no better than those. "
            "Localization learns them within seconds; else let the robot stand still, or add images."
        )
    roll, pitch, _ = camera.base_from_camera.roll_pitch_yaw()
    height_m = float(camera.base_from_camera.translation_m[2])
    points = sum(len(one.points) for one in found.seen)
    return (
        f"Camera calibrated from {points} line points of {len(found.used)} images on {field.name}: "
        f"{100 * found.fit.on_lines.mean():.0f} % lie on lines.\n"
        f"Focal length {camera.fx:.1f} px (± {100 * sure[FOCAL]:.1f} %), distortion {camera.distortion[0]:+.3f} "
        f"(± {sure[DISTORTION]:.3f}).\n"
        f"Roll {math.degrees(roll):.2f}° (± {math.degrees(sure[ROLL]):.2f}), pitch {math.degrees(pitch):.2f}° "
        f"(± {math.degrees(sure[PITCH]):.2f}), height {height_m:.3f} m (± {height_m * sure[HEIGHT]:.3f}); the body "
        f"leant by {math.degrees(learned.roll_rad):.2f}° of roll and {math.degrees(learned.pitch_rad):.2f}° of pitch "
        f"from image to image besides, its height differed by {100 * learned.height_ratio:.1f} %.{swaying}\n"
        f"Lines lie {1000 * learned.paint_m:.0f} mm beside where the field's file has them.\n"
        "The origin is the point below the camera, x the way it looks: correct base_from_camera if it sits elsewhere."
    )


def _refuse_folders(paths: list[Path]) -> None:
    for path in paths:
        if path.is_dir():
            images = path / "images" if (path / "images").is_dir() else path
            raise InputError(
                f"{path}: is a folder; expected images or CSV files of line points, {images}/*.png for instance "
                "(touchline calibrate self and touchline calibrate mirror take recordings)"
            )


def different(paths: list[Path], contents: Sequence[FloatArray | ImageArray]) -> list[int]:
    """The numbers of those whose content did not come before. Counted twice, they would seem to tell more."""
    first: dict[tuple[tuple[int, ...], bytes], int] = {}
    for k, content in enumerate(contents):
        same = first.setdefault((content.shape, sha256(content.tobytes()).digest()), k)
        if same != k:
            warn(f"left out: {paths[k]}: shows the same as {paths[same]}, which counts once")
    return list(first.values())


def _from_points(
    paths: list[Path], field: FieldModel, handedness: int, mount_yaw: float, size: str | None
) -> tuple[OmniCamera, LineCalibration, ImageArray]:
    from touchline.calibration.lines.calibration import calibrate_points, check
    from touchline.calibration.lines.images import known_camera
    from touchline.calibration.lines.pixels_file import image_size, read_pixels, rough_circle
    from touchline.view.calibration import points_picture

    pixels = [read_pixels(path) for path in paths]
    pixels = [pixels[k] for k in different(paths, pixels)]
    width_height = image_size(size, pixels)
    circle = rough_circle(pixels)
    lines = calibrate_points(pixels, circle.center, circle.radius_px, field, handedness)
    check(lines)
    camera = known_camera(lines, width_height, min(lines.first_px, 0.2 * lines.last_px), circle.radius_px, mount_yaw)
    return camera, lines, points_picture(lines, field)


def _from_images(
    paths: list[Path], field: FieldModel, handedness: int, mount_yaw: float
) -> tuple[OmniCamera, LineCalibration, ImageArray]:
    from touchline.calibration.lines.calibration import check
    from touchline.calibration.lines.images import calibrate_images
    from touchline.view.calibration import image_picture

    paths, images = _images(paths)
    found = calibrate_images(images, field, handedness, mount_yaw)
    check(found.lines, whole_view=True)
    _warn_unused(paths, found.used)
    return found.camera, found.lines, image_picture(found, images[found.used[0]], field)


def _images(paths: list[Path]) -> tuple[list[Path], list[ImageArray]]:
    """Images of one size, each once, with their files."""
    from touchline.files.images import read_image

    images = [read_image(path) for path in paths]
    for path, image in zip(paths, images, strict=True):
        if image.shape != images[0].shape:
            raise InputError(f"{path}: is of another size than {paths[0]}; all images must be of one camera")
    kept = different(paths, images)
    return [paths[k] for k in kept], [images[k] for k in kept]


def _warn_unused(paths: list[Path], used: Sequence[int]) -> None:
    for k in sorted(set(range(len(paths))) - set(used)):
        warn(f"left out: {paths[k]}: hardly any line points")


def _words(lines: LineCalibration, camera: OmniCamera, field: FieldModel, handedness: int | None) -> str:
    """What was found, how sure it is, and what lines can't tell."""
    import numpy as np

    from touchline.calibration.lines.equations import HEIGHT_M
    from touchline.geometry import wrap_angle

    sure, shape = lines.certainty, lines.shape
    points = sum(len(one) for one in lines.pixels)
    images = f"{len(lines.pixels)} images" if len(lines.pixels) > 1 else "one image"
    first, last = shape.range_m(np.array([lines.first_px, lines.last_px]))
    edges = np.array([camera.inner_radius_px, camera.outer_radius_px])
    ends, doubt = shape.range_m(edges), sure.range_ratio(shape, edges)
    near = sure.distances_m[sure.residuals < 2.5]
    leans, doubt_deg = np.degrees(0.5 * HEIGHT_M * np.array([np.hypot(*shape.bend_per_m), sure.bend_per_m.max()]))
    text = (
        f"Mirror calibrated from {points} line points of {images} on {field.name}: {100 * lines.on_lines:.0f} % lie on "
        f"lines, {100 * float(np.median(near)):.1f} cm from their middle (median).\n"
        f"Centre {shape.center[0]:.2f}, {shape.center[1]:.2f} px (± {sure.center_px[0]:.2f}, {sure.center_px[1]:.2f}); "
        f"ranges ± {100 * lines.range_ratio:.1f} % between {first:.1f} and {last:.1f} m; continued from {ends[0]:.2f} "
        f"(± {100 * doubt[0]:.0f} %) to {ends[1]:.1f} m (± {100 * doubt[1]:.0f} %).\n"
    )
    text += f"The mirror leans by about {leans:.2f}° (± {doubt_deg:.2f} per axis). "
    edge_m, edge_sigma_m = sure.edge_m
    if abs(edge_m) > max(_SURELY * edge_sigma_m, _EDGE * field.line_width):
        where, because = ("in", "the field's file may hold their outer edges")
        if edge_m > 0.0:
            where, because = ("out", "their middles may have been laid where the rules have their outer edges")
        text += f"All lines lie {100 * abs(edge_m):.1f} cm (± {100 * edge_sigma_m:.1f}) further {where}: {because}. "
    if lines.spot_m is not None:
        text += "The robot turned on the spot: its axis is the origin.\n"
    else:
        text += "The origin is the point below the mirror: the robot was not seen to turn on the spot.\n"
    for k, pose in enumerate(lines.poses, start=1):
        degrees = np.degrees(wrap_angle(pose.heading - camera.mount_yaw_rad))
        text += f"Pose {k}: {pose.x:.2f}, {pose.y:.2f} m, {degrees:.1f}°, or its twin across the field.\n"
    if handedness is None:
        text += (
            "handedness: 1 is taken; lines can't tell. If the field appears mirrored in the image (turn the robot to "
            "the left: a mirrored picture turns the other way), run again with --handedness -1.\n"
        )
    return text + f"mount_yaw {camera.mount_yaw_rad:g}: correct it if the robot's front is elsewhere in the image."
