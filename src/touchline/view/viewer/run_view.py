"""What the viewer is shown of every frame: the image and what was seen in it, the field from above, the curves."""

import importlib
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import cv2
import numpy as np

from touchline.camera import Camera, GroundView
from touchline.evaluation.latency import START_FRAMES
from touchline.field import FieldModel
from touchline.geometry import BoolArray, FloatArray, Pose, wrap_angle
from touchline.motion import LeanFilter
from touchline.palette import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILLION, YELLOW, rgb
from touchline.perception.feature_pictures import landmark_name
from touchline.types import Estimate, Frame, ImageArray, Observation, Status
from touchline.view.learned_view import as_learned
from touchline.view.overlay import ON_LINE_M, projected_lines
from touchline.view.viewer.library import rerun_library

TrueAt = Callable[[int], Pose | None]
"""The true pose at a stamp (ns), if it is known there."""
Particles = Callable[[Estimate], FloatArray | None]
"""A system's particles at an estimate (N, 4): x, y (m), heading (rad), weight; None where it has none."""

_JPEG_QUALITY = 80
_CENTIMETRES, _DEGREES = 100.0, 180.0 / math.pi
_SIGMAS = 2.0
_CARRIED_M = 1.0  # in one step: the path goes on elsewhere, no line is drawn
_PAINT, _FIELD_LINES = "#ffffff", "#ff5aeb"
_PATH = -1.5  # radii below zero are in pixels: as wide on a small field as on a large one
_ARROW_M = 0.9  # from the robot's middle to where it looks
_TURN = np.linspace(0.0, 2.0 * math.pi, 41)
_CIRCLE = np.column_stack((np.cos(_TURN), np.sin(_TURN)))


class RunView:
    """Shows a run on a Rerun stream: `show` is called with every frame and its estimate.

    field: where the robot plays. camera: None where a detector of the robot's own sees. true_at: None if no truth is
    known. about: a text in Markdown that tells what is shown. Raises InputError where Rerun is not installed.
    """

    def __init__(
        self,
        stream: Any,
        field: FieldModel,
        camera: Camera | None,
        *,
        true_at: TrueAt | None = None,
        particles: Particles = lambda estimate: None,
        about: str = "",
    ) -> None:
        self._rerun, self._stream = rerun_library(), stream
        self._field, self._camera, self._true_at, self._particles = field, camera, true_at, particles
        self._leaning = LeanFilter()
        self._begin_ns: int | None = None
        self._frames = 0
        self._last: dict[str, Pose] = {}
        self._status: Status | None = None
        size_m = (field.length + 2.0 * field.border, field.width + 2.0 * field.border)
        stream.send_blueprint(layout(size_m, errors=true_at is not None))
        send_styles(stream, errors=true_at is not None)
        self._draw_field()
        stream.log(ABOUT, self._rerun.TextDocument(about, media_type="text/markdown"), static=True)

    def show(self, frame: Frame, estimate: Estimate) -> None:
        """One frame, and what the system made of it."""
        if self._begin_ns is None:
            self._begin_ns = frame.stamp_ns
        self._stream.set_time(TIMELINE, duration=np.timedelta64(frame.stamp_ns - self._begin_ns, "ns"))
        self._stream.set_time("frame", sequence=self._frames)
        self._frames += 1
        self._leaning.add(frame)
        self._show_camera(frame, estimate)
        self._show_above(estimate)
        self._show_truth(frame.stamp_ns, estimate)
        self._show_curves(frame, estimate)
        for problem in (*([frame.problem] if frame.problem and frame.image is None else ()), *estimate.problems):
            self._stream.log(LOG, self._rerun.TextLog(str(problem), level="WARN"))

    def _draw_field(self) -> None:
        """The field as it does not change; y goes up, as on every drawing of a field."""
        rerun = self._rerun
        upright = rerun.Transform3D(mat3x3=[[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]])
        self._stream.log(FIELD, upright, static=True)
        paint = rerun.LineStrips2D(self._field.polylines(), colors=rgb(_PAINT), radii=0.5 * self._field.line_width)
        self._stream.log(f"{FIELD}/lines", paint, static=True)
        posts = self._field.posts
        if posts:
            places = rerun.Points2D([(post.x, post.y) for post in posts], colors=rgb(YELLOW), radii=0.08)
            self._stream.log(f"{FIELD}/posts", places, static=True)

    def _show_camera(self, frame: Frame, estimate: Estimate) -> None:
        rerun = self._rerun
        if frame.image is None:
            self._stream.log(CAMERA, rerun.Clear(recursive=True))
            return
        jpeg = _jpeg(frame.image)
        self._stream.log(f"{CAMERA}/image", rerun.EncodedImage(contents=jpeg, media_type="image/jpeg"))
        if self._camera is None:
            return
        view, seen = as_learned(self._camera, frame, self._leaning.lean(frame.stamp_ns), estimate)
        located = estimate.status is Status.TRACKING  # field lines at a guessed pose would mislead
        lines = projected_lines(view, self._field, estimate.pose) if located else []
        self._stream.log(f"{CAMERA}/field_lines", rerun.LineStrips2D(lines, colors=rgb(_FIELD_LINES), radii=0.8))
        self._show_seen(view, seen or Observation(estimate.stamp_ns), estimate.pose if located else None)

    def _show_seen(self, view: GroundView, seen: Observation, pose: Pose | None) -> None:
        """Points, lines, crossings and landmarks where they were seen in the image. pose: None if not located."""
        rerun, points = self._rerun, seen.points
        known = np.isfinite(points.pixels).all(axis=1)
        on_line: BoolArray = np.ones(len(points), dtype=np.bool_)
        if pose is not None and len(points):
            on_line = self._field.line_distances(pose.transform(points.positions_m)) <= ON_LINE_M
        colors = [rgb(SKY if near else ORANGE) for near in on_line[known].tolist()]
        self._stream.log(f"{CAMERA}/points", rerun.Points2D(points.pixels[known], colors=colors, radii=1.5))
        lines = [view.image_from_ground(ends) for ends in _stretched(seen.lines.ends_m)]
        lines = [line for line in lines if np.isfinite(line).all()]
        self._stream.log(f"{CAMERA}/lines", rerun.LineStrips2D(lines, colors=rgb(YELLOW), radii=1.2))
        for path, places, names, color in _named(seen):
            pixels = view.image_from_ground(places) if len(places) else places
            kept = np.asarray(np.isfinite(pixels).all(axis=1))
            labels = [name for name, keep in zip(names, kept.tolist(), strict=True) if keep]
            self._stream.log(f"{CAMERA}/{path}", self._points(pixels[kept], color, 3.0, labels))

    def _show_above(self, estimate: Estimate) -> None:
        """The robot, its covariance, hypotheses, particles and what it sees, on the field."""
        rerun, pose = self._rerun, estimate.pose
        located = estimate.status is Status.TRACKING
        color = STATUS_COLORS[estimate.status]
        self._stream.log(f"{FIELD}/robot", self._arrows([pose], color, 2.5))
        ellipse = rerun.LineStrips2D([covariance_ellipse(pose, estimate.covariance)], colors=rgb(color), radii=-1.0)
        self._stream.log(f"{FIELD}/covariance", ellipse)
        others = estimate.hypotheses
        self._stream.log(f"{FIELD}/hypotheses", self._arrows([other.pose for other in others], PURPLE, 1.5))
        likely = [other for other in others if other.probability is not None]
        labels = [f"{100.0 * (other.probability or 0.0):.0f} %" for other in likely]
        chances = self._points([other.pose[:2] for other in likely], BLACK, 0.06, labels)
        self._stream.log(f"{FIELD}/hypotheses/probability", chances)
        wide = [covariance_ellipse(one.pose, one.covariance) for one in others if one.covariance is not None]
        self._stream.log(f"{FIELD}/hypotheses/covariance", rerun.LineStrips2D(wide, colors=rgb(PURPLE), radii=-1.0))
        self._show_particles(estimate)
        seen = estimate.observation
        places = pose.transform(seen.points.positions_m) if seen is not None and located else np.zeros((0, 2))
        self._stream.log(f"{FIELD}/points", rerun.Points2D(places, colors=rgb(VERMILLION), radii=-1.5))
        self._extend("path", pose if located else None, color)

    def _show_particles(self, estimate: Estimate) -> None:
        particles = self._particles(estimate)
        if particles is None:
            particles = np.zeros((0, 4))
        heading = 0.15 * np.column_stack((np.cos(particles[:, 2]), np.sin(particles[:, 2])))
        shown = self._rerun.Arrows2D(origins=particles[:, :2], vectors=heading, colors=rgb(GREEN), radii=0.012)
        self._stream.log(f"{FIELD}/particles", shown)

    def _show_truth(self, stamp_ns: int, estimate: Estimate) -> None:
        """The true robot, and the error with its band; a gap where the robot is not tracked."""
        if self._true_at is None:
            return
        truth = self._true_at(stamp_ns)
        self._stream.log(f"{FIELD}/true_robot", self._arrows([] if truth is None else [truth], BLACK, 1.0))
        self._extend("truth", truth, BLACK)
        error = np.full(3, np.nan)
        if truth is not None and estimate.status is Status.TRACKING:
            turn = wrap_angle(estimate.pose.heading - truth.heading)
            error = np.array([estimate.pose.x - truth.x, estimate.pose.y - truth.y, turn])
        band = _SIGMAS * np.sqrt(np.maximum(np.diagonal(estimate.covariance), 0.0))
        if estimate.status is not Status.TRACKING:
            band = np.full(3, np.nan)
        for name, scale, value, reach in zip(
            ("x", "y", "heading"), (_CENTIMETRES, _CENTIMETRES, _DEGREES), error, band, strict=True
        ):
            self._plot(f"{name}/error", scale * value)
            self._stream.log(f"plots/{name}/band", self._rerun.Scalars([scale * reach, -scale * reach]))

    def _show_curves(self, frame: Frame, estimate: Estimate) -> None:
        if estimate.status is not self._status:
            self._status = estimate.status
            self._stream.log(STATUS, self._rerun.StateChange(state=str(estimate.status)))
        self._plot("residual/residual", _CENTIMETRES * estimate.residual_m)
        if self._frames > START_FRAMES:
            self._plot("latency/perception", estimate.perception_ms)
            self._plot("latency/localization", estimate.localization_ms)
        if frame.exposure_ms is not None:
            self._plot("exposure/exposure", frame.exposure_ms)
        if frame.gain is not None:
            self._plot("exposure/gain", frame.gain)
        if frame.compass is not None and len(frame.compass) and estimate.status is Status.TRACKING:
            turn = wrap_angle(float(frame.compass.values[-1, 0]) - estimate.pose.heading)
            self._plot("compass/compass", _DEGREES * turn)

    def _plot(self, path: str, value: float) -> None:
        self._stream.log(f"plots/{path}", self._rerun.Scalars(float(value)))

    def _extend(self, name: str, pose: Pose | None, color: str) -> None:
        """One step more of a path; where the robot was carried, or is not located, the path has a gap."""
        before = self._last.pop(name, None)
        if pose is None:
            return
        self._last[name] = pose
        if before is not None and before.distance_to(pose) < _CARRIED_M:
            step = self._rerun.LineStrips2D([[before[:2], pose[:2]]], colors=rgb(color), radii=_PATH)
            self._stream.log(f"{FIELD}/{name}", step)

    def _points(self, places: Any, color: str, radius: float, labels: list[str]) -> Any:
        """Points (N, 2) with a label each."""
        rows = np.array(places, dtype=np.float64).reshape(-1, 2)
        return self._rerun.Points2D(rows, colors=rgb(color), radii=radius, labels=labels or None)

    def _arrows(self, poses: list[Pose], color: str, radius_px: float) -> Any:
        origins = np.array([pose[:2] for pose in poses], dtype=np.float64).reshape(-1, 2)
        headings = np.array([pose.heading for pose in poses], dtype=np.float64)
        vectors = _ARROW_M * np.column_stack((np.cos(headings), np.sin(headings)))
        return self._rerun.Arrows2D(origins=origins, vectors=vectors, colors=rgb(color), radii=-radius_px)


def covariance_ellipse(pose: Pose, covariance: FloatArray) -> FloatArray:
    """The outline (M, 2) of the 2σ ellipse of a position, field frame, from a pose's covariance (3, 3)."""
    sizes, axes = np.linalg.eigh(covariance[:2, :2])
    spread: FloatArray = _CIRCLE * (_SIGMAS * np.sqrt(np.maximum(sizes, 0.0))) @ axes.T
    return np.asarray(pose[:2]) + spread


def _named(seen: Observation) -> list[tuple[str, FloatArray, list[str], str]]:
    """Crossings and landmarks: path, places (N, 2) in the robot frame, what each is called, colour."""
    crossings, landmarks = seen.crossings, seen.landmarks
    names = [landmark_name(kind) for kind in landmarks.kinds.tolist()]
    return [
        ("crossings", crossings.positions_m, crossings.kinds.tolist(), VERMILLION),
        ("landmarks", landmarks.positions_m, names, BLUE),
    ]


def _stretched(ends_m: FloatArray) -> list[FloatArray]:
    """Lines (N, 2, 2) as polylines (16, 2), which bend as the lens bends them."""
    share = np.linspace(0.0, 1.0, 16)[:, np.newaxis]
    return [(1.0 - share) * start + share * end for start, end in ends_m]


def _jpeg(image: ImageArray) -> bytes:
    done, code = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return code.tobytes() if done else b""


# --- layout -----------------------------------------------------------------------------------------------------------


TIMELINE = "time"
CAMERA, FIELD, STATUS, ABOUT, LOG = "camera", "above/field", "status", "about", "log"
STATUS_COLORS = {Status.TRACKING: BLUE, Status.SEARCHING: ORANGE, Status.LOST: VERMILLION}


class Plot(NamedTuple):
    """A plot of curves over time: its path, title and, for each curve, path, name and colour.

    banded: two curves more, ± 2σ about zero, are drawn thinner.
    """

    path: str
    title: str
    curves: tuple[tuple[str, str, str], ...]
    banded: bool = False


ERRORS = (
    Plot("plots/x", "x (cm), ± 2σ", (("error", "error of x", BLUE),), banded=True),
    Plot("plots/y", "y (cm), ± 2σ", (("error", "error of y", VERMILLION),), banded=True),
    Plot("plots/heading", "heading (°), ± 2σ", (("error", "error of heading", GREEN),), banded=True),
)
MEASURED = (
    Plot("plots/residual", "Residual (cm)", (("residual", "residual", PURPLE),)),
    Plot("plots/compass", "Compass (°)", (("compass", "compass less heading", SKY),)),
    Plot("plots/exposure", "Exposure (ms), gain", (("exposure", "exposure (ms)", ORANGE), ("gain", "gain", GREEN))),
    Plot(
        "plots/latency",
        "Time (ms)",  # of the first ones, in which code is loaded, nothing is drawn
        (("perception", "perception", BLUE), ("localization", "localization", VERMILLION)),
    ),
)
_BAND, _CARPET = "#999999", "#a9cfa4"  # light enough for every colour upon it


def layout(field_m: tuple[float, float], errors: bool) -> Any:
    """The blueprint: image and field from above on the left, status and curves on the right; errors and what was
    measured lie behind each other, so that a narrow window has room for their titles and axes.

    field_m: length and width, border included. errors: whether the truth is known.
    """
    blueprint = importlib.import_module("rerun.blueprint")
    half_x, half_y = 0.5 * field_m[0], 0.5 * field_m[1]
    bounds = blueprint.VisualBounds2D(x_range=[-half_x, half_x], y_range=[-half_y, half_y])
    everything = blueprint.VisibleTimeRange(
        TIMELINE, start=blueprint.TimeRangeBoundary.infinite(), end=blueprint.TimeRangeBoundary.cursor_relative()
    )
    above = blueprint.Spatial2DView(
        origin="above",
        name="Field",
        visual_bounds=bounds,
        background=rgb(_CARPET),
        overrides={f"{FIELD}/{path}": blueprint.VisibleTimeRanges(everything) for path in ("path", "truth")},
    )
    texts = (blueprint.TextDocumentView(origin=ABOUT, name="About"), blueprint.TextLogView(origin=LOG, name="Problems"))
    left = blueprint.Vertical(
        blueprint.Spatial2DView(origin=CAMERA, name="Camera"), blueprint.Tabs(above, *texts), row_shares=[1, 1]
    )
    groups = (("Errors", ERRORS if errors else ()), ("Measured", MEASURED))
    curves = [
        blueprint.Vertical(*(_plot_view(blueprint, plot) for plot in plots), name=name)
        for name, plots in groups
        if plots
    ]
    status = blueprint.StateTimelineView(origin=STATUS, name="Status")
    right = blueprint.Vertical(status, blueprint.Tabs(*curves, active_tab=0), row_shares=[1, 6])
    return blueprint.Blueprint(
        blueprint.Horizontal(left, right, column_shares=[1.2, 1.0]),
        blueprint.TimePanel(state="collapsed", timeline=TIMELINE),
        blueprint.SelectionPanel(state="hidden"),
        blueprint.BlueprintPanel(state="hidden"),
    )


def send_styles(stream: Any, errors: bool) -> None:
    """Names, colours and widths of all curves, once."""
    rerun = importlib.import_module("rerun")
    states = list(STATUS_COLORS)
    stream.log(
        STATUS,
        rerun.StateConfiguration(values=list(map(str, states)), colors=list(map(rgb, STATUS_COLORS.values()))),
        static=True,
    )
    for plot in (*(ERRORS if errors else ()), *MEASURED):
        for path, name, color in plot.curves:
            style = rerun.SeriesLines(colors=rgb(color), names=name, widths=1.5)
            stream.log(f"{plot.path}/{path}", style, static=True)
        if plot.banded:
            band = rerun.SeriesLines(colors=2 * [rgb(_BAND)], names=["+2σ", "-2σ"], widths=[1.0, 1.0])
            stream.log(f"{plot.path}/band", band, static=True)


def _plot_view(blueprint: Any, plot: Plot) -> Any:
    legend = blueprint.PlotLegend(visible=len(plot.curves) > 1)
    return blueprint.TimeSeriesView(origin=plot.path, name=plot.title, plot_legend=legend)
