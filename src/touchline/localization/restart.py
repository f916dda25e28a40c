"""When the particles have lost the robot and must start anew over the field. Ismail et al. 2021 have no rule for it."""

from __future__ import annotations

from pydantic import Field

from touchline.config import Settings


class RestartSettings(Settings):
    """When the particles start anew, and how."""

    least_share: float = Field(
        0.6, ge=0, le=1, description="share of points on lines below which an image contradicts the particles"
    )
    frames: int = Field(5, ge=1, description="such images in a row after which the particles start anew over the field")
    blind_frames: int = Field(
        2,
        ge=1,
        description="images without usable points in a row after which one such image is enough: whoever was covered "
        "may have been carried",
    )
    image_cycles: int = Field(
        2, ge=1, description="cycles per image while searching: halves the time to find the robot; 1 as in the paper"
    )
    most_cycles: int = Field(
        16, ge=1, description="cycles after which a search that found nothing starts anew: it takes 4 to 9"
    )
    widening: float = Field(
        1.5, ge=1, description="factor by which every new start widens the first headings about the compass"
    )
    heading_rad: float | None = Field(
        1.6,
        gt=0,
        description="difference from the compass (rad) that shows the wrong end of a symmetric field, where the lines "
        "look the same; none as in the paper, whose compass serves at the start alone",
    )
    heading_frames: int = Field(5, ge=1, description="images in a row with such a difference until the search starts")


class RestartRule:
    """Counts what speaks against the particles while they follow the robot, and the cycles while they search for it."""

    def __init__(self, settings: RestartSettings | None = None) -> None:
        self.settings = settings or RestartSettings()
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.starts = 0
        self.cycles = 0
        self.contradicted = 0
        self.turned = 0
        self.blind = 0

    def found(self) -> None:
        """The robot was found: the next search begins with the first start again."""
        self.starts = 0

    def see_nothing(self) -> None:
        """An image without usable points."""
        self.blind += 1

    def is_refuted(self, on_lines: float, heading_error_rad: float | None) -> bool:
        """Judge one image; True if the particles must start anew.

        on_lines: share of points on lines; heading_error_rad: heading minus compass, None without one.
        """
        s = self.settings
        enough = 1 if self.blind >= s.blind_frames else s.frames
        self.blind = 0
        self.contradicted = self.contradicted + 1 if on_lines < s.least_share else 0
        strays = s.heading_rad is not None and heading_error_rad is not None and abs(heading_error_rad) > s.heading_rad
        self.turned = self.turned + 1 if strays else 0
        return self.contradicted >= enough or self.at_wrong_end

    @property
    def at_wrong_end(self) -> bool:
        """Whether the compass says so."""
        return self.turned >= self.settings.heading_frames

    def start_is_due(self) -> bool:
        """Whether a search has not begun yet, or has gone on for too long. To be asked before every cycle of it."""
        return self.starts == 0 or self.cycles >= self.settings.most_cycles

    def start(self) -> float:
        """A search starts, or starts anew; returns how many times wider than at first the headings shall be."""
        self.starts += 1
        self.cycles = self.contradicted = self.turned = 0
        return self.settings.widening ** (self.starts - 1)
