"""Image -> lines, crossings, landmarks, boundary by the line structure graph.

H. Schulz, S. Behnke: Utilizing the structure of field lines for efficient soccer robot localization, Advanced Robotics
26 (2012), sections 3 and 4.

    image ─▶ colour classes in cells (3) ─▶ field boundary (3.1) ─▶ low-pass, skeleton (3.2) ─▶ nodes, graph (3.3)
                                                                                                     │
                landmarks (4.3) ◀── column sums                     field lines (4.2) ◀──────────────┤
                                                                    key nodes, crossings (4.1) ◀─────┘
"""

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from touchline.camera import Camera, GroundView, PinholeCamera, ground_view
from touchline.errors import InputError
from touchline.field import FieldModel
from touchline.geometry import BoolArray, FloatArray, IntArray
from touchline.perception.colour import ColourModel, NoCarpetError
from touchline.perception.detector import check_size, image_of, lean_of
from touchline.perception.line_graph.circle import (
    Circle,
    LeanMemory,
    circle_landmark,
    find_leaning_circle,
    without_arcs,
)
from touchline.perception.line_graph.colour_classes import CELL_PX, ColourClasses
from touchline.perception.line_graph.colour_memory import ColourMemory
from touchline.perception.line_graph.contrast import BLOCK_PX
from touchline.perception.line_graph.crossings import find_crossings
from touchline.perception.line_graph.field_boundary import boundary_points
from touchline.perception.line_graph.field_lines import cell_pixels, find_lines, lines_on_ground
from touchline.perception.line_graph.image_plane import (
    ImagePlane,
    ground_ranges,
    grounds_from_pixels,
    image_plane,
    make_lens,
)
from touchline.perception.line_graph.landmarks import find_landmarks
from touchline.perception.line_graph.pictures import step_pictures
from touchline.perception.line_graph.profiles import Pixels
from touchline.perception.line_graph.settings import LineGraphSettings
from touchline.perception.line_graph.structure import Structure, find_structure, sides
from touchline.types import Frame, ImageArray, Landmarks, LinePoints, Observation

_NEAR_M = 3.0  # ground up to here is expected to be mostly carpet
_EVERY = 4  # pixels, both ways, between those whose ranges tell where the nearest quarter of what is seen ends
_GREENISH = 0.35  # of the carpet's own excess of green: what is beside paint is paler
_LOOSEST, _TIGHTEST = 1.7, 0.4  # how wide a line may look, against what is expected


class LineGraphDetector:
    """A `Detector` of lines, crossings and landmarks for a perspective camera that sees the field from above it."""

    def __init__(self, camera: Camera, settings: LineGraphSettings, field: FieldModel) -> None:
        """Raises InputError for a camera that looks at a mirror."""
        if not isinstance(camera, PinholeCamera):
            raise InputError(f"the line graph needs a perspective camera (model: pinhole); this one is {camera.model}")
        self.camera, self.settings, self.field = camera, settings, field
        self.lens = make_lens(camera)
        corners = np.isfinite(self.lens.table[..., 0])
        rows, columns = camera.height // CELL_PX, camera.width // CELL_PX
        self._usable = (corners[:-1, :-1] & corners[1:, :-1] & corners[:-1, 1:] & corners[1:, 1:])[:rows, :columns]
        self._radius_m = float(field.circles[0, 2]) if len(field.circles) and settings.paper.circle else 0.0
        yuv = settings.paper.colours == "yuv"
        self.colours = ColourMemory(settings.colour_file, settings.learning_frames, yuv)
        self.leans = LeanMemory()
        self._last_view = GroundView(camera)

    @property
    def learns_colours(self) -> bool:
        """Whether the first images teach it its colours: not with a colour table."""
        return self.settings.colour_file is None

    def reset(self) -> None:
        """Forget the colours, and how the camera leans."""
        self.colours.forget()
        self.leans.forget()

    def observe(self, frame: Frame) -> Observation:
        """What a frame's image shows. Raises InputError for one of another size than the camera's, or without one."""
        return observe_from_view(frame, self.camera, self.detect)

    def detect(self, image: ImageArray, view: GroundView, stamp_ns: int = 0) -> Observation:
        """What an image (H, W, 3), B, G, R, shows from this view."""
        check_size(image, self.camera)
        image = np.ascontiguousarray(image)
        try:
            if self.colours.is_learning:
                self.colours.learn(image, lambda: self._masks(view))
        except NoCarpetError as error:
            self._last_view = view
            return Observation(stamp_ns, problem=str(error))
        return self.look(image, view, stamp_ns, watching=True)

    def look(self, image: ImageArray, view: GroundView, stamp_ns: int = 0, watching: bool = False) -> Observation:
        """As `detect`, in the colours that are known. watching: whether it is a whole image: it is noticed when the
        green fades, and the first ones are counted.
        """
        if watching:
            self.colours.follow(image)
        assert self.colours.classes is not None
        plane = image_plane(self.lens, view)
        self._last_view = view
        structure = self._structure(image, self.colours.classes, plane)
        if watching:
            self.colours.watch(structure.counts, structure.sees_ground, structure.ends)
        seen, circle = self._features(image, structure, plane, stamp_ns)
        self.leans.take(circle, ends_image=watching)
        return seen

    def stages(self, image: ImageArray) -> dict[str, ImageArray]:
        """Title -> picture (H, W, 3), B, G, R, of each step of figure 1 on an image, seen from where the last one was.

        Raises TouchlineError before any colours are known.
        """
        check_size(image, self.camera)
        image = np.ascontiguousarray(image)
        if self.colours.classes is None:
            self.colours.learn(image, lambda: self._masks(self._last_view))
        assert self.colours.classes is not None
        plane = image_plane(self.lens, self._last_view)
        structure = self._structure(image, self.colours.classes, plane)
        radius_m = float(self.field.circles[0, 2]) if len(self.field.circles) else 0.0
        seen, _ = self._features(image, structure, plane, 0)
        return step_pictures(image, structure, seen, self._last_view, radius_m)

    @property
    def classes(self) -> ColourClasses | None:
        """The colours as known now."""
        return self.colours.classes

    def _features(
        self, image: ImageArray, structure: Structure, plane: ImagePlane, stamp_ns: int
    ) -> tuple[Observation, Circle | None]:
        """Section 4."""
        classes = self.colours.classes
        assert classes is not None
        pixels = self._pixels(image, classes, structure)
        found = find_lines(structure, pixels, plane, self.settings, self._radius_m)
        lines, points = lines_on_ground(found, plane, self.settings)
        at = (plane.foot[0], plane.foot[1], plane.height)
        circle = self._circle(structure, plane, lines.ends_m, at)
        if circle is not None:
            lines = without_arcs(lines, circle, at)
        crossings = find_crossings(structure, lines, pixels, plane, self.settings)
        upright = find_landmarks(structure, classes, pixels, lines, plane, self.field, self.settings)
        landmarks = Landmarks.joined([upright, circle_landmark(circle, at)])
        return Observation(stamp_ns, points, lines, crossings, landmarks, self._boundary(structure, plane)), circle

    def _structure(self, image: ImageArray, classes: ColourClasses, plane: ImagePlane) -> Structure:
        return find_structure(image, classes, self._usable, plane, self.field.line_width, self.settings)

    def _pixels(self, image: ImageArray, classes: ColourClasses, structure: Structure) -> Pixels:
        least, signal = _read_by(classes.model)
        return Pixels(image, least, signal, structure.paint, structure.base, self.field.line_width, _LOOSEST, _TIGHTEST)

    def _masks(self, view: GroundView) -> tuple[BoolArray, BoolArray, IntArray]:
        """(H, W) pixels that see ground near by, and ground that is looked at at all; `sides` of a line."""
        plane, ranges_m = image_plane(self.lens, view), np.empty((self.camera.height, self.camera.width))
        ground_ranges(plane, ranges_m)
        around = ranges_m <= self.settings.max_range_m
        some_m = ranges_m[::_EVERY, ::_EVERY]
        some_m = some_m[some_m <= self.settings.max_range_m]
        near = ranges_m <= max(_NEAR_M, float(np.quantile(some_m, 0.25)) if len(some_m) else _NEAR_M)
        return near, around, sides(plane, self.camera.height // BLOCK_PX, self.field.line_width)

    def _circle(
        self, structure: Structure, plane: ImagePlane, ends_m: FloatArray, at: tuple[float, float, float]
    ) -> Circle | None:
        if not self._radius_m:
            return None
        ground = grounds_from_pixels(plane, cell_pixels(structure.graph.places))
        reach_m = self.settings.crossing_m
        return find_leaning_circle(structure.graph, ground, ends_m, self._radius_m, reach_m, at, self.leans.leans)

    def _boundary(self, structure: Structure, plane: ImagePlane) -> LinePoints:
        pixels, ground, covariances = boundary_points(plane, structure.ends, structure.smooth.shape[0])
        return LinePoints(ground, covariances, np.full(len(ground), 0.5), pixels)


@lru_cache(maxsize=4)
def _read_by(model: ColourModel) -> tuple[float, FloatArray]:
    """`least_green` and `signal` of `Pixels`."""
    signal = np.outer(model.signal, np.arange(256.0))
    signal[0] -= float(model.signal @ model.green)
    blue, green, red = model.green
    return _GREENISH * float((green - 0.5 * (blue + red)) / model.green.sum()), signal


def observe_from_view(
    frame: Frame, camera: Camera, detect: Callable[[ImageArray, GroundView, int], Observation]
) -> Observation:
    """What `detect` finds in a frame's image, seen from where the camera was. Raises InputError as `image_of` does."""
    image = image_of(frame, camera)
    try:
        view = ground_view(camera, frame.base_from_camera, *lean_of(frame))
    except InputError as error:
        return Observation(frame.stamp_ns, problem=str(error))
    return detect(image, view, frame.stamp_ns)
