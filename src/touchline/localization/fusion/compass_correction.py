"""Correction of the compass by the heading that the lines gave (Xiong et al., section 4.2)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from pydantic import Field

from touchline.config import Settings, added, constants_now
from touchline.geometry import wrap_angle
from touchline.localization.matching.matcher import Match

# mean distance of the points to the lines below which a frame is good; a right pose has 0.03 to 0.1
GOOD_DEVIATION_M = 0.12
GOOD_FRAMES = 5  # good frames in a row before the compass is corrected, as many as mean failure
# difference that can't be the compass's error, so that nothing is learned from it: twice the worst of usual errors, as
# global_search.heading_tolerance_rad; half a turn means the wrong end of the field
MAX_CORRECTION_RAD = 0.6


class CompassPaper(Settings):
    """Switches to the paper's exact form."""

    bounded: bool = added(
        True,
        paper=False,
        description="nothing is learned from a difference of more than 0.6 rad, as at the other end of the field; "
        "false as in the paper: from any",
    )


class CompassSettings(Settings):
    """When and how fast the compass is corrected. The paper says: after several good frames."""

    removed: ClassVar[Mapping[str, str]] = constants_now(__name__, "good_deviation_m", "good_frames", "most_rad")

    gain: float = Field(
        0.2,
        gt=0,
        le=1,
        description="share of the difference that a frame corrects; averages over the compass noise of half a degree, "
        "yet follows a drift within a second",
    )
    paper: CompassPaper = CompassPaper()


class CompassCorrection:
    """The offset that makes the compass agree with the lines."""

    def __init__(self, settings: CompassSettings | None = None) -> None:
        self.settings = settings or CompassSettings()
        self.reset()

    def reset(self) -> None:
        """Take the compass as it is, until the lines say otherwise."""
        self.offset_rad = 0.0
        self.good_frames = 0

    def heading(self, compass_rad: float) -> float:
        """The corrected compass heading (rad)."""
        return wrap_angle(compass_rad + self.offset_rad)

    def update(self, mean_distance_m: float, heading_rad: float, compass_rad: float) -> bool:
        """Learn from one match and the compass's own reading at its time; whether the offset was corrected."""
        difference = wrap_angle(heading_rad - self.heading(compass_rad))
        believable = abs(difference) < MAX_CORRECTION_RAD or not self.settings.paper.bounded
        good = mean_distance_m < GOOD_DEVIATION_M and believable
        self.good_frames = self.good_frames + 1 if good else 0
        if self.good_frames < GOOD_FRAMES:
            return False
        self.offset_rad = wrap_angle(self.offset_rad + self.settings.gain * difference)
        return True

    def learn(self, match: Match | None, compass_rad: float | None) -> None:
        """`update` by the match of a frame, where there is a compass; without a match good frames begin anew."""
        if match is None:
            self.interrupt()
        elif compass_rad is not None:
            self.update(match.mean_distance_m, match.pose.heading, compass_rad)

    def interrupt(self) -> None:
        """A frame without a match: good frames must follow each other anew."""
        self.good_frames = 0
