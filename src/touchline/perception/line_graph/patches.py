"""The line graph in the image of a fisheye or any other lens that bends straight lines.

Three perspective patches of it, side by side, are looked at one after the other: in each of them lines are straight and
posts rise straight, and no patch is so wide that its edges are blown up, as those of one image plane of 140° would be.
Neighbours overlap, so that what lies at a seam is seen whole; line points count in the patch to which they belong.
"""

import math
from dataclasses import replace
from typing import Any, TypeVar

import cv2
import numpy as np

from touchline.camera import Camera, GroundView, PerspectiveCamera, PinholeCamera
from touchline.field import FieldModel
from touchline.geometry import BoolArray, FloatArray, Pose3
from touchline.perception.detector import check_size
from touchline.perception.line_graph.colour_classes import CELL_PX, ColourClasses
from touchline.perception.line_graph.detector import LineGraphDetector, observe_from_view
from touchline.perception.line_graph.image_plane import ground_covariances, grounds_from_pixels, image_plane
from touchline.perception.line_graph.settings import LineGraphSettings
from touchline.types import Crossings, Frame, ImageArray, Landmarks, LinePoints, Lines, Observation

_OVERLAP_RAD = math.radians(12.0)  # beyond a seam: a crossing's circles of 25 cm, 1.2 m away
_MAX_UP_RAD = math.radians(52.0)  # of a patch: what lies higher or lower is no field, or the robot's feet
_GRID_PX = 8
_SAME_M, _SAME_RATIO = 0.3, 0.1  # what two patches see so near to each other, and more with the range, is one thing

Place = TypeVar("Place", Crossings, Landmarks)


class Patch:
    """A pinhole camera within one that bends lines, turned by yaw_rad about the camera's own z axis.

    seams: (2,) u from which on and up to which the image belongs to this patch; beyond is a neighbour's.
    """

    def __init__(self, camera: PerspectiveCamera, yaw_rad: float, half_rad: float) -> None:
        self.turn = Pose3.from_roll_pitch_yaw(0.0, 0.0, yaw_rad)
        self._whole = camera
        wide = math.tan(half_rad + _OVERLAP_RAD)
        columns, rows = (_cells(2.0 * camera.fx * reach) for reach in (wide, self._reach(wide)))
        middle = 0.5 * (columns - 1), 0.5 * (rows - 1)
        mount = camera.base_from_camera.compose(self.turn)
        self.camera = PinholeCamera(columns, rows, camera.fx, camera.fx, *middle, np.zeros(5), mount)
        seam = camera.fx * math.tan(half_rad)
        left, right = middle[0] - seam, middle[0] + seam
        self.seams = (left if yaw_rad <= 0.0 else -np.inf, right if yaw_rad >= 0.0 else np.inf)
        v, u = np.mgrid[0:rows, 0:columns]
        places = self.pixels(np.column_stack((u.ravel(), v.ravel())).astype(np.float64)).reshape(rows, columns, 2)
        places = np.nan_to_num(places, nan=-10.0).astype(np.float32)
        self._map = cv2.convertMaps(places[..., 0], places[..., 1], cv2.CV_16SC2)

    def _reach(self, wide: float) -> float:
        """How high and how low it has to look, as a tangent."""
        v, u = np.mgrid[0 : self._whole.height : _GRID_PX, 0 : self._whole.width : _GRID_PX]
        rays = self._whole.camera_rays(np.column_stack((u.ravel(), v.ravel()))) @ self.turn.rotation
        ahead = rays[rays[:, 0] > 0.1]
        inside = np.abs(ahead[:, 1]) <= wide * ahead[:, 0]
        return min(float(np.abs(ahead[inside, 2] / ahead[inside, 0]).max()), math.tan(_MAX_UP_RAD))

    def image(self, image: ImageArray) -> ImageArray:
        """What this patch shows of an image of the camera; black beyond it."""
        return np.asarray(cv2.remap(image, *self._map, cv2.INTER_LINEAR))

    def view(self, view: GroundView) -> GroundView:
        """This patch's view, from that of the camera."""
        return GroundView(self.camera, view.pose.compose(self.turn))

    def pixels(self, pixels: FloatArray) -> FloatArray:
        """Pixels (N, 2) of the camera, from those of this patch."""
        return self._whole.image_from_camera(self.camera.camera_rays(pixels) @ self.turn.rotation.T)

    def owns(self, pixels: FloatArray) -> BoolArray:
        """(N,) whether pixels (N, 2) of this patch are no neighbour's."""
        return (pixels[:, 0] >= self.seams[0]) & (pixels[:, 0] < self.seams[1])


class PatchedLineGraphDetector:
    """A `Detector` for a lens that bends lines: `LineGraphDetector` in three patches, the middle one learns colours."""

    def __init__(self, camera: PerspectiveCamera, settings: LineGraphSettings, field: FieldModel) -> None:
        self.camera, self.settings = camera, settings
        edges = camera.camera_rays([(0.0, camera.cy), (camera.width - 1.0, camera.cy)])
        half = float(np.nanmax(np.abs(np.arctan2(edges[:, 1], edges[:, 0])))) / 3.0
        self.patches = [Patch(camera, yaw, half) for yaw in (0.0, 2.0 * half, -2.0 * half)]
        self.detectors = [LineGraphDetector(patch.camera, settings, field) for patch in self.patches]
        for other in self.detectors[1:]:
            other.colours, other.leans = self.detectors[0].colours, self.detectors[0].leans

    @property
    def learns_colours(self) -> bool:
        """Whether the first images teach it its colours: not with a colour table."""
        return self.detectors[0].learns_colours

    @property
    def classes(self) -> ColourClasses | None:
        """The colours as known now."""
        return self.detectors[0].classes

    def reset(self) -> None:
        """Forget the colours, and how the camera leans."""
        self.detectors[0].reset()

    def observe(self, frame: Frame) -> Observation:
        """What a frame's image shows. Raises InputError for one of another size than the camera's, or without one."""
        return observe_from_view(frame, self.camera, self.detect)

    def detect(self, image: ImageArray, view: GroundView, stamp_ns: int = 0) -> Observation:
        """What an image (H, W, 3), B, G, R, shows from this view."""
        check_size(image, self.camera)
        seen = []
        for patch, detector in zip(self.patches, self.detectors, strict=True):
            look = detector.detect if detector is self.detectors[0] else detector.look
            found = look(patch.image(image), patch.view(view), stamp_ns)
            if found.problem is not None:
                return found
            seen.append(self._own(found, patch, patch.view(view)))
        return Observation(
            stamp_ns,
            LinePoints.joined([one.points for one in seen]),
            Lines.joined([one.lines for one in seen]),
            _without_doubles([one.crossings for one in seen]),
            _without_doubles([one.landmarks for one in seen]),
            LinePoints.joined([one.boundary for one in seen]),
        )

    def stages(self, image: ImageArray) -> dict[str, ImageArray]:
        """Title -> picture (H, W, 3), B, G, R, of each step, the patches side by side; as of `LineGraphDetector`."""
        check_size(image, self.camera)
        pairs = list(zip(self.patches, self.detectors, strict=True))
        pictures = [detector.stages(patch.image(image)) for patch, detector in pairs]
        middle, left, right = pictures
        rows = max(len(picture) for one in pictures for picture in one.values())
        return {title: np.hstack([_padded(one[title], rows) for one in (left, middle, right)]) for title in middle}

    def _own(self, seen: Observation, patch: Patch, view: GroundView) -> Observation:
        """What a patch has seen in pixels of the camera; line points and the boundary without what is a neighbour's."""
        points, boundary = (each.rows(patch.owns(each.pixels)) for each in (seen.points, seen.boundary))
        tables = (points, self._cut(seen.lines, patch, view), seen.crossings, seen.landmarks, boundary)
        moved: list[Any] = [
            replace(each, pixels=patch.pixels(each.pixels.reshape(-1, 2)).reshape(each.pixels.shape)) for each in tables
        ]
        return Observation(seen.stamp_ns, *moved)

    def _cut(self, lines: Lines, patch: Patch, view: GroundView) -> Lines:
        """Lines cut off at the seams; what is left of some is too short."""
        start, along = lines.pixels[:, 0], lines.pixels[:, 1] - lines.pixels[:, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            reached = (np.array(patch.seams) - start[:, :1]) / along[:, :1]
        low, high = np.clip(np.sort(reached, axis=1), 0.0, 1.0).T
        kept = (high - low) * np.hypot(*along.T) >= self.settings.min_line_px
        shares = np.stack((low, high), axis=1)[kept, :, np.newaxis]
        pixels = np.ascontiguousarray((start[kept, np.newaxis] + shares * along[kept, np.newaxis]).reshape(-1, 2))
        plane = image_plane(self.detectors[self.patches.index(patch)].lens, view)
        covariances = ground_covariances(plane, pixels, self.settings.noise_px, self.settings.noise_m)
        return Lines(
            grounds_from_pixels(plane, pixels).reshape(-1, 2, 2),
            covariances.reshape(-1, 2, 2, 2),
            lines.confidences[kept],
            pixels.reshape(-1, 2, 2),
        )


def line_graph_detector(
    camera: Camera, settings: LineGraphSettings, field: FieldModel
) -> LineGraphDetector | PatchedLineGraphDetector:
    """The line graph for a perspective camera's lens. Raises InputError for a camera that looks at a mirror."""
    if isinstance(camera, PerspectiveCamera) and not isinstance(camera, PinholeCamera):
        return PatchedLineGraphDetector(camera, settings, field)
    return LineGraphDetector(camera, settings, field)


def _cells(pixels: float) -> int:
    """Pixels as whole cells."""
    return CELL_PX * math.ceil(pixels / CELL_PX)


def _padded(picture: ImageArray, rows: int) -> ImageArray:
    return np.pad(picture, ((0, rows - len(picture)), (0, 0), (0, 0)))


def _without_doubles(tables: list[Place]) -> Place:
    """All rows but those of things that an earlier row has."""
    table = type(tables[0]).joined(tables)
    kept: list[int] = []
    for k, place in enumerate(table.positions_m):
        near = max(_SAME_M, _SAME_RATIO * float(np.hypot(*place)))
        if all(np.hypot(*(place - table.positions_m[other])) > near for other in kept):
            kept.append(k)
    return table.rows(np.isin(np.arange(len(table)), kept))
