"""Detection of wrong localization, judged in every frame (Xiong et al., section 4.2; Lu et al. 2013, section 4)."""

from pydantic import Field

from touchline.config import Settings, added
from touchline.geometry import Pose
from touchline.localization.estimator.monitor import monitored
from touchline.published.nubot.global_search import GlobalSearch
from touchline.published.nubot.match_input import MatchInput
from touchline.published.nubot.matcher import Match
from touchline.published.nubot.pose_filter import equal_error

MAX_DEVIATION_M = 0.35  # mean distance that makes a frame bad whatever the compass says
# mean distance from which a frame is suspect: look-alike places leave 0.15 to 0.35, but clutter about a right pose up
# to 0.25, so suspicion alone is no failure
SUSPECT_M = 0.12
# suspect frames in a row after which the whole field is searched for a place that explains the points far better; only
# such a one means failure. Again after as many more
SUSPECT_FRAMES = 5
# difference between heading and compass that makes a frame bad however well the lines fit: at the other end of a
# symmetric field they fit perfectly, half a turn off
MAX_HEADING_ERROR_RAD = 1.6
# frames without usable points in a row that mean failure by themselves: whoever was covered may have been carried, and
# looking once over the whole field costs a millisecond
BLIND_FRAMES = 2
# time without odometry between two frames beyond which they mean failure by themselves: a robot may be a metre from
# where it was by then, where matching settles anywhere
MAX_MISSING_S = 1.0


class FailurePaper(Settings):
    """Switches to the paper's exact form."""

    single_criterion_failure: bool = added(
        True,
        paper=False,
        description="let a large mean distance, a heading far from the compass, frames without usable points or "
        "odometry count as bad by themselves, and a start pose be refuted by one bad frame: a robot put down elsewhere "
        "with nearly its old heading never trips the papers' rule",
    )
    doubt: bool = added(
        True,
        paper=False,
        description="believe a pose only if lines fix it, its points lie near them, no other place explains them as "
        "well and it agrees with the odometry; without it whatever fits best is called tracking, scatter, too",
    )

    monitor: bool = monitored()

    @property
    def doubts(self) -> bool:
        """Whether more than the papers' own rule speaks against a pose."""
        return self.doubt and self.single_criterion_failure


class FailureSettings(Settings):
    """When the pose is believed to be wrong. The papers name the rule and five frames, but no thresholds."""

    deviation_m: float = Field(
        0.25,
        gt=0,
        description="mean distance of the points to the lines (m) from which a frame may be bad; a right pose has 0.03 "
        "to 0.1, a wrong one mostly 0.3 and more",
    )
    heading_rad: float = Field(
        0.35,
        gt=0,
        description="difference between heading and compass (rad) which, together with deviation_m, makes a frame bad; "
        "well above the usual compass error of up to 0.2",
    )
    frames: int = Field(
        5, ge=1, le=1_000, description="bad frames in a row that mean failure: the five cycles of Lu et al. 2013"
    )
    min_points: int = Field(
        10, ge=1, le=10_000_000, description="points without which a frame is not usable: fewer fit anywhere"
    )
    paper: FailurePaper = FailurePaper()


class FailureDetector:
    """Counts bad, blind and suspect frames in a row."""

    def __init__(self, settings: FailureSettings | None = None) -> None:
        self.settings = settings or FailureSettings()
        self.bad_frames = self.blind_frames = self.suspect_frames = 0

    def update(
        self,
        points: int,
        mean_distance_m: float,
        heading_error_rad: float | None,
        missing_s: float = 0.0,
        cluttered: bool = False,
    ) -> bool:
        """Judge one frame; True once the localization has failed.

        points: number of line points; mean_distance_m: of the match (ignored without usable points);
        heading_error_rad: heading minus corrected compass, None without a compass; missing_s: time since the frame
        before that no odometry covers (s). cluttered: most points lie on lines, so that the mean is the others'.
        """
        s = self.settings
        bad = self.is_bad(points, mean_distance_m, heading_error_rad, cluttered)
        self.bad_frames = self.bad_frames + 1 if bad else 0
        blind = points < s.min_points
        self.blind_frames = self.blind_frames + 1 if blind else 0
        self.suspect_frames = self.suspect_frames + 1 if not blind and mean_distance_m > SUSPECT_M else 0
        away = self.blind_frames >= BLIND_FRAMES or missing_s > MAX_MISSING_S
        return (s.paper.single_criterion_failure and away) or self.bad_frames >= s.frames

    @property
    def suspicious(self) -> bool:
        """Whether it is time to look for a better place, though the frames so far mean no failure."""
        due = self.suspect_frames > 0 and self.suspect_frames % SUSPECT_FRAMES == 0
        return self.settings.paper.single_criterion_failure and due

    def is_bad(
        self, points: int, mean_distance_m: float, heading_error_rad: float | None, cluttered: bool = False
    ) -> bool:
        """Whether this frame alone speaks against the pose; arguments as for `update`."""
        s = self.settings
        if points < s.min_points:
            return s.paper.single_criterion_failure
        heading_inconsistent = heading_error_rad is not None and abs(heading_error_rad) > s.heading_rad
        turned = heading_error_rad is not None and abs(heading_error_rad) > MAX_HEADING_ERROR_RAD
        far_off = s.paper.single_criterion_failure and ((mean_distance_m > MAX_DEVIATION_M and not cluttered) or turned)
        return far_off or (mean_distance_m > s.deviation_m and heading_inconsistent)

    def reset(self) -> None:
        """Start counting anew, after the robot was localized again."""
        self.bad_frames = self.blind_frames = self.suspect_frames = 0


class FailureMonitor:
    """The papers' rule of bad frames in a row, and a second opinion from a search of the whole field.

    `failures`: how often the pose was believed wrong. `start_pose_unconfirmed`: a person has told the pose, and no
    match has confirmed it yet.
    """

    def __init__(
        self,
        search: GlobalSearch,
        settings: FailureSettings,
        keep_unless_better: bool = False,
    ) -> None:
        """keep_unless_better: bad frames mean failure only if another place explains the points far better."""
        self.search = search
        self.settings = settings
        self.keep_unless_better = keep_unless_better
        self.detector = FailureDetector(settings)
        self.reset()

    def reset(self, start_pose_unconfirmed: bool = False) -> None:
        """Forget everything; start_pose_unconfirmed: the first bad frame is enough then."""
        self.failures = 0
        self.start_pose_unconfirmed = start_pose_unconfirmed
        self.count_anew()

    def count_anew(self) -> None:
        """The robot was found again."""
        self.detector.reset()

    def has_failed(self, view: MatchInput, match: Match | None, pose: Pose, missing_s: float) -> bool:
        """Judge one frame: whether the pose is believed wrong from now on.

        match: of the points, None without usable ones. pose: fused; a match that was turned to the compass but not
        believed would hide the contradiction. missing_s: time since the frame before that no odometry covers.
        """
        failed = self._is_bad_for_long(view, match, pose, missing_s)
        if failed and self.keep_unless_better and match is not None:
            plausible = view.heading_is_plausible(pose.heading, MAX_HEADING_ERROR_RAD)
            failed = not plausible or self._fits_elsewhere(view, match)
        doubted = self.start_pose_unconfirmed and self.settings.paper.single_criterion_failure
        failed = failed or (doubted and self.detector.bad_frames > 0)
        self.start_pose_unconfirmed = self.start_pose_unconfirmed and match is None
        self.failures += failed
        return failed

    def _is_bad_for_long(self, view: MatchInput, match: Match | None, pose: Pose, missing_s: float) -> bool:
        """Mean deviation, and heading against the compass, for several frames in a row."""
        if match is None:
            return self.detector.update(len(view.points), float("inf"), None, missing_s)
        error_rad = view.heading_error_rad(pose.heading)
        far = match.mean_distance_m > MAX_DEVIATION_M
        cluttered = far and self.search.matcher.is_cluttered(view.positions_m, view.weights, match.pose)
        failed = self.detector.update(len(view.points), match.mean_distance_m, error_rad, missing_s, cluttered)
        return failed or (self.detector.suspicious and self._fits_elsewhere(view, match))

    def _fits_elsewhere(self, view: MatchInput, match: Match) -> bool:
        """Whether some other place explains the points far better than this match; the papers have no such test."""
        fix = self.search.locate_any_heading(view.positions_m, view.weights, view.heading_rad)
        return fix is not None and match.error > equal_error(fix.match.error)
