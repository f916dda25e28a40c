"""`touchline calibrate camera` and `touchline calibrate imu`: a perspective camera on a robot that walks."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from touchline.cli.new_pair import CAMERA_ENDINGS, NewFile, NewPicture, new_files, write_pair
from touchline.cli.options import FollowLinks
from touchline.errors import InputError

if TYPE_CHECKING:
    from touchline.calibration.imu import ImuCalibration
    from touchline.calibration.perspective import Lens, PerspectiveCalibration
    from touchline.sources import Recording


def calibrate_camera(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="RECORDING|MARKS.csv", help="A recording with marks.csv (and a chessboard), or a file of marks."
        ),
    ],
    output: NewFile,
    camera: Annotated[
        Path | None, typer.Option(help="camera.yaml with the lens (default: a chessboard, or the marks).")
    ] = None,
    picture: NewPicture = None,
    follow_links: FollowLinks = False,
) -> None:
    """Write the camera.yaml of a perspective camera: lens from a chessboard, place from four marks or more."""
    picture = new_files(output, CAMERA_ENDINGS, "a camera", picture)
    if not source.exists():
        raise InputError(f"{source}: there is no such recording or file of marks")
    from touchline.calibration import perspective
    from touchline.calibration.marks import MARKS, first_image, read_marks
    from touchline.sources import open_source
    from touchline.view.calibration import marks_picture

    recording = open_source(source, follow_links) if source.is_dir() else None
    if recording is not None and not (recording.folder / MARKS).exists():
        raise InputError(f"{source}: has no {MARKS} (file,name,u,v,x_m,y_m): four marks of known place are needed")
    marks = read_marks(source if recording is None else recording.file(MARKS))
    found = perspective.calibrate_camera(marks, _lens(source, recording, camera))
    words = camera_words(found, len(found.residuals_px))
    seen = first_image(marks.path.parent, marks.files, (found.camera.width, found.camera.height), follow_links)
    image = None if seen is None else seen[1]
    drawn = marks_picture(found, image, marks.pixels, marks.places_m)
    write_pair(output, perspective.perspective_yaml(found.camera, words), picture, drawn, words)


def _lens(source: Path, recording: Recording | None, camera: Path | None) -> Lens:
    """From --camera, else from a chessboard in the recording, else from the marks themselves."""
    from touchline.calibration import perspective
    from touchline.calibration.marks import MARKS, read_marks
    from touchline.files.yaml_text import read_yaml_mapping

    if camera is not None:
        return perspective.lens_of(read_yaml_mapping(camera), camera)
    if recording is None:
        raise InputError(f"{source}: marks alone don't tell the image's size: give --camera FILE, or a recording")
    if recording.camera_kind == "omni":
        raise InputError(f"{source}: its camera looks at a mirror; touchline calibrate mirror is for that")
    if recording.camera_kind == "fisheye":
        raise InputError(f"{source}: a fisheye's lens is not calibrated here; OpenCV's fisheye.calibrate does that")
    if "chessboard" in recording.sequence:
        return perspective.chessboard_lens(recording)
    for index in range(len(recording)):
        if (image := recording.image(index)) is not None:
            return perspective.lens_of_marks(read_marks(recording.file(MARKS)), (image.shape[1], image.shape[0]))
    raise InputError(f"{source}: none of its images can be read")


def calibrate_imu(
    recording: Annotated[
        Path, typer.Argument(metavar="RECORDING", help="A robot that walks in place before marks (marks.csv).")
    ],
    output: NewFile,
    camera: Annotated[Path | None, typer.Option(help="camera.yaml to add to (default: the recording's).")] = None,
    paper: Annotated[
        bool, typer.Option("--paper", help="Equation (2) of Schulz and Behnke alone, right about the marks' rows.")
    ] = False,
    picture: NewPicture = None,
    follow_links: FollowLinks = False,
) -> None:
    """Write a camera.yaml that corrects pixels by roll and pitch, learned while the robot walks in place."""
    picture = new_files(output, CAMERA_ENDINGS, "a camera", picture)
    from dataclasses import replace

    from touchline.calibration.imu import calibrate_imu as learn
    from touchline.calibration.marks import MARKS, first_image, read_marks
    from touchline.calibration.perspective import perspective_yaml
    from touchline.camera import PinholeCamera, open_camera
    from touchline.sources import open_source
    from touchline.view.calibration import wander_picture

    source = open_source(recording, follow_links)
    before = source.camera if camera is None else open_camera(camera)
    if not isinstance(before, PinholeCamera):
        what = "looks at a mirror" if before.model == "omni" else f"is a {before.model}"
        raise InputError(f"{recording}: its camera {what}; the IMU's correction is for pinhole cameras")
    found = learn(source, before, paper)
    words = imu_words(found)
    text = perspective_yaml(replace(before, imu_correction=found.correction, use_attitude=True), words)
    files = read_marks(source.file(MARKS)).files
    seen = first_image(source.folder, files, (before.width, before.height), follow_links)
    write_pair(output, text, picture, wander_picture(found, before, None if seen is None else seen[1]), words)


def camera_words(found: PerspectiveCalibration, marks: int) -> str:
    """What was found from what, and how well the marks agree."""
    import math

    import numpy as np

    roll, pitch, yaw = (math.degrees(angle) for angle in found.camera.base_from_camera.roll_pitch_yaw())
    x, y, z = found.camera.base_from_camera.translation_m
    residuals_m = found.residuals_m[np.isfinite(found.residuals_m)]
    return (
        f"Lens from {found.lens_origin}: focal lengths {found.camera.fx:.1f}, {found.camera.fy:.1f} px, "
        f"principal point {found.camera.cx:.1f}, {found.camera.cy:.1f} px.\n"
        f"Mounted {100 * z:.1f} cm high, {100 * x:.1f} cm ahead and {100 * y:.1f} cm left of the base; "
        f"roll {roll:.2f}°, pitch {pitch:.2f}°, yaw {yaw:.2f}°.\n"
        f"{marks} marks agree to {np.sqrt(np.mean(found.residuals_px**2)):.2f} px (root mean square), on the ground to "
        f"{100 * float(np.median(residuals_m)):.1f} cm (median)."
    )


def imu_words(found: ImuCalibration) -> str:
    """What was learned from what, and what it is good for."""
    upright = (
        f"upright is the reading of the first {found.standing} images, in which the robot stands"
        if found.standing
        else "upright is the reading 0, for the robot never stands"
    )
    without = (
        f", without {found.left_out} of {len(found.seen_px)} sightings, which fit far worse: look at the picture"
        if found.left_out
        else ""
    )
    return (
        f"Learned from {found.marks} marks in {found.images} images: they wander by {found.before_px:.1f} px (root "
        f"mean square) as the robot walks, by {found.after_px:.1f} px once corrected{without}.\n"
        f"{upright[0].upper()}{upright[1:]}."
    )
