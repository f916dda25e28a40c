"""A detector that learns its colours from the images it is given, and again when the light has changed."""

from __future__ import annotations

from pydantic import Field

from touchline.camera import OmniCamera
from touchline.config import Settings
from touchline.perception.colour import ColourModel, NoCarpetError
from touchline.perception.colour_file import load_colours
from touchline.perception.covered import LEAST_CONTRAST, visible_image
from touchline.perception.line_points import LinePointDetector, LinePointSettings
from touchline.types import Frame, ImageArray, LinePoints, empty_points


class LearningSettings(Settings):
    """When colours are learned."""

    frames: int = Field(
        5,
        ge=1,
        description="first images that the colours are learned from: one serves at once, five average over places",
    )
    faded_green: float = Field(
        0.6,
        gt=0,
        lt=1,
        description="share of the usual green below which the light is believed to have changed; robots hide a third",
    )
    faded_frames: int = Field(
        5,
        ge=1,
        description="images in a row with faded green before the colours are learned again: a robot that hides the "
        "view for a moment changes nothing",
    )
    colour_file: str | None = Field(
        None,
        description="a colour table written by touchline calibrate colour, kept for the whole run; none: colours are "
        "learned from the first images, and again when the green fades",
    )
    least_contrast: float = Field(
        LEAST_CONTRAST,
        ge=0,
        description="standard deviation (grey levels) between parts of the image below which the camera is covered: "
        "a covered one has 0.2, the dimmest usable image 3",
    )


class SelfLearningDetector:
    """Line points of frame after frame, without any colours given beforehand."""

    def __init__(
        self,
        camera: OmniCamera,
        settings: LinePointSettings | None = None,
        learning: LearningSettings | None = None,
        line_width_m: float = 0.125,
    ) -> None:
        self.detector = LinePointDetector(camera, settings, line_width_m)
        self.settings = learning or LearningSettings()
        file = self.settings.colour_file
        self._kept: ColourModel | None = None if file is None else load_colours(file)
        self.problem: str | None = None  # why nothing can be seen in the last frame
        self._begin_anew()

    def reset(self) -> None:
        """Forget the colours."""
        self.detector.forget()
        self._begin_anew()

    def _begin_anew(self) -> None:
        """Learn from the next images; the old colours serve until then."""
        self._images: list[ImageArray] = []
        self._usual_green = 0.0
        self._faded = 0

    def detect(self, frame: Frame) -> LinePoints:
        """Line points of a frame: its own if it has them already, none where no field is to be seen (see `problem`)."""
        self.problem = None
        if frame.points is not None:
            return frame.points
        image, self.problem = visible_image(frame, self.settings.least_contrast)
        if image is None or (len(self._images) < self.settings.frames and not self._learn(image)):
            return empty_points()
        points = self.detector.detect(image)
        if self._kept is None:
            self._watch_green(image)
        return points

    def _learn(self, image: ImageArray) -> bool:
        """Learn from this image and those kept; whether colours are known now."""
        self._images.append(image)
        # the first image serves at once, all together once they are there: learning costs as much as many frames
        if len(self._images) not in (1, self.settings.frames):
            return self.detector.colours is not None
        try:
            if self._kept is not None:
                self.detector.use_colours(self._kept, self._images)
            else:
                self.detector.learn(self._images)
        except NoCarpetError as error:
            self._images.pop()
            self.problem = str(error)
        return self.detector.colours is not None

    def _watch_green(self, image: ImageArray) -> None:
        share = self.detector.green_share
        if share < self.settings.faded_green * self._usual_green:
            self._faded += 1
        else:
            self._faded = 0
            self._usual_green += 0.1 * (share - self._usual_green) if self._usual_green else share
        if self._faded >= self.settings.faded_frames:
            self._begin_anew()
            self._learn(image)
