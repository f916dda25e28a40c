"""Correction of the compass by the heading that the lines gave (Xiong et al., section 4.2)."""

import math

from pydantic import Field

from touchline.config import Settings, added
from touchline.geometry import wrap_angle
from touchline.published.nubot.matcher import POOR_ERROR, Match
from touchline.types import Problem, ProblemCode

# mean distance of the points to the lines below which a frame is good; a right pose has 0.03 to 0.1
GOOD_DEVIATION_M = 0.12
GOOD_FRAMES = 5  # good frames in a row before the compass is corrected, as many as mean failure
# difference that can't be the compass's error, so that nothing is learned from it: twice the worst of usual errors, as
# global_search.heading_tolerance_rad; half a turn means the wrong end of the field
MAX_CORRECTION_RAD = 0.6
MAX_OFFSET_RAD = 0.6  # bound of what is learned in total, for the same reason: it must not creep to another heading
# frames in which compass and lines agreed since the robot was found, after which a contradiction is the compass's fault
TRUSTED_FRAMES = 10
CONTRADICTIONS = 3  # contradictions in a row that mean a fault: fewer than what means failure of the pose
# difference up to which a compass in doubt agrees with the lines again, and frames in a row of that: usual errors, and
# long enough that one that sticks does not pass for right while the robot turns through its heading
AGREEING_RAD = 0.35
AGREEING_FRAMES = 10
# frames in which a compass in doubt kept its difference from the lines, after which that is its error: it has jumped
STEADY_FRAMES = 15
# difference from which a compass speaks for the other end of a symmetric field
OTHER_END_RAD = 0.5 * math.pi
# frames of contradiction after which a compass that contradicts since the robot was moved is believed after all: 20 s
PATIENCE_FRAMES = 200


class CompassPaper(Settings):
    """Switches to the paper's exact form."""

    bounded: bool = added(
        True,
        paper=False,
        description="nothing is learned from a difference of more than 0.6 rad, as at the other end of the field; "
        "false as in the paper: from any, and without bound in total",
    )
    may_fail: bool = added(
        True,
        paper=False,
        description="doubt a compass that contradicts lines and odometry after it had agreed with them, instead of the "
        "pose; false: a compass that jumps by half a turn takes the robot to the other end of the field",
    )


class CompassSettings(Settings):
    """When and how fast the compass is corrected. The paper says: after several good frames."""

    gain: float = Field(
        0.2,
        gt=0,
        le=1,
        description="share of the difference that a frame corrects; averages over the compass noise of half a degree, "
        "yet follows a drift within a second",
    )
    paper: CompassPaper = CompassPaper()


class CompassCorrection:
    """The offset that makes the compass agree with the lines, and whether the compass is to be believed at all.

    The compass is a witness among others. Where the lines fit at the pose that the odometry predicts, and compass and
    lines had agreed before, a compass that contradicts them has failed: `doubted`. It is asked again once it agrees.

    Where the odometry felt nothing of a move in the very frame in which the compass turned round, the robot may have
    been carried to the other end: the lines alone can't tell that from a compass that failed during a shove.
    """

    def __init__(self, settings: CompassSettings | None = None) -> None:
        self.settings = settings or CompassSettings()
        self.reset()

    def reset(self) -> None:
        """Take the compass as it is, until the lines say otherwise."""
        self.offset_rad = 0.0
        self.doubted = False
        self.good_frames = self._agreed = self._contradicted = self._agreeing = self._steady = 0
        self._moved = self._moved_since = self._unsettled = self._had_contradicted = False
        self._moved_frames = 0
        self._fault_rad = 0.0

    def heading(self, compass_rad: float) -> float:
        """The corrected compass heading (rad)."""
        return wrap_angle(compass_rad + self.offset_rad)

    @property
    def doubts(self) -> tuple[Problem, ...]:
        """Why the compass is not believed, if it is not."""
        if self.doubted:
            off_deg = math.degrees(abs(self._fault_rad))
            sentence = f"the compass contradicts lines and odometry by {off_deg:.0f} degrees"
        elif self._unsettled:
            sentence = "the compass had failed as the robot was lost"
        else:
            return ()
        return (Problem(ProblemCode.COMPASS_WRONG, sentence),)

    @property
    def either_end(self) -> tuple[Problem, ...]:
        """Why the end of the field is unknown, if it is."""
        if not (self.doubted and self._moved):
            return ()
        return (Problem(ProblemCode.COMPASS_TURNED, "the robot was moved as the compass turned round"),)

    def update(
        self,
        mean_distance_m: float,
        heading_rad: float,
        compass_rad: float,
        error: float = math.inf,
        moved: bool = False,
    ) -> bool:
        """Learn from one match and the compass's own reading at its time; whether the offset was corrected.

        error: the match's mean error, which clutter does not raise as it does the mean distance. moved: the robot was,
        since the last frame, and the odometry felt nothing of it.
        """
        self._moved_since |= moved
        difference = wrap_angle(heading_rad - self.heading(compass_rad))
        plausible = abs(difference) < MAX_CORRECTION_RAD
        fits, believable = mean_distance_m < GOOD_DEVIATION_M, plausible or not self.settings.paper.bounded
        if self.settings.paper.may_fail and (fits or error < POOR_ERROR):
            self._judge(difference, plausible)
        self.good_frames = self.good_frames + 1 if fits and believable else 0
        if self.doubted or self.good_frames < GOOD_FRAMES:
            return False
        bound_rad = MAX_OFFSET_RAD if self.settings.paper.bounded else math.pi
        offset_rad = wrap_angle(self.offset_rad + self.settings.gain * difference)
        self.offset_rad = min(max(offset_rad, -bound_rad), bound_rad)
        return True

    def _judge(self, difference_rad: float, plausible: bool) -> None:
        """Whether a compass that differs so much from the lines is to be believed."""
        if self.doubted:
            self._agreeing = self._agreeing + 1 if abs(difference_rad) < AGREEING_RAD else 0
            kept = abs(wrap_angle(difference_rad - self._fault_rad)) < AGREEING_RAD
            self._steady = self._steady + 1 if kept else 0
            self._fault_rad = difference_rad
            self.doubted = self._agreeing < AGREEING_FRAMES
            self._had_contradicted |= self._steady >= STEADY_FRAMES and abs(difference_rad) > OTHER_END_RAD
            self._unsettled &= self.doubted or not self._had_contradicted
            self._moved_frames += self._moved
            if self._moved_frames > PATIENCE_FRAMES:
                self.lose()
                self._unsettled = False
            return
        if self._contradicted == 0:
            self._moved = self._moved_since and abs(difference_rad) > OTHER_END_RAD
            self._moved_frames = 0
        self._moved_since = False
        self._contradicted = 0 if plausible else self._contradicted + 1
        self._agreed += plausible
        self._unsettled &= self._agreed <= PATIENCE_FRAMES
        if self._contradicted >= CONTRADICTIONS and self.trusted and not self._unsettled:
            self.doubted, self._fault_rad = True, difference_rad
            self._contradicted = self._agreeing = self._steady = 0

    def learn(self, match: Match | None, compass_rad: float | None, moved: bool = False) -> None:
        """`update` by the match of a frame, where there is a compass; without a match good frames begin anew."""
        if match is None:
            self.interrupt()
        elif compass_rad is not None:
            self.update(match.mean_distance_m, match.pose.heading, compass_rad, match.error, moved)

    @property
    def trusted(self) -> bool:
        """Whether compass and lines have agreed for long, and still do."""
        return self._agreed >= TRUSTED_FRAMES and not self.doubted

    def interrupt(self) -> None:
        """A frame without a match: good frames must follow each other anew."""
        self.good_frames = self._contradicted = self._agreeing = 0

    def lose(self) -> None:
        """The robot is lost: it is searched for with a compass that may well have been right."""
        self._unsettled &= self._contradicted < CONTRADICTIONS  # it has changed its mind
        if self._moved:
            self._unsettled = True
            self.doubted = self._moved = False
            self._agreed = 0

    def start_anew(self) -> None:
        """The robot was found: compass and lines must agree anew until the compass may be doubted.

        One that is doubted still agrees with half of all places: only if it contradicts them first, or agrees for long,
        does it tell the end again.
        """
        self.interrupt()
        self._agreed = 0
        self._unsettled |= self.doubted
        self._had_contradicted = False

    def is_other_end(self, heading_rad: float, compass_rad: float | None) -> bool:
        """Whether a compass that has jumped speaks for the other end of a symmetric field.

        Its readings tell nothing by themselves, but those that kept their difference from the lines until the robot
        was lost do.
        """
        back_rad = None if compass_rad is None else self.without_jump(compass_rad)
        return back_rad is not None and abs(wrap_angle(heading_rad - back_rad)) > OTHER_END_RAD

    def without_jump(self, compass_rad: float) -> float | None:
        """The heading (rad) of a compass that has jumped, its jump taken off; None of any other."""
        if not self.doubted or self._steady < STEADY_FRAMES:
            return None
        return wrap_angle(self.heading(compass_rad) + self._fault_rad)
