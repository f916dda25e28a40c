"""What speaks against a pose: none of this is in the papers, whose systems believe whatever fits best."""

from touchline.geometry import FloatArray, Pose
from touchline.localization.registration.covariance import is_observed
from touchline.published.nubot.failure import MAX_DEVIATION_M, SUSPECT_M, FailureSettings
from touchline.published.nubot.global_search import GlobalFix, GlobalSearch
from touchline.published.nubot.match_input import MatchInput
from touchline.published.nubot.matcher import POOR_ERROR, Match
from touchline.published.nubot.pose_filter import Fusion, PoseFilter, equal_error
from touchline.types import Problem, ProblemCode

# contradicted or poorly fitting frames in a row after which the whole field is searched for a better place, and again
# after as many more as in LOOK_EVERY: one alone is a shove or a robot in the way
LOOK_AFTER = 2
LOOK_EVERY = 3
HELD_FACTOR = (
    1.1  # mean error, of that of a pose that has held for several frames, up to which another place is as good
)
# frames in a row that support the prediction, after which places that fit as well say nothing against a pose: it is
# known by how the robot has come there
SUPPORTED_FRAMES = 5


def stands_alone(
    search: GlobalSearch, fix: GlobalFix | None, match: Match, covariance: FloatArray, held: bool = False
) -> bool:
    """Whether a match is the only pose that its points allow: observed, near the lines, on the field, without rivals.

    fix: of a search of the whole field with the same points; None if it has found nothing. covariance: (3, 3) of the
    pose. held: several frames have come to it, so that only a place that fits just as well is a rival.
    """
    fits = match.mean_distance_m <= MAX_DEVIATION_M and search.covers(match.pose) and is_observed(covariance)
    worst_error = HELD_FACTOR * match.error if held else None
    return fits and (fix is None or not fix.rivals(match.pose, match.error, worst_error))


class Doubt:
    """Judges a tracked pose in every frame. `reasons`: why this frame's pose is not believed."""

    def __init__(self, search: GlobalSearch, settings: FailureSettings) -> None:
        self.search = search
        self.settings = settings
        self.reset()

    def reset(self, held_error: float = 0.0) -> None:
        """The pose was found anew, or told. held_error: mean error of a match that was not accepted but has held."""
        self.reasons: tuple[Problem, ...] = ()
        self._poor = self._suspect = 0
        self._supported = 0 if held_error >= POOR_ERROR else SUPPORTED_FRAMES
        self._ambiguous = False

    def refutes(self, view: MatchInput, match: Match | None, tracked: PoseFilter, fusion: Fusion) -> bool:
        """Judge one frame: whether the robot stands elsewhere.

        match: of its points, None without usable ones. tracked: the pose after fusion.
        """
        s, agrees = self.settings, fusion is not Fusion.CONTRADICTS
        cluttered = match is not None and self._is_cluttered(view, match)
        fits = match is not None and (match.error < POOR_ERROR or cluttered)
        self._supported = self._supported + fits if fusion is Fusion.SUPPORTS else 0
        if not s.paper.doubts:
            return False
        far = match is not None and match.mean_distance_m > s.deviation_m and not cluttered
        poor = match is not None and (not agrees or far)
        self._poor = self._poor + 1 if poor else 0
        suspect = match is not None and match.mean_distance_m > SUSPECT_M
        self._suspect = self._suspect + 1 if suspect else 0
        self._ambiguous = self._ambiguous and (poor or suspect) and self._supported < SUPPORTED_FRAMES
        refuted = match is not None and self._look_is_due and self._looks(view, match, tracked.pose)
        self.reasons = self._found(None if cluttered else match, tracked, agrees)
        return refuted

    def _is_cluttered(self, view: MatchInput, match: Match) -> bool:
        """Whether a match is poor for clutter alone: legs, cables, chairs and nets may be three points in ten."""
        poor = match.error >= POOR_ERROR or match.mean_distance_m > min(self.settings.deviation_m, MAX_DEVIATION_M)
        return poor and self.search.matcher.is_cluttered(view.positions_m, view.weights, match.pose)

    @property
    def _look_is_due(self) -> bool:
        poor_for_long = self._poor >= LOOK_AFTER and (self._poor - LOOK_AFTER) % LOOK_EVERY == 0
        unproven = self._supported < SUPPORTED_FRAMES and 0 < self._suspect < self.settings.frames
        return poor_for_long or unproven or (self._suspect > 0 and self._suspect % self.settings.frames == 0)

    def _looks(self, view: MatchInput, match: Match, pose: Pose) -> bool:
        """Search the whole field: whether one other place alone explains the points far better."""
        fix = self.search.locate_any_heading(view.positions_m, view.weights, view.heading_rad)
        known = self._supported >= SUPPORTED_FRAMES
        if fix is None:
            self._ambiguous = not known
            return False
        error = self.search.matcher.error(view.positions_m, view.weights, pose.as_array())
        alone = stands_alone(self.search, fix, fix.match, fix.match.covariance)
        elsewhere = error > equal_error(fix.match.error)
        self._ambiguous = not known and ((elsewhere and not alone) or bool(fix.rivals(pose, error)))
        return elsewhere and alone

    def _found(self, match: Match | None, tracked: PoseFilter, agrees: bool) -> tuple[Problem, ...]:
        reasons = []
        if match is not None and match.mean_distance_m > MAX_DEVIATION_M:
            reasons.append(
                Problem(ProblemCode.POSE_OFF_LINES, f"the points lie {match.mean_distance_m:.2f} m from the lines")
            )
        if not agrees:
            reasons.append(Problem(ProblemCode.IMAGES_AGAINST_ODOMETRY, "the lines contradict the odometry"))
        if self._ambiguous:
            reasons.append(Problem(ProblemCode.POSE_AMBIGUOUS, "the points fit elsewhere as well"))
        if not is_observed(tracked.covariance):
            reasons.append(Problem(ProblemCode.POSE_OPEN, "no line fixes the pose"))
        if not self.search.covers(tracked.pose):
            reasons.append(Problem(ProblemCode.POSE_OFF_FIELD, "the pose is off the field"))
        return tuple(reasons)
