"""`touchline calibrate lines`: from line points, or images, and the field's name to a camera."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from touchline.calibration.lines.certainty import Alone, Certainty, certainty_of, each_alone
from touchline.calibration.lines.equations import WIDTHS, Lines, Seen
from touchline.calibration.lines.joint import JointFit, expected_mirror, fit_in_steps, linearise, starting
from touchline.calibration.lines.mirror_shape import MirrorShape
from touchline.calibration.lines.range_curve import KNOTS, fit_curve, held_upright
from touchline.calibration.lines.search import CENTER_PX, Candidate, find_candidates
from touchline.errors import NoFitError
from touchline.field import FieldModel
from touchline.geometry import BoolArray, FloatArray, Pose

MIN_POINTS = 25
MIN_ON_LINES = 0.85  # share of the points on the field that must lie on lines
MIN_LINES_SEEN = 0.7  # of an image: share of the lines within reach along which points must be seen
MIN_LEAD = 0.05  # by which the best mirror's error must be below another's
MAX_CENTER_PX, MAX_RANGE_RATIO = 2.0, 0.03  # largest standard deviations of what is written
_WHERE = np.arange(5.0, 100.0, 5.0)  # percentiles of the points' radii
_MARK_M = 0.1  # how far beside a penalty mark a point on it may seem to lie
_BESIDE_M = 0.3  # beside the field, where no line point can be
_ASIDE_M = 0.2  # a line that lies so far from where the field has it is another
_GAP_M, _GAP_RATIO = 0.15, 0.1  # between points along a line that is seen: rays 5 degrees apart
_SPOT_M = 0.02  # poses of a robot that turned on the spot agree to this
_MAX_ORIGIN_M = 0.15
_MAP_M, _BEYOND_M = 0.05, 3.0
_ONE_ROBOT = "Are all images of one robot, its mirror not touched meanwhile? Calibrate each robot by its own images"
_FEW, _FEW_POINTS = 0.4, 60  # of the images' median, or in all: with fewer an image may just be badly lit
_BADLY_SEEN = "It shows few line points: bad light, or a view that is not free, is likelier. Leave it out or retake it"


@dataclass(frozen=True, eq=False)
class LineCalibration:
    """A calibrated mirror: its shape, how sure it is, and for each image the pose, the points (N, 2) u, v and a fit.

    first_px, last_px: radii between which points lie on lines; lead: by how much the next different mirror is worse.
    on_lines: share of the points on the field that lie on lines; lines_seen: share of the lines between the first and
    the last range along which points were seen from any place.
    spot_m: how far the poses differ from a turn on the spot, or None. alone: what each of several images alone would
    have otherwise. tangent: the fit before the spline.
    """

    shape: MirrorShape
    certainty: Certainty
    poses: tuple[Pose, ...]
    pixels: tuple[FloatArray, ...]
    first_px: float
    last_px: float
    lead: float
    on_lines: float
    lines_seen: float
    spot_m: float | None
    alone: tuple[Alone, ...]
    tangent: JointFit

    @property
    def range_ratio(self) -> float:
        """Standard deviation of the ranges, as a share of them, where the points lie: the root of its mean square."""
        radii = np.concatenate([np.hypot(*(one - self.shape.center).T) for one in self.pixels])
        where = np.percentile(radii[self.certainty.residuals < WIDTHS[-1]], _WHERE)
        return float(np.sqrt(np.mean(self.certainty.range_ratio(self.shape, where) ** 2)))


def calibrate_points(
    pixels: Sequence[FloatArray],
    center: FloatArray,
    radius_px: float,
    field: FieldModel,
    handedness: int = 1,
    seed: int = 0,
) -> LineCalibration:
    """Calibrate from line points: pixels (N, 2) u, v of each image, N >= 1; center (2,), radius_px: about the mirror's.

    Raises NoFitError where the points don't tell, with the reason.
    """
    count = sum(len(one) for one in pixels)
    if count < MIN_POINTS:
        raise NoFitError(f"{count} line points are too few for a calibration; {MIN_POINTS} are needed, better 200")
    rng = np.random.default_rng(seed)
    seen = [Seen(np.ascontiguousarray(one), float(handedness), radius_px / KNOTS) for one in pixels]
    search = Lines(False, field.distance_map(_MAP_M, _BEYOND_M).table, field.line_tables)
    candidates = find_candidates(seen, center, field, search, rng)
    lead = candidates[1].error - candidates[0].error if len(candidates) > 1 else 1.0
    return refined(candidates[0], lead, seen, center, radius_px, field)


def refined_again(
    calibration: LineCalibration,
    pixels: Sequence[FloatArray],
    center: FloatArray,
    radius_px: float,
    field: FieldModel,
) -> LineCalibration:
    """The calibration with other line points of the same images, found with its own camera."""
    hand, knot_px = float(calibration.shape.handedness), calibration.shape.knot_px
    seen = [Seen(np.ascontiguousarray(one), hand, knot_px) for one in pixels]
    tangent = calibration.tangent
    start = Candidate(tangent.mirror, tangent.poses, tangent.error)
    return refined(start, calibration.lead, seen, center, radius_px, field)


def refined(
    start: Candidate, lead: float, seen: Sequence[Seen], center: FloatArray, radius_px: float, field: FieldModel
) -> LineCalibration:
    """The calibration that a candidate becomes with all points, bend and curve. Raises NoFitError as above."""
    lines = Lines(True, field.distance_map(_MAP_M, _BEYOND_M).table, field.line_tables)
    turned = field.line_distances(-np.concatenate(field.polylines(0.2)))
    begin = one_half(start.poses) if turned.max() < 0.5 * field.line_width else start.poses
    expected = expected_mirror(center, CENTER_PX * radius_px, bends=False)
    level = fit_in_steps(seen, starting(start.mirror, begin, lines), expected, lines)
    expected = expected_mirror(center, CENTER_PX * radius_px, bends=True)
    tangent = fit_in_steps(seen, level, expected, lines)
    seen = _without_marks(seen, tangent, lines, field)
    drawn_m = field.line_width / math.sqrt(12.0)  # anywhere between the lines' edges
    found = fit_curve(seen, tangent, expected, lines, drawn_m)
    fit, upright = found.fit, held_upright(found, level, seen, lines)
    certainty = certainty_of(found, seen, lines)
    certainty = certainty._replace(center_px=certainty_of(upright, seen, lines).center_px)
    moved = np.abs(fit.aside_m[linearise(seen, fit, lines).line]) > _ASIDE_M
    origin, spot_m = turning_axis(fit.poses)
    shape = MirrorShape(fit.mirror, int(seen[0].handedness), seen[0].knot_px, origin, upright.fit.mirror[:2])
    good = certainty.residuals < WIDTHS[-1]
    radii = np.concatenate([np.hypot(*(one.pixels - shape.center).T) for one in seen])[good]
    first, last = np.percentile(radii, [1.0, 99.0]) if len(radii) else (0.0, 0.0)
    poses = tuple(_moved(pose, origin) for pose in fit.poses)
    pixels = tuple(one.pixels for one in seen)
    reach_m = shape.range_m(np.array([first, last]))
    on_field = [pose.transform(shape.ground(one)) for pose, one in zip(poses, pixels, strict=True)]
    inside = np.all(np.abs(np.concatenate(on_field)) < 0.5 * np.array([field.length, field.width]) + _BESIDE_M, axis=1)
    on_lines = float(np.mean((good & ~moved)[inside])) if inside.any() else 0.0
    lines_seen = _lines_seen(on_field, good, poses, reach_m, field)
    alone = each_alone(found, seen, lines)
    return LineCalibration(
        shape, certainty, poses, pixels, float(first), float(last), lead, on_lines, lines_seen, spot_m, alone, tangent
    )


def _without_marks(seen: Sequence[Seen], fit: JointFit, lines: Lines, field: FieldModel) -> list[Seen]:
    """The points without those on penalty marks, which are as white as lines and lie on none."""
    points = linearise(seen, fit, lines)
    gaps = np.hypot(*np.moveaxis(points.places[:, np.newaxis] - field.discs[:, :2], -1, 0)) - 0.5 * field.discs[:, 2]
    on_mark = np.any(gaps < _MARK_M, axis=1) & (np.abs(points.residuals) > WIDTHS[-1])
    kept = np.split(~on_mark, np.cumsum([len(one.pixels) for one in seen])[:-1])
    return [one._replace(pixels=one.pixels[good]) for one, good in zip(seen, kept, strict=True)]


def check(calibration: LineCalibration, whole_view: bool = False) -> None:
    """Raises NoFitError with the reason where a calibration is none. whole_view: whether all lines should be seen."""
    on_lines, lead = calibration.on_lines, calibration.lead
    if on_lines < MIN_ON_LINES:
        raise NoFitError(
            f"no mirror puts the points on this field's lines: {100 * on_lines:.0f} % of those on it lie on them, "
            f"{100 * MIN_ON_LINES:.0f} % are needed. Is it the right field? Are most of the points line points?"
            f"{' Are all images of one robot?' if calibration.alone else ''}"
        )
    for number, (one, points) in enumerate(zip(calibration.alone, calibration.pixels, strict=False), start=1):
        if one.is_another:
            few = len(points) < max(_FEW * np.median([len(each) for each in calibration.pixels]), _FEW_POINTS)
            raise NoFitError(f"image {number} ({len(points)} points) {one}. {_BADLY_SEEN if few else _ONE_ROBOT}")
    if whole_view and calibration.lines_seen < MIN_LINES_SEEN:
        raise NoFitError(
            f"only {100 * calibration.lines_seen:.0f} % of the lines that should be in view are seen with the best "
            "mirror. Is it the right field? Is the view free, is there light enough?"
        )
    if lead < MIN_LEAD:
        raise NoFitError(
            "two different mirrors explain the points about as well: more lines must be in view. Take several images, "
            "best while the robot turns on the spot where it sees the centre circle or a penalty area"
        )
    center = float(np.max(calibration.certainty.center_px))
    if center > MAX_CENTER_PX:
        raise NoFitError(
            f"the lines leave the mirror's centre uncertain by ± {center:.1f} px: take several images, best while the "
            "robot turns on the spot"
        )
    if not (ratio := calibration.range_ratio) <= MAX_RANGE_RATIO:  # nan is none
        how = f"uncertain by ± {100 * ratio:.0f} %" if ratio < 1.0 else "unknown"
        raise NoFitError(f"the lines leave ranges {how}: more lines must be in view")


def _lines_seen(
    on_field: Sequence[FloatArray],
    good: BoolArray,
    poses: Sequence[Pose],
    reach_m: FloatArray,
    field: FieldModel,
) -> float:
    """Share of the field's lines within reach of the poses along which points (N, 2) of the images lie."""
    samples = np.concatenate(field.polylines(0.2))
    due, met = np.zeros(len(samples), dtype=np.bool_), np.zeros(len(samples), dtype=np.bool_)
    starts = np.cumsum([0, *[len(one) for one in on_field]])
    for pose, points, start in zip(poses, on_field, starts, strict=False):
        ranges = np.hypot(samples[:, 0] - pose.x, samples[:, 1] - pose.y)
        near = (ranges > reach_m[0]) & (ranges < 0.8 * reach_m[1] + 0.2 * reach_m[0])
        due |= near
        kept = points[good[start : start + len(points)]]
        if len(kept):
            gaps = np.hypot(*np.moveaxis(samples[:, np.newaxis] - kept, -1, 0)).min(axis=1)
            met |= near & (gaps < _GAP_M + _GAP_RATIO * ranges)
    return float(met[due].mean()) if due.any() else 0.0


def one_half(poses: FloatArray) -> FloatArray:
    """Poses (M, 3) on a field that looks the same after half a turn, each or its twin: what is nearest to the first."""
    turned = np.column_stack((-poses[:, :2], poses[:, 2] + np.pi))
    gaps = [np.hypot(*(some[:, :2] - poses[0, :2]).T) for some in (poses, turned)]
    return np.where((gaps[0] <= gaps[1])[:, np.newaxis], poses, turned)


def turning_axis(poses: FloatArray) -> tuple[FloatArray, float | None]:
    """Where the axis lies from the mirror's origin (2,), in its frame, about which a robot turned on the spot, from

    poses (M, 3), and how far they differ from that (m); zeros and None for a robot that did not.
    """
    if len(poses) < 3:
        return np.zeros(2), None
    rows, values = [], []
    for x, y, heading in poses:
        c, s = np.cos(heading), np.sin(heading)
        rows += [[1.0, 0.0, -c, s], [0.0, 1.0, -s, -c]]
        values += [x, y]
    matrix, vector = np.array(rows), np.array(values)
    solution, _, rank, singular = np.linalg.lstsq(matrix, vector, rcond=None)
    off = float(np.sqrt(np.mean((matrix @ solution - vector) ** 2)))
    determined = rank == 4 and singular[-1] > 0.5 and off < _SPOT_M and np.hypot(*solution[2:]) < _MAX_ORIGIN_M
    return (solution[2:], off) if determined else (np.zeros(2), None)


def _moved(pose: FloatArray, origin: FloatArray) -> Pose:
    """The robot's pose, from that of the mirror's origin (3,)."""
    x, y, heading = (float(value) for value in pose)
    c, s = np.cos(heading), np.sin(heading)
    return Pose(x + c * origin[0] - s * origin[1], y + s * origin[0] + c * origin[1], heading)
