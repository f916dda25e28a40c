"""A run in the Rerun viewer: its images, the field from above, the status and the errors.

    pip install rerun-sdk
    python examples/rerun_view.py runs/match-1
    python examples/rerun_view.py results.mcap --save results.rrd

RUN is the folder of a run, whose recording is read too if it is still where it was, or the MCAP file that
`touchline convert RUN results.mcap` writes. Without --save a window of the viewer opens.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from touchline.errors import InputError
from touchline.evaluation import Run
from touchline.evaluation.metrics import signed_errors
from touchline.evaluation.run_data import carried_rows
from touchline.geometry import FloatArray
from touchline.motion import LeanFilter
from touchline.sources import Recording
from touchline.types import Estimate, Frame, Samples, Status
from touchline.view.learned_view import as_learned
from touchline.view.overlay import projected_lines

try:
    import rerun
    import rerun.blueprint as blueprint
except ImportError:
    rerun = blueprint = None

COLORS = {Status.TRACKING: (0, 114, 178), Status.SEARCHING: (230, 159, 0), Status.LOST: (213, 94, 0)}
TRUTH, LINES, MAGENTA, BAND, CARPET = (0, 0, 0), (255, 255, 255), (255, 90, 235), (150, 150, 150), (169, 207, 164)
ERRORS = {"x": "x (cm)", "y": "y (cm)", "heading": "heading (°)"}
IN_CM_AND_DEG = np.array([100.0, 100.0, np.degrees(1.0)])
TURN = np.linspace(0.0, 2.0 * np.pi, 41)


def main(arguments: Sequence[str] | None = None) -> int:
    """Show what the command line names. The exit status is 2 for bad input."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, metavar="RUN", help="folder of a run, or an MCAP file of results")
    parser.add_argument("--save", type=Path, metavar="FILE.rrd", help="write this file instead of opening a window")
    given = parser.parse_args(arguments)
    if rerun is None:
        print("error: Rerun is not installed: pip install rerun-sdk", file=sys.stderr)
        return 2
    stream = rerun.RecordingStream("touchline")
    try:
        run = None if given.run.suffix == ".mcap" and given.run.is_file() else Run(given.run)
        if given.save is None:
            stream.spawn()
        else:
            stream.save(given.save)
        if run is None:
            stream.log_file_from_path(given.run)
        else:
            show_run(stream, run)
    except (InputError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    stream.flush()
    return 0


def show_run(stream: Any, run: Run) -> None:
    """Log all estimates of a run; the images, the field and the errors if its recording is found."""
    recording, truth, errors = None, None, np.full((len(run.estimates), 3), np.nan)
    try:
        recording, truth = run.recording(), run.truth
    except InputError as error:
        print(f"warning: {error}; only the estimates are shown", file=sys.stderr)
    table = run.estimates
    if truth is not None:
        compared = signed_errors(table.trajectory, truth)
        errors[compared.rows] = compared.values
        show_path(stream, "field/truth", truth, TRUTH)
    show_path(stream, "field/path", table.trajectory, COLORS[Status.TRACKING])
    send_layout(stream, recording)
    frames, leaning = iter(() if recording is None else recording), LeanFilter()
    for row in range(len(table)):
        estimate, frame = table.estimate(row), next(frames, None)
        stream.set_time("time", duration=(estimate.stamp_ns - int(table.trajectory.stamp_ns[0])) / 1e9)
        show_estimate(stream, estimate, errors[row])
        if recording is not None and frame is not None:
            leaning.add(frame)
            show_image(stream, recording, frame, leaning.lean(frame.stamp_ns), estimate)


def send_layout(stream: Any, recording: Recording | None) -> None:
    """Log what does not change, and the arrangement of the views: space on the left, time on the right."""
    upright = rerun.Transform3D(mat3x3=np.diag([1.0, -1.0, 1.0]))  # y points up, as on drawings of fields
    stream.log("field", upright, static=True)
    lines = [] if recording is None else recording.field.polylines()
    stream.log("field/lines", rerun.LineStrips2D(lines, colors=LINES, radii=0.03), static=True)
    states = {"values": [str(status) for status in COLORS], "colors": list(COLORS.values())}
    stream.log("status", rerun.StateConfiguration(**states), static=True)
    for name, title in ERRORS.items():
        stream.log(f"errors/{name}/error", rerun.SeriesLines(colors=COLORS[Status.TRACKING], names=title), static=True)
        stream.log(f"errors/{name}/band", rerun.SeriesLines(colors=[BAND, BAND], names=["+2σ", "-2σ"]), static=True)
    above = blueprint.Spatial2DView(origin="field", name="Field", background=CARPET)
    left = blueprint.Vertical(blueprint.Spatial2DView(origin="camera", name="Camera"), above)
    curves = [blueprint.TimeSeriesView(origin=f"errors/{name}", name=title) for name, title in ERRORS.items()]
    right = blueprint.Vertical(blueprint.StateTimelineView(origin="status", name="Status"), *curves)
    stream.send_blueprint(blueprint.Blueprint(blueprint.Horizontal(left, right)))


def show_path(stream: Any, name: str, poses: Samples, color: tuple[int, int, int]) -> None:
    """Log a whole path (N, 3), with gaps where the robot was carried."""
    strips = np.split(poses.values[:, :2], carried_rows(poses.values))
    stream.log(name, rerun.LineStrips2D(strips, colors=color, radii=-1.5), static=True)


def show_image(stream: Any, recording: Recording, frame: Frame, lean: Any, estimate: Estimate) -> None:
    """Log an image and, if the robot is tracked, the field's lines in it. lean: roll and pitch of the body (rad)."""
    if frame.image is None:
        return
    _, jpeg = cv2.imencode(".jpg", frame.image)
    stream.log("camera", rerun.EncodedImage(contents=jpeg.tobytes(), media_type="image/jpeg"))
    view, _ = as_learned(recording.camera, frame, lean, estimate)
    lines = projected_lines(view, recording.field, estimate.pose) if estimate.status is Status.TRACKING else []
    stream.log("camera/field_lines", rerun.LineStrips2D(lines, colors=MAGENTA, radii=0.8))


def show_estimate(stream: Any, estimate: Estimate, errors: FloatArray) -> None:
    """Log status, pose and 2σ ellipse on the field, and errors (3,) in (m, m, rad) with their 2σ."""
    color, (x, y, heading) = COLORS[estimate.status], estimate.pose
    stream.log("status", rerun.StateChange(state=str(estimate.status)))
    ahead = [np.cos(heading), np.sin(heading)]
    stream.log("field/robot", rerun.Arrows2D(origins=[[x, y]], vectors=[ahead], colors=color, radii=-2.0))
    sizes, axes = np.linalg.eigh(estimate.covariance[:2, :2])
    circle = np.column_stack((np.cos(TURN), np.sin(TURN)))
    ellipse = np.array([x, y]) + circle * (2.0 * np.sqrt(np.maximum(sizes, 0.0))) @ axes.T
    stream.log("field/ellipse", rerun.LineStrips2D([ellipse], colors=color, radii=-1.0))
    shown = IN_CM_AND_DEG * (errors if estimate.status is Status.TRACKING else np.nan)
    bounds = 2.0 * IN_CM_AND_DEG * np.sqrt(np.diagonal(estimate.covariance))
    for name, error, bound in zip(ERRORS, shown, bounds, strict=True):
        stream.log(f"errors/{name}/error", rerun.Scalars(error))
        stream.log(f"errors/{name}/band", rerun.Scalars([bound, -bound]))


if __name__ == "__main__":
    sys.exit(main())
