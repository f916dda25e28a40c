"""`touchline calibrate self`: a camera corrected by the lines that it has seen in play."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from touchline.cli.new_pair import CAMERA_ENDINGS, NewFile, NewPicture, new_files, write_pair
from touchline.cli.options import FollowLinks
from touchline.errors import NoFitError

if TYPE_CHECKING:
    from touchline.calibration.self_calibration import SelfCalibration
    from touchline.calibration.self_perspective import PerspectiveSelfCalibration
    from touchline.camera import OmniCamera
    from touchline.sources import Recording
    from touchline.types import ImageArray


def calibrate_self(
    recording: Annotated[
        Path, typer.Argument(metavar="RECORDING", help="A recording of a robot that drives about on the field.")
    ],
    output: NewFile,
    picture: NewPicture = None,
    follow_links: FollowLinks = False,
) -> None:
    """Write a camera.yaml corrected by the lines of a recording: a mirror's lean, centre and ranges, or a perspective
    camera's roll, pitch, height and focal length.
    """
    picture = new_files(output, CAMERA_ENDINGS, "a camera", picture)
    from touchline.camera import PerspectiveCamera
    from touchline.sources import open_source

    source = open_source(recording, follow_links)
    calibrate = _perspective if isinstance(source.camera, PerspectiveCamera) else _mirror
    try:
        text, words, drawn = calibrate(source)
    except NoFitError as error:
        raise NoFitError(f"{recording}: not calibrated: {error}") from None
    write_pair(output, text, picture, drawn, words)


def _mirror(source: Recording) -> tuple[str, str, ImageArray]:
    """camera.yaml, what to say, and the picture."""
    from touchline.calibration.self_calibration import calibrate_self as fit
    from touchline.calibration.self_calibration import spread_views
    from touchline.calibration.strip_recording import camera_yaml
    from touchline.camera import require_omni
    from touchline.evaluation.runner import robot_setup
    from touchline.systems import open_system
    from touchline.view.self_calibration import self_picture

    camera = require_omni(source.camera, "calibrate self corrects")
    system = open_system("touchline", robot_setup(source))
    found = fit(spread_views([system.step(frame) for frame in source]), camera, source.field)
    words = _words(found, source.name)
    return camera_yaml(found.camera, words), words, self_picture(found, source.field)


def _perspective(source: Recording) -> tuple[str, str, ImageArray]:
    """The same of a perspective camera."""
    from touchline.calibration.perspective import perspective_yaml
    from touchline.calibration.self_perspective import calibrate_self_perspective, perspective_views
    from touchline.camera import PerspectiveCamera
    from touchline.evaluation.runner import robot_setup
    from touchline.systems import open_system
    from touchline.systems.touchline import Touchline
    from touchline.view.self_calibration import self_picture

    camera, system = source.camera, open_system("touchline", robot_setup(source))
    assert isinstance(camera, PerspectiveCamera)
    assert isinstance(system, Touchline)
    views = perspective_views(system, source)
    found = calibrate_self_perspective(views, camera, system.registration)
    words = _perspective_words(found, camera.fx, source.name)
    if any(frame.base_from_camera is not None for frame in source):
        words += (
            "\ncamera_pose.csv places this camera in every image: roll, pitch and height need the same correction there"
        )
    return perspective_yaml(found.camera, words), words, self_picture(found, source.field)


def _words(found: SelfCalibration[OmniCamera], name: str) -> str:
    """What was found, and how sure it is."""
    import math

    from touchline.localization.camera_errors.mirror_response import HEIGHT_M

    errors, sure = found.shared, found.camera.uncertainty
    lean_deg = math.degrees(0.5 * HEIGHT_M * math.hypot(errors[0], errors[1]))
    return (
        f"touchline calibrate self {name}: {len(found.poses[0])} images\n"
        f"points on lines: {100 * found.before[0]:.0f} % before, {100 * found.after[0]:.0f} % after\n"
        f"mirror: leans by {lean_deg:.2f} ± {sure.tilt_deg:.2f} degrees, centre {errors[2]:+.1f}, {errors[3]:+.1f} ± "
        f"{sure.center_px:.1f} px (ahead, left), ranges {100 * errors[4]:+.1f} ± {100 * sure.range_ratio:.1f} %"
    )


def _perspective_words(found: PerspectiveSelfCalibration, focal_px: float, name: str) -> str:
    import math

    roll, pitch, height, _ = found.shared.tolist()
    sure = found.deviations
    return (
        f"touchline calibrate self {name}: {len(found.poses[0])} images\n"
        f"lines, crossings and landmarks where they belong: {100 * found.before[0]:.0f} % before, "
        f"{100 * found.after[0]:.0f} % after\n"
        f"the camera leans by {math.degrees(roll):+.2f} ± {math.degrees(sure[0]):.2f} degrees of roll and "
        f"{math.degrees(pitch):+.2f} ± {math.degrees(sure[1]):.2f} degrees of pitch more than its file said, height "
        f"{100 * height:+.1f} ± {100 * sure[2]:.1f} %, focal length {found.camera.fx:.1f} px ± {100 * sure[3]:.1f} %, "
        f"was {focal_px:.1f}\n"
        f"roll and pitch err by {math.degrees(found.lean_rad):.2f} degrees in each image besides"
    )
