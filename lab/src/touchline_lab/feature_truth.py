"""What of a field's lines and crossings an image really shows, and how many of them a detector has found."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from touchline.camera import GroundView
from touchline.field import FieldModel
from touchline.field.crossings import Crossing
from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.types import CrossingKind, Crossings, LandmarkKind, Landmarks, Lines

MATCHED_M = 0.25
_ARM_M = (0.08, 0.12, 0.16, 0.2)  # where the paint of a crossing's arms is looked for
_SHIFT_PX = 12  # the truth of the camera's lean is only known to a degree
_LEAN_RAD, _HEIGHT_M = math.radians(0.7), 1.0
_PAINT, _CARPET = 0.5, 0.35  # whiteness of what is paint, and of what is not


class Tally(NamedTuple):
    """How many were found and right, found at all, there, and of those found."""

    right: int = 0
    found: int = 0
    there: int = 0
    recalled: int = 0

    @classmethod
    def total(cls, tallies: Iterable[Tally]) -> Tally:
        """Their sum."""
        return cls(*map(sum, zip(*tallies, strict=True)))

    @property
    def precision(self) -> float:
        """Share of what was found that is right; NaN without any."""
        return self.right / self.found if self.found else math.nan

    @property
    def recall(self) -> float:
        """Share of what was there that was found; NaN without any."""
        return self.recalled / self.there if self.there else math.nan


@dataclass(frozen=True, eq=False, slots=True)
class TrueFeatures:
    """The field about a robot. field: in the field frame; pose: where it stands; view: of its camera.

    whiteness: (H, W) of the image, 0 carpet to 1 paint.
    """

    field: FieldModel
    pose: Pose
    view: GroundView
    whiteness: FloatArray

    def crossings(self, farthest_m: float) -> list[tuple[CrossingKind, FloatArray]]:
        """Kind and place (2,), robot frame, of the crossings within a range whose paint is visible all about."""
        seen = []
        for crossing in self.field.crossings:
            place = self._in_robot_frame(np.array([[crossing.x, crossing.y]]))[0]
            if np.hypot(*place) <= farthest_m and self._shows(crossing, place):
                seen.append((crossing.kind, place))
        return seen

    def tally_crossings(self, found: Crossings, farthest_m: float) -> dict[str, Tally]:
        """Of each kind and of `all`: matched within 0.25 m. Found ones count up to the range, true ones where visible.

        A found crossing is right where the field has one of its kind, visible or not.
        """
        everything = [(c.kind, self._in_robot_frame(np.array([[c.x, c.y]]))[0]) for c in self.field.crossings]
        near = np.hypot(*found.positions_m.T) <= farthest_m
        there = self.crossings(farthest_m)
        tallies = {}
        for kind in ("L", "T", "X"):
            places = found.positions_m[near & (found.kinds == kind)]
            right = sum(_is_near(place, [p for k, p in everything if k == kind]) for place in places)
            all_places = found.positions_m[found.kinds == kind]
            true = [p for k, p in there if k == kind]
            tallies[kind] = Tally(right, len(places), len(true), sum(_is_near(p, all_places) for p in true))
        tallies["all"] = Tally(*(sum(values) for values in zip(*tallies.values(), strict=True)))
        return tallies

    def tally_landmarks(self, found: Landmarks, farthest_m: float) -> dict[str, Tally]:
        """Of posts, poles and penalty marks: matched within 0.25 m, farther off a tenth of the range more.

        There are those whose foot is in view; what hides one is not known: some of these can't be seen.
        """
        middle = self.field.line_distances(self.field.discs[:, :2]) < self.field.line_width
        true = {
            LandmarkKind.POST: [(p.x, p.y) for p in self.field.posts if p.kind == "goal"],
            LandmarkKind.POLE: [(p.x, p.y) for p in self.field.poles],
            LandmarkKind.PENALTY_MARK: self.field.discs[~middle, :2].tolist(),
        }
        tallies = {}
        for kind, field_places in true.items():
            places = self._in_robot_frame(np.array(field_places, dtype=np.float64).reshape(-1, 2))
            of_kind = found.positions_m[found.kinds == kind]
            of_kind = of_kind[np.hypot(*of_kind.T) <= farthest_m]
            there = [p for p in places if np.hypot(*p) <= farthest_m and self._in_image(p)]
            right = sum(_is_close(p, places) for p in of_kind)
            tallies[str(kind)] = Tally(right, len(of_kind), len(there), sum(_is_close(p, of_kind) for p in there))
        return tallies

    def landmark_errors_m(self, found: Landmarks) -> list[float]:
        """Distance (m) of each found post, pole and penalty mark from the nearest that there is, within 0.5 m."""
        true = [(p.x, p.y) for p in self.field.posts] + [(x, y) for x, y, _ in self.field.discs]
        places = self._in_robot_frame(np.array(true, dtype=np.float64).reshape(-1, 2))
        single = np.isin(found.kinds, [LandmarkKind.POST, LandmarkKind.POLE, LandmarkKind.PENALTY_MARK])
        errors = [float(np.hypot(*(places - p).T).min()) for p in found.positions_m[single]] if len(places) else []
        return [error for error in errors if error <= 0.5]

    def tally_lines(self, found: Lines, farthest_m: float) -> Tally:
        """Lines: right where both ends lie on one segment of the field; there where half a metre of one is in view."""
        segments = [self._in_robot_frame(s.reshape(2, 2)) for s in self.field.segments]
        on = [[_lies_on(line, segment) for segment in segments] for line in found.ends_m]
        near = [np.hypot(*line.T).min() <= farthest_m for line in found.ends_m]
        right = sum(any(row) for row, is_near in zip(on, near, strict=True) if is_near)
        there = recalled = 0
        for index, segment in enumerate(segments):
            if self._visible_length(segment, farthest_m) >= 0.5:
                there += 1
                recalled += any(row[index] for row in on)
        return Tally(right, sum(near), there, recalled)

    def boundary_error_px(self, pixels: FloatArray) -> FloatArray:
        """How many pixels the boundary's points (N, 2) lie below the carpet's true edge; NaN outside the image."""
        half = np.array([self.field.length, self.field.width]) / 2.0 + self.field.border
        corners = half * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 1]])
        edge = np.concatenate([np.linspace(a, b, 400) for a, b in pairwise(corners)])
        image = self.view.image_from_ground(self._in_robot_frame(edge))
        image = image[np.isfinite(image).all(axis=1)]
        errors = np.full(len(pixels), np.nan)
        for k, (u, v) in enumerate(pixels):
            beside = np.abs(image[:, 0] - u) < 6.0
            if beside.any() and image[beside, 1].min() >= 0.0:
                errors[k] = v - image[beside, 1].min()
        return errors

    def _in_robot_frame(self, points: FloatArray) -> FloatArray:
        return self.pose.inverse().transform(points)

    def _in_image(self, place: FloatArray) -> bool:
        u, v = self.view.image_from_ground(place[np.newaxis])[0]
        height, width = self.whiteness.shape
        return bool(0.0 <= u < width and 0.0 <= v < height)

    def _visible_length(self, segment: FloatArray, farthest_m: float) -> float:
        """How much (m) of a segment (2, 2), robot frame, is in view and shows paint."""
        steps = max(2, int(np.hypot(*(segment[1] - segment[0])) / 0.05))
        points = np.linspace(segment[0], segment[1], steps)
        points = points[np.hypot(*points.T) <= farthest_m]
        return 0.05 * sum(self._whitest(point, 6) > _PAINT for point in points)

    def _whitest(self, point: FloatArray, reach_px: int) -> float:
        u, v = self.view.image_from_ground(point[np.newaxis])[0]
        height, width = self.whiteness.shape
        if not (reach_px <= u < width - reach_px and reach_px <= v < height - reach_px):
            return 0.0
        row, column = round(v), round(u)
        return float(
            self.whiteness[row - reach_px : row + reach_px + 1, column - reach_px : column + reach_px + 1].max()
        )

    def _shows(self, crossing: Crossing, place: FloatArray) -> bool:
        """Whether somewhere within a few pixels the image shows the crossing: its arms white, between them carpet."""
        orientation = wrap_angle(crossing.orientation_rad - self.pose.heading)
        turns = {"L": (-0.25, 0.25), "T": (0.0, 0.5, -0.5), "X": (0.0, 0.5, 1.0, -0.5)}[crossing.kind]
        arms = np.array([orientation + math.pi * turn for turn in turns])
        quarters = {"L": (-0.5, 0.5, 0.0, 1.0), "T": (0.25, -0.25, 1.0), "X": (0.25, 0.75, -0.25, -0.75)}[crossing.kind]
        gaps = np.array([orientation + math.pi * turn for turn in quarters])
        white, plain = (
            np.concatenate([place + r * np.column_stack((np.cos(a), np.sin(a))) for r in _ARM_M]) for a in (arms, gaps)
        )
        image = self.view.image_from_ground(np.concatenate((white, plain)))
        height, width = self.whiteness.shape
        if not (np.isfinite(image).all() and (image >= 0).all() and (image <= (width - 1, height - 1)).all()):
            return False
        shifts = np.arange(-_SHIFT_PX, _SHIFT_PX + 1, 2)
        du, dv = np.meshgrid(shifts, shifts)
        u = np.clip(np.rint(image[:, 0, np.newaxis] + du.ravel()), 0, width - 1).astype(np.int64)
        v = np.clip(np.rint(image[:, 1, np.newaxis] + dv.ravel()), 0, height - 1).astype(np.int64)
        values = self.whiteness[v, u]
        painted = (values[: len(white)] > _PAINT).mean(axis=0)
        bare = (values[len(white) :] < _CARPET).mean(axis=0)
        return bool(((painted > 0.85) & (bare > 0.85)).any())


def _is_near(place: FloatArray, others: list[FloatArray] | npt.NDArray[np.floating]) -> bool:
    return any(np.hypot(*(place - other)) <= MATCHED_M for other in others)


def _is_close(place: FloatArray, others: FloatArray) -> bool:
    """Within 0.25 m, and a tenth of the range: a foot is placed by its row in the image."""
    return any(np.hypot(*(place - other)) <= MATCHED_M + 0.1 * max(np.hypot(*place) - 2.5, 0.0) for other in others)


def _lies_on(line: FloatArray, segment: FloatArray) -> bool:
    """Whether a found line (2, 2) lies on a segment (2, 2): its ends within 0.1 m of it, and what a lean that is wrong
    by 0.7° makes of their range.
    """
    along = segment[1] - segment[0]
    length = float(np.hypot(*along))
    along = along / length
    offset = line - segment[0]
    aside = np.abs(offset[:, 0] * along[1] - offset[:, 1] * along[0])
    beyond = offset @ along
    slack = 0.1 + _LEAN_RAD * (line**2).sum(axis=1) / _HEIGHT_M
    return bool((aside <= slack).all() and (beyond >= -0.4).all() and (beyond <= length + 0.4).all())
