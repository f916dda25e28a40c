"""`touchline calibrate self`: a camera corrected by the lines of play, of a recording or of a robot that runs."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from touchline.cli.console import announce_compiling, errors_console
from touchline.cli.interrupts import interruptible
from touchline.cli.live import LinkChoice, Listen, Namespace, RosBase, RosTopics, begin, open_link
from touchline.cli.new_pair import CAMERA_ENDINGS, NewFile, NewPicture, new_files, write_pair
from touchline.cli.options import FollowLinks, StartPose
from touchline.errors import InputError, NoFitError

if TYPE_CHECKING:
    from touchline.calibration.self_calibration import SelfCalibration
    from touchline.calibration.self_perspective import PerspectiveSelfCalibration, PerspectiveView
    from touchline.camera import Camera, OmniCamera, PerspectiveCamera
    from touchline.field import FieldModel
    from touchline.geometry import FloatArray
    from touchline.live.heard import Published
    from touchline.localizer import Localizer
    from touchline.sources import Recording
    from touchline.systems.touchline import Touchline
    from touchline.types import Estimate, Frame, ImageArray

# roll, pitch (rad), height, focal length (ratios): a camera that is farther off hides lines, and is seen through again
_MAX_ERRORS, _MAX_LOOKS = (0.017, 0.017, 0.02, 0.02), 3


class _Seen(NamedTuple):
    """What a run has seen: estimates of a mirror's images, views of a perspective camera's; head_moves: whether the
    camera's own pose came with images.
    """

    name: str
    camera: Camera | None
    field: FieldModel
    estimates: list[Estimate]
    views: list[PerspectiveView]
    system: Touchline | None = None
    head_moves: bool = False


def calibrate_self(
    output: NewFile,
    robot: Annotated[
        str,
        typer.Argument(
            metavar="RECORDING|udp|ros",
            help="A robot that moves about on the field: its recording, or its link.",
        ),
    ],
    picture: NewPicture = None,
    follow_links: FollowLinks = False,
    field: Annotated[str | None, typer.Option(metavar="NAME|FILE", help="Of a running robot: the field.")] = None,
    camera: Annotated[Path | None, typer.Option(help="Of a running robot: its camera.yaml.")] = None,
    seconds: Annotated[float, typer.Option(min=1.0, help="Of a running robot: for so long.")] = 20.0,
    start: StartPose = None,
    listen: Listen = None,
    topics: RosTopics = None,
    base: RosBase = None,
    namespace: Namespace = "",
) -> None:
    """Write a camera.yaml corrected by the lines that a robot sees in play: a mirror's lean, centre and ranges, or a
    perspective camera's roll, pitch, height and focal length.
    """
    link = robot if robot in ("udp", "ros") else None
    choice = LinkChoice(link, listen, None, topics or (), base, 0.0, namespace)
    choice.require_own_options()
    picture = new_files(output, CAMERA_ENDINGS, "a camera", picture)
    from touchline.camera import PerspectiveCamera

    if link is None:
        from touchline.sources import open_source

        source = open_source(Path(robot), follow_links)
        seen = _of_recording(source)
    else:
        if field is None:
            raise InputError("--field: is needed of a running robot")
        from touchline.localizer import Localizer

        localizer = Localizer(field, camera)
        begin(localizer, start)
        seen = _of_robot(localizer, choice, seconds)
    try:
        if isinstance(seen.camera, PerspectiveCamera):
            text, words, drawn = _perspective(seen, None if link is not None else partial(_of_recording, source))
        else:
            text, words, drawn = _mirror(seen)
    except NoFitError as error:
        raise NoFitError(f"{seen.name}: not calibrated: {error}") from None
    write_pair(output, text, picture, drawn, words)


def _take(seen: _Seen, system: Touchline, frame: Frame, estimate: Estimate) -> _Seen:
    """With one more image."""
    from touchline.calibration.self_perspective import perspective_view
    from touchline.camera import PerspectiveCamera

    if not isinstance(seen.camera, PerspectiveCamera):
        seen.estimates.append(estimate)
        return seen
    view = perspective_view(system, frame, estimate)
    if view is not None:
        seen.views.append(view)
    return seen._replace(system=system, head_moves=seen.head_moves or frame.base_from_camera is not None)


def _of_recording(source: Recording, camera: PerspectiveCamera | None = None) -> _Seen:
    """What is seen through the recording's own camera, or another."""
    from touchline.evaluation.runner import robot_setup
    from touchline.systems import open_system
    from touchline.systems.touchline import Touchline

    setup = robot_setup(source)
    if camera is not None:
        setup = replace(setup, camera=camera)
    system = open_system("touchline", setup)
    assert isinstance(system, Touchline)
    seen = _Seen(source.name, setup.camera, source.field, [], [])
    for frame in source:
        seen = _take(seen, system, frame, system.step(frame))
    return seen


def _of_robot(localizer: Localizer, choice: LinkChoice, seconds: float) -> _Seen:
    """What a running robot sees for so long, or until Ctrl-C."""
    from touchline.live.loop import LiveLoop
    from touchline.systems.touchline import Touchline

    taken = [_Seen("the robot", localizer.camera, localizer.field, [], [])]
    begun_s = time.monotonic()
    answered_s: float | None = None

    def take(published: Published) -> None:
        nonlocal answered_s
        answered_s = time.monotonic() if answered_s is None else answered_s
        system, frame = localizer.system, published.frame
        if frame is not None and isinstance(system, Touchline):
            taken[0] = _take(taken[0]._replace(camera=localizer.camera), system, frame, published.estimate)

    console = errors_console()
    console.print(f"looks for {seconds:g} s: let the robot walk about; Ctrl-C ends it earlier")
    with (
        closing(open_link(choice, localizer)) as link,
        announce_compiling(console.print),
        interruptible() as stop,
    ):
        loop = LiveLoop(link, localizer, take)

        def is_over() -> bool:
            if answered_s is None and loop.counts["images"]:
                return False  # the first answer may wait for a minute of compiling
            return time.monotonic() > (begun_s if answered_s is None else answered_s) + seconds

        loop.run(lambda: stop() or is_over())
        if not loop.counts["images"]:
            raise NoFitError(f"the robot: nothing came that could be looked at: {link.around()}")
    return taken[0]


def _mirror(seen: _Seen) -> tuple[str, str, ImageArray]:
    """camera.yaml, what to say, and the picture."""
    from touchline.calibration.self_calibration import calibrate_self as fit
    from touchline.calibration.self_calibration import spread_views
    from touchline.camera import require_omni
    from touchline.camera.writing import camera_yaml
    from touchline.view.calibration import self_picture

    if seen.camera is None:
        raise InputError("no camera is known: --camera names its camera.yaml, which is corrected")
    camera = require_omni(seen.camera, "calibrate self corrects")
    found = fit(spread_views(seen.estimates), camera, seen.field)
    words = _mirror_words(found, seen.name)
    return camera_yaml(found.camera, words), words, self_picture(found, seen.field)


def _perspective(seen: _Seen, look_again: Callable[[PerspectiveCamera], _Seen] | None) -> tuple[str, str, ImageArray]:
    """The same of a perspective camera. look_again: what is seen through another camera, where that can be had."""
    import numpy as np

    from touchline.calibration.perspective import perspective_yaml
    from touchline.camera import PerspectiveCamera
    from touchline.view.calibration import self_picture

    assert isinstance(seen.camera, PerspectiveCamera)
    focal_px, found = seen.camera.fx, _fitted(seen)
    shared, looks = found.shared, 1
    further = (
        "let the robot walk once more with --camera" if look_again is None else "calibrate the recording again with"
    )
    advice = f"that much hides what lines could tell: {further} what was found"
    # a moving head's own poses would have to be corrected as well
    while _is_far(found) and look_again is not None and not seen.head_moves and looks < _MAX_LOOKS:
        errors_console().print("the camera was far off: looks again through what was found")
        try:
            found = _fitted(look_again(found.camera))
        except NoFitError as error:
            advice = f"looked through again, what was found gave no camera; it is kept, and may be wrong: {error}"
            break
        ratios = (1.0 + shared[2:]) * (1.0 + found.shared[2:]) - 1.0
        shared, looks = np.concatenate((shared[:2] + found.shared[:2], ratios)), looks + 1
    words = _perspective_words(found, shared, focal_px, seen.name)
    if _is_far(found):
        words += f"\n{advice}"
    if seen.head_moves:
        words += (
            "\nthe robot itself places this camera in every image (camera_pose.csv, /tf): roll, pitch and height need "
            "the same correction there"
        )
    return perspective_yaml(found.camera, words), words, self_picture(found, seen.field)


def _is_far(found: PerspectiveSelfCalibration) -> bool:
    """Whether the camera that was looked through was."""
    return any(abs(error) > far for error, far in zip(found.shared.tolist(), _MAX_ERRORS, strict=True))


def _fitted(seen: _Seen) -> PerspectiveSelfCalibration:
    from touchline.calibration.self_calibration import require_views
    from touchline.calibration.self_perspective import calibrate_self_perspective, evenly
    from touchline.camera import PerspectiveCamera

    require_views(len(seen.views))
    assert seen.system is not None
    assert isinstance(seen.camera, PerspectiveCamera)
    return calibrate_self_perspective(evenly(seen.views), seen.camera, seen.system.registration)


def _mirror_words(found: SelfCalibration[OmniCamera], name: str) -> str:
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


def _perspective_words(found: PerspectiveSelfCalibration, shared: FloatArray, focal_px: float, name: str) -> str:
    """shared (4,): by what the first camera was off."""
    import math

    roll, pitch, height, _ = shared.tolist()
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
