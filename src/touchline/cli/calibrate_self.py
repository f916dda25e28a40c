"""`touchline calibrate self`: a mirror corrected by the lines that it has seen in play."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from touchline.cli.new_pair import CAMERA_ENDINGS, new_files, print_lines
from touchline.cli.options import FollowLinks
from touchline.errors import NoFitError
from touchline.new_files import write_new_file

if TYPE_CHECKING:
    from touchline.calibration.self_calibration import SelfCalibration


def calibrate_self(
    recording: Annotated[
        Path,
        typer.Argument(
            metavar="RECORDING", help="A recording of a robot that drives about on the field.", show_default=False
        ),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="The camera.yaml to write.", show_default=False)
    ],
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE", help="A picture of it (default: the output's name with .png).")
    ] = None,
    follow_links: FollowLinks = False,
) -> None:
    """Write a camera.yaml corrected by the lines of a recording: the mirror's lean, centre and ranges."""
    picture = new_files(output, CAMERA_ENDINGS, "a camera", picture)
    from touchline.calibration.self_calibration import calibrate_self as fit
    from touchline.calibration.self_calibration import spread_views
    from touchline.calibration.strip_recording import camera_yaml
    from touchline.camera import require_omni
    from touchline.evaluation.runner import robot_setup
    from touchline.sources import open_source
    from touchline.systems import open_system
    from touchline.view.picture_files import save_picture
    from touchline.view.self_calibration import self_picture

    source = open_source(recording, follow_links)
    setup = robot_setup(source)
    camera = require_omni(source.camera, "calibrate self corrects")
    system = open_system("touchline", setup)
    try:
        found = fit(spread_views([system.step(frame) for frame in source]), camera, source.field)
    except NoFitError as error:
        raise NoFitError(f"{recording}: not calibrated: {error}") from None
    words = _words(found, source.name)
    write_new_file(output, camera_yaml(found.camera, words).encode())
    save_picture(picture, self_picture(found, source.field))
    print_lines(words, output, picture)


def _words(found: SelfCalibration, name: str) -> str:
    """What was found, and how sure it is."""
    import math

    from touchline.localization.fusion.mirror_head import HEIGHT_M

    errors, sure = found.shared, found.camera.uncertainty
    lean_deg = math.degrees(0.5 * HEIGHT_M * math.hypot(errors[0], errors[1]))
    return (
        f"touchline calibrate self {name}: {len(found.views)} images\n"
        f"points on lines: {100 * found.before[0]:.0f} % before, {100 * found.after[0]:.0f} % after\n"
        f"mirror: leans by {lean_deg:.2f} ± {sure.tilt_deg:.2f} degrees, centre {errors[2]:+.1f}, {errors[3]:+.1f} ± "
        f"{sure.center_px:.1f} px (ahead, left), ranges {100 * errors[4]:+.1f} ± {100 * sure.range_ratio:.1f} %"
    )
