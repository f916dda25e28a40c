"""Judgement of the tracked pose in every frame (Xiong et al., section 4.2; Lu et al. 2013, section 4)."""

from __future__ import annotations

from touchline.geometry import Pose
from touchline.localization.published.nubot.failure import (
    MAX_DEVIATION_M,
    MAX_HEADING_ERROR_RAD,
    FailureDetector,
    FailureSettings,
)
from touchline.localization.published.nubot.global_search import GlobalSearch
from touchline.localization.published.nubot.match_input import MatchInput
from touchline.localization.published.nubot.matcher import Match
from touchline.localization.published.nubot.pose_filter import equal_error


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
