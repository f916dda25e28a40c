"""Correction of the compass by the heading that the lines gave (Xiong et al., section 4.2)."""

from __future__ import annotations

from pydantic import Field

from touchline.config import Settings
from touchline.geometry import wrap_angle
from touchline.localization.matching.matcher import Match


class CompassSettings(Settings):
    """When and how fast the compass is corrected. The paper says: after several good frames."""

    good_deviation_m: float = Field(
        0.12,
        gt=0,
        description="mean distance of the points to the lines (m) below which a frame is good; a right pose "
        "has 0.03 to 0.1",
    )
    good_frames: int = Field(
        5, ge=1, description="good frames in a row before the compass is corrected, as many as mean failure"
    )
    most_rad: float = Field(
        0.6,
        gt=0,
        description="difference (rad) that can't be the compass's error, so that nothing is learned from it: twice the "
        "worst of usual errors, as global_search.heading_tolerance_rad; half a turn means the wrong end of the field",
    )
    gain: float = Field(
        0.2,
        gt=0,
        le=1,
        description="share of the difference that a frame corrects; averages over the compass noise of half a degree, "
        "yet follows a drift within a second",
    )


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
        good = mean_distance_m < self.settings.good_deviation_m and abs(difference) < self.settings.most_rad
        self.good_frames = self.good_frames + 1 if good else 0
        if self.good_frames < self.settings.good_frames:
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
