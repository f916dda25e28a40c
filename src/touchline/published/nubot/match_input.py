"""What travels through a step of NuBot's systems as one value: line points, weights, compass, the mirror's errors."""

from dataclasses import dataclass, replace

import numpy as np
from pydantic import Field

from touchline.camera import Camera
from touchline.config import Settings, added
from touchline.field import FieldModel
from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.localization.registration.covariance import MIN_RESIDUAL_M, is_observed
from touchline.localization.registration.learned_mirror import Expected, LearnedMirror
from touchline.localization.registration.weights import WeightSettings, precision_weights
from touchline.motion import MotionHistory
from touchline.published.nubot.compass_correction import CompassCorrection
from touchline.published.nubot.matcher import Match, Matcher
from touchline.types import LinePoints, Observation

MEDIAN_CHI2 = 0.455  # median of a squared normal deviate
REPEATED = 4.0  # so many points or images err together: neighbours on a line, a head that shakes
MAX_INFLATION = 40.0  # beyond it the points are none
MAX_ERROR = 0.1  # mean error of most points above which the lines are too uncertain to tell a tilt
MAX_POINTS = 0.75  # of the points, the nearest to lines, are those; the others may be nets, or lines of a field beside
SETTLED_M = 0.25  # distance to the line at which a point counts half in it: Lauer's c


class MirrorTiltPaper(Settings):
    """Switches to the papers' exact form."""

    enabled: bool = added(
        True,
        paper=False,
        description="estimate the tilt; without it, as in the papers, a mirror 0.2 degrees off costs 5 cm",
    )
    displacement: bool = added(
        True,
        paper=False,
        description="estimate the mirror's displacement and the scale of the ranges, too; without it a mirror 0.3 mm "
        "off costs 4 cm",
    )


class MirrorTiltSettings(Settings):
    """Which errors of the mirror are learned. None of this is in the papers."""

    height_m: float = Field(0.75, ge=0, description="height of the mirror (m): MSL robots may be 0.8 m high")
    paper: MirrorTiltPaper = MirrorTiltPaper()

    def mirror(self, field: FieldModel, camera: Camera | None) -> LearnedMirror:
        """What is learned of a camera's mirror."""
        paper = self.paper
        return LearnedMirror(field, camera, paper.enabled, (paper.displacement,) * 2, self.height_m)


@dataclass(frozen=True, eq=False, slots=True)
class MatchInput:
    """The line points of one frame with their weights (N,), which sum to 1, and the compass's reading.

    usable: whether the points are enough to be matched. compass_rad: heading in the field frame, uncorrected; None
    without a compass. tilt, correction: what has been learned of the mirror and of the compass. Both are read at every
    use: what a step learns holds for the rest of it.
    """

    points: LinePoints
    weights: FloatArray
    usable: bool
    compass_rad: float | None
    tilt: LearnedMirror
    correction: CompassCorrection

    @property
    def positions_m(self) -> FloatArray:
        """The points (N, 2) in the robot frame as an upright mirror would have seen them."""
        return self.tilt.corrected(self.points.positions_m)

    @property
    def heading_rad(self) -> float | None:
        """The corrected compass heading; None without a compass that is believed."""
        return (
            None if self.compass_rad is None or self.correction.doubted else self.correction.heading(self.compass_rad)
        )

    @property
    def heading_without_jump_rad(self) -> float | None:
        """What a compass says that is not believed as it has jumped, its jump taken off; None of any other."""
        return None if self.compass_rad is None else self.correction.without_jump(self.compass_rad)

    def heading_error_rad(self, heading_rad: float) -> float | None:
        """A heading minus the corrected compass; None without a compass."""
        return None if self.heading_rad is None else wrap_angle(heading_rad - self.heading_rad)

    def heading_is_plausible(self, heading_rad: float, max_error_rad: float) -> bool:
        """Whether a heading does not contradict the compass outright, as at the wrong end of a symmetric field."""
        error_rad = self.heading_error_rad(heading_rad)
        return error_rad is None or abs(error_rad) < max_error_rad


@dataclass(frozen=True, eq=False, slots=True)
class MatchInputs:
    """Makes the match input of each frame.

    tilt, correction: what the system learns of mirror and compass. min_points: without so many a frame is not usable.
    """

    history: MotionHistory
    tilt: LearnedMirror
    correction: CompassCorrection
    weights: WeightSettings
    min_points: int

    def of(self, observation: Observation) -> MatchInput:
        """That of what was seen."""
        points, compass_rad = observation.points, self.history.at(observation.stamp_ns).heading_rad
        weights, usable = precision_weights(points, self.weights), len(points) >= self.min_points
        return MatchInput(points, weights, usable, compass_rad, self.tilt, self.correction)


def refine_with_tilt(
    matcher: Matcher, view: MatchInput, pose: FloatArray, error: float, expected: Expected | None = None
) -> Match:
    """The match at a pose (3,) of this error, refined with this frame's own errors of the mirror taken out.

    expected: where the robot should be, if that is known. Where the errors can't be settled the match is that of their
    mean, and says so.
    """
    tilt, points = view.tilt, view.points
    fits = error < MAX_ERROR
    settled = not tilt.enabled
    # a camera whose ranges are wrong can look tilted: among points on no line only a known tilt is followed
    if tilt.enabled and (fits or tilt.settled):
        fit = tilt.fit_to(points, pose, expected)
        if fit is not None:
            positions_m = tilt.corrected(points.positions_m, fit.errors)
            refined_error = matcher.error(positions_m, view.weights, fit.pose)
            settled = _settles(tilt.field, positions_m, fit.pose)
            if settled and refined_error <= max(error, MAX_ERROR):
                match = matcher.assess(positions_m, view.weights, fit.pose, refined_error)
                if is_observed(match.covariance):
                    tilt.learn(fit)
                    return _inflated(matcher, view, positions_m, match)
                tilt.leave_open(fit)  # a lone line bends by a tilt as by a step aside and a turn
    match = matcher.assess(view.positions_m, view.weights, pose, error)
    return replace(_inflated(matcher, view, view.positions_m, match), settled=settled)


def _settles(field: FieldModel, positions_m: FloatArray, pose: FloatArray) -> bool:
    """Whether points (N, 2), robot frame, with their frame's errors taken out lie so near the lines at a pose (3,) that
    the errors are those of the mirror.
    """
    squares = np.square(field.line_distances(Pose(*pose.tolist()).transform(positions_m)))
    nearest = np.sort(squares)[: max(int(MAX_POINTS * len(squares)), 1)]
    return float(np.mean(nearest / (nearest + SETTLED_M**2))) < MAX_ERROR


def _inflated(matcher: Matcher, view: MatchInput, positions_m: FloatArray, match: Match) -> Match:
    """A match that is as unsure as its residuals are larger than the points' noise: a head that shakes, a poor camera.

    Their median, so that clutter says nothing.
    """
    if not matcher.settings.uncertainty.paper.residuals:
        return match
    distances_m, _ = matcher.distance_map.look_up(match.pose.transform(positions_m))
    covariances_m2 = view.points.covariances_m2
    variances_m2 = 0.5 * (covariances_m2[:, 0, 0] + covariances_m2[:, 1, 1]) + MIN_RESIDUAL_M**2
    ratios = np.sort(distances_m * distances_m / variances_m2)
    median = 0.5 * float(ratios[(len(ratios) - 1) // 2] + ratios[len(ratios) // 2])  # np.median takes ten times longer
    excess = median / MEDIAN_CHI2 - 1.0
    covariance = match.covariance + view.tilt.shaken
    return replace(match, covariance=covariance, inflation=1.0 + min(max(REPEATED * excess, 0.0), MAX_INFLATION))
