"""From an observation to the features that particles are weighed by, each with its noise and its confidence."""

import math
from collections.abc import Callable
from itertools import accumulate

import numpy as np
from pydantic import Field

from touchline.config import Settings, added
from touchline.field.association import Association, FieldAssociations
from touchline.geometry import FloatArray
from touchline.localization.registration.feature_model import FeatureView, LineFeatures, PointFeatures
from touchline.localization.registration.feature_noise import MIN_M, Noise, line_noise, point_noise
from touchline.types import Crossings, LandmarkKind, Landmarks, Lines, Observation

_POSTS = (LandmarkKind.POST.value, LandmarkKind.GOAL.value)
_MARKS = (LandmarkKind.PENALTY_MARK.value, LandmarkKind.CIRCLE.value)
MODEL_M = 0.03  # error of a feature's place on the field: paint, carpet, lens; added to covariances

NO_POINTS = PointFeatures(
    np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros(0),
    np.zeros((0, 4), np.int64), np.zeros(0), np.zeros(0, np.int64),
)  # fmt: skip
NO_LINES = LineFeatures(
    np.zeros((0, 2, 2)), np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros(0)
)  # fmt: skip
NOTHING = FeatureView(NO_POINTS, NO_LINES)


class FeatureKinds(Settings):
    """Which kinds of features count."""

    lines: bool = Field(True, description="straight lines, of at least the length that counts")
    crossings: bool = Field(True, description="L-, T- and X-crossings")
    posts: bool = Field(True, description="goal posts and the middles of goals")
    poles: bool = Field(True, description="poles beside the field")


class FeatureNoiseSettings(Settings):
    """The noise of observations, equations (5) and (6), and how far they are trusted, section 5.3."""

    sigma_d_m: float = Field(0.15, gt=0, description="σ_d of equation (5): of a range beside the robot (m)")
    sigma_l_m: float = Field(0.15, gt=0, description="σ_l of equation (6): of a line's distance beside the robot (m)")
    range_ratio: float = Field(
        0.1, ge=0, description="λ of equations (5) and (6): what a metre of range adds to them; roll and pitch err"
    )
    sigma_beta_rad: float = Field(0.1, gt=0, description="σ_β of equations (5) and (6): of bearings and directions")
    uniform_floor: float = Field(
        0.1, gt=0, lt=1, description="α_base of section 5.3: how likely an observation is none of the field's"
    )
    lean_rad: float = Field(
        0.006,
        ge=0,
        description="error of the camera's roll and pitch in one frame (rad), beside an observation's own covariance: "
        "a walking robot's IMU errs by 0.25°, and is late",
    )


class FeaturePaper(Settings):
    """Switches to the paper's exact form."""

    covariances: bool = added(
        True,
        paper=False,
        description="noise from the observations' own covariances and the lean's error; off is the paper's form: σ_d, "
        "σ_l, λ and σ_β for all, and lines by their perpendiculars (equations 5 to 7)",
    )
    oriented_t: bool = added(
        True,
        paper=False,
        description="T-crossings have four sets by orientation, as L-crossings; off is the paper's one set",
    )
    marks: bool = added(
        True, paper=False, description="penalty marks and the centre circle's middle; the paper names neither"
    )


class FeatureSettings(Settings):
    """Which features count, and how much."""

    use: FeatureKinds = FeatureKinds()
    noise: FeatureNoiseSettings = FeatureNoiseSettings()
    short_line_m: float = Field(0.5, ge=0, description="lines shorter than this are ignored beyond far_line_m (m)")
    far_line_m: float = Field(3.0, ge=0, description="range of a line's middle (m) from which short ones are ignored")
    paper: FeaturePaper = FeaturePaper()


class Features:
    """Takes observations for the particles of one field."""

    def __init__(
        self,
        associations: FieldAssociations,
        settings: FeatureSettings | None = None,
        height_m: float = 1.0,
        model_m: float = MODEL_M,
    ) -> None:
        """height_m: of the camera; an error of its lean moves the ground by so much, and more far away. model_m: error
        of a feature's place on the field.
        """
        self.associations = associations
        self.settings = settings or FeatureSettings()
        self.height_m = height_m
        n = self.settings.noise
        sigmas = (n.sigma_d_m, n.sigma_l_m, n.range_ratio, n.sigma_beta_rad)
        self._noise = Noise(*sigmas, n.uniform_floor, n.lean_rad, height_m, model_m, self.settings.paper.covariances)

    def of(self, seen: Observation, placed: Callable[[FloatArray], FloatArray] | None = None) -> FeatureView:
        """What counts of an observation. placed: ground points (N, 2) without the camera's errors that are known."""
        points, lines = NOTHING
        if len(seen.crossings) or len(seen.landmarks):
            positions = _positions(seen)
            positions = positions if placed is None else placed(positions)
            points = self._points(seen.crossings, seen.landmarks, positions)
        if len(seen.lines):
            ends = seen.lines.ends_m
            ends = ends if placed is None else placed(ends.reshape(-1, 2)).reshape(-1, 2, 2)
            lines = self._lines(seen.lines, ends)
        return FeatureView(points, lines)

    def points_of(self, seen: Observation) -> PointFeatures:
        """The crossings and landmarks of it alone."""
        if not len(seen.crossings) and not len(seen.landmarks):
            return NO_POINTS
        return self._points(seen.crossings, seen.landmarks, _positions(seen))

    def kinds_of(self, seen: Observation) -> list[str]:
        """What each of `points_of` is seen as, in words."""
        kinds = (*(f"{kind}-crossing" for kind in seen.crossings.kinds), *seen.landmarks.kinds)
        kept, _ = self._associations(seen.crossings, seen.landmarks)
        return [kinds[k].replace("_", " ") for k in kept]

    @property
    def tell_ends_apart(self) -> bool:
        """Whether colours that count distinguish the two ends of the field."""
        use = self.settings.use
        return self.associations.tells_ends_apart(
            (*(_POSTS if use.posts else ()), *((LandmarkKind.POLE.value,) if use.poles else ()))
        )

    def _points(self, crossings: Crossings, landmarks: Landmarks, positions: FloatArray) -> PointFeatures:
        kept, found = self._associations(crossings, landmarks)
        # of one layout, so that the loops are compiled once
        covariances = np.ascontiguousarray(np.concatenate((crossings.covariances_m2, landmarks.covariances_m2)))
        confidences = np.concatenate((crossings.confidences, landmarks.confidences))
        orientations = np.concatenate((crossings.orientations_rad, np.zeros(len(landmarks))))
        if len(kept) < len(positions):
            positions, covariances, confidences, orientations = (
                rows[kept] for rows in (positions, covariances, confidences, orientations)
            )
        information, own_information = np.empty(covariances.shape), np.empty(covariances.shape)
        sigmas, mixture = np.empty(positions.shape), np.empty((2, len(kept)))
        point_noise(positions, covariances, confidences, self._noise, information, own_information, sigmas, mixture)
        ends = list(accumulate((len(a.candidates) for a in found), initial=0))
        sets = [(a.table, a.sets, first, end) for a, first, end in zip(found, ends, ends[1:], strict=False)]
        return PointFeatures(
            positions,
            information,
            own_information,
            sigmas,
            mixture[0],
            mixture[1],
            confidences,
            np.array(sets, dtype=np.int64).reshape(-1, 4),
            orientations - np.array([a.turn_rad for a in found]),
            np.concatenate([NO_POINTS.candidates, *(a.candidates for a in found)]),
        )

    def _associations(self, crossings: Crossings, landmarks: Landmarks) -> tuple[list[int], list[Association]]:
        """Which of the crossings and landmarks, in this order, count, and what they may be."""
        use, kept, found = self.settings.use, [], []
        for i, kind in enumerate(crossings.kinds.tolist() if use.crossings else ()):
            oriented = math.isfinite(crossings.orientations_rad[i])
            oriented &= kind == "L" or self.settings.paper.oriented_t
            kept.append(i)
            found.append(self.associations.of_crossing(kind, oriented))
        for i, kind in enumerate(landmarks.kinds.tolist()):
            wanted = use.posts if kind in _POSTS else self.settings.paper.marks if kind in _MARKS else use.poles
            association = self.associations.of_landmark(kind, landmarks.colors[i])
            if wanted and len(association.candidates):
                kept.append(len(crossings) + i)
                found.append(association)
        return kept, found

    def _lines(self, lines: Lines, ends: FloatArray) -> LineFeatures:
        s = self.settings
        along, middles = ends[:, 1] - ends[:, 0], 0.5 * (ends[:, 0] + ends[:, 1])
        length = np.hypot(along[:, 0], along[:, 1])
        kept = np.full(len(lines), s.use.lines) & (length > MIN_M)
        kept &= (length >= s.short_line_m) | (np.hypot(middles[:, 0], middles[:, 1]) < s.far_line_m)
        ends, trust = ends[kept], lines.confidences[kept]
        covariances = np.ascontiguousarray(lines.covariances_m2[kept])  # one type for the compiled loop
        sigmas, own, mixture = np.empty((len(ends), 2)), np.empty((len(ends), 2)), np.empty((2, len(ends)))
        line_noise(ends, covariances, trust, self._noise, sigmas, own, mixture)
        return LineFeatures(ends, sigmas, own, mixture[0], mixture[1], trust)


def _positions(seen: Observation) -> FloatArray:
    """(M, 2) of crossings and landmarks, in C order."""
    return np.concatenate((seen.crossings.positions_m, seen.landmarks.positions_m))


def lean_jacobians(points: FloatArray, height_m: float) -> FloatArray:
    """(..., 2, 2): by how much ground points (..., 2), robot frame, move per rad of roll and of pitch that the camera
    leans more than it is thought to.
    """
    x, y = points[..., 0], points[..., 1]
    by_roll = np.stack((-x * y / height_m, -height_m - y * y / height_m), axis=-1)
    by_pitch = np.stack((height_m + x * x / height_m, x * y / height_m), axis=-1)
    return np.stack((by_roll, by_pitch), axis=-1)


def levelled(ground: FloatArray, height_m: float, lean: FloatArray) -> FloatArray:
    """Ground points (..., 2) without roll and pitch (2,) that the camera is known to lack (rad), to first order."""
    return ground - lean_jacobians(ground, height_m) @ lean
