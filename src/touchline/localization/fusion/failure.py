"""Detection of wrong localization (Xiong et al., section 4.2; Lu et al. 2013, section 4)."""

from __future__ import annotations

from pydantic import Field

from touchline.config import Settings


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
    frames: int = Field(5, ge=1, description="bad frames in a row that mean failure: the five cycles of Lu et al. 2013")
    lone_rules: bool = Field(
        True,
        description="let lone_deviation_m, lone_heading_rad and frames without usable points count as bad by "
        "themselves: a robot put down elsewhere with nearly its old heading never trips the paper's rule",
    )
    lone_deviation_m: float = Field(
        0.35, gt=0, description="mean distance (m) that makes a frame bad whatever the compass says"
    )
    suspect_m: float = Field(
        0.12,
        gt=0,
        description="mean distance (m) from which a frame is suspect: look-alike places leave 0.15 to 0.35, but "
        "clutter about a right pose up to 0.25, so suspicion alone is no failure: see suspect_frames",
    )
    suspect_frames: int = Field(
        5,
        ge=1,
        description="suspect frames in a row after which (with lone_rules) the whole field is searched for a place "
        "that explains the points far better; only such a one means failure. Again after as many more",
    )
    lone_heading_rad: float = Field(
        1.6,
        gt=0,
        description="difference between heading and compass (rad) that makes a frame bad however well the lines fit, "
        "with lone_rules: at the other end of a symmetric field they fit perfectly, half a turn off",
    )
    blind_frames: int = Field(
        2,
        ge=1,
        description="frames without usable points in a row that mean failure by themselves (with lone_rules): whoever "
        "was covered may have been carried, and looking once over the whole field costs a millisecond",
    )
    most_missing_s: float = Field(
        1.0,
        gt=0,
        description="time without odometry between two frames (s) beyond which they mean failure by themselves (with "
        "lone_rules): a robot may be a metre from where it was by then, where matching settles anywhere",
    )
    least_points: int = Field(10, ge=1, description="points without which a frame is not usable: fewer fit anywhere")


class FailureDetector:
    """Counts bad, blind and suspect frames in a row."""

    def __init__(self, settings: FailureSettings | None = None) -> None:
        self.settings = settings or FailureSettings()
        self.bad_frames = self.blind_frames = self.suspect_frames = 0

    def update(
        self, points: int, mean_distance_m: float, heading_error_rad: float | None, missing_s: float = 0.0
    ) -> bool:
        """Judge one frame; True once the localization has failed.

        points: number of line points; mean_distance_m: of the match (ignored without usable points);
        heading_error_rad: heading minus corrected compass, None without a compass; missing_s: time since the frame
        before that no odometry covers (s).
        """
        s = self.settings
        self.bad_frames = self.bad_frames + 1 if self.is_bad(points, mean_distance_m, heading_error_rad) else 0
        blind = points < s.least_points
        self.blind_frames = self.blind_frames + 1 if blind else 0
        self.suspect_frames = self.suspect_frames + 1 if not blind and mean_distance_m > s.suspect_m else 0
        away = self.blind_frames >= s.blind_frames or missing_s > s.most_missing_s
        return (s.lone_rules and away) or self.bad_frames >= s.frames

    @property
    def suspicious(self) -> bool:
        """Whether it is time to look for a better place, though the frames so far mean no failure."""
        s = self.settings
        return s.lone_rules and self.suspect_frames > 0 and self.suspect_frames % s.suspect_frames == 0

    def is_bad(self, points: int, mean_distance_m: float, heading_error_rad: float | None) -> bool:
        """Whether this frame alone speaks against the pose; arguments as for `update`."""
        s = self.settings
        if points < s.least_points:
            return s.lone_rules
        heading_inconsistent = heading_error_rad is not None and abs(heading_error_rad) > s.heading_rad
        turned = heading_error_rad is not None and abs(heading_error_rad) > s.lone_heading_rad
        far_off = s.lone_rules and (mean_distance_m > s.lone_deviation_m or turned)
        return far_off or (mean_distance_m > s.deviation_m and heading_inconsistent)

    def reset(self) -> None:
        """Start counting anew, after the robot was localized again."""
        self.bad_frames = self.blind_frames = self.suspect_frames = 0
