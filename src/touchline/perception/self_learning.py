"""A detector that learns its colours from the images it is given, and again when the light has changed."""

from pydantic import Field

from touchline.camera import Camera
from touchline.config import Settings, added
from touchline.perception.colour import ColourModel, NoCarpetError
from touchline.perception.colour_file import load_colours
from touchline.perception.detector import image_of, with_lean
from touchline.perception.line_points import NOISE_M, LinePointDetector, LinePointSettings
from touchline.types import Frame, ImageArray, Observation

FADED_GREEN = 0.6  # share of the usual green below which the light is believed to have changed; robots hide a third
# images in a row with faded green before the colours are learned again: a robot that hides the view for a moment
# changes nothing
FADED_FRAMES = 5


class GreenWatch:
    """Tells when much less of what is seen is green than usual, for some images in a row."""

    def __init__(self) -> None:
        self._usual, self._faded = 0.0, 0

    def is_faded(self, share: float) -> bool:
        """Whether the green has faded in an image, of which this share is green."""
        if share < FADED_GREEN * self._usual:
            self._faded += 1
            return True
        self._faded = 0
        self._usual += 0.1 * (share - self._usual) if self._usual else share
        return False

    @property
    def has_faded(self) -> bool:
        """Whether that has gone on for so long that the light must have changed."""
        return self._faded >= FADED_FRAMES


class LearningPaper(Settings):
    """Switches to the papers' exact form."""

    again: bool = added(
        True,
        paper=False,
        description="colours are learned again when the green fades: the light has changed; false: what was learned "
        "first stays, as the papers' colours, which are calibrated before a game",
    )


class LearningSettings(Settings):
    """When colours are learned."""

    frames: int = Field(
        5,
        ge=1,
        le=1_000,
        description="first images that the colours are learned from: one serves at once, five average over places",
    )
    colour_file: str | None = Field(
        None,
        description="a colour table written by touchline calibrate colour, kept for the whole run; none: colours are "
        "learned from the first images, and again when the green fades",
    )
    paper: LearningPaper = LearningPaper()


class SelfLearningDetector:
    """A `Detector` of line points that needs no colours given beforehand."""

    def __init__(
        self,
        camera: Camera,
        settings: LinePointSettings | None = None,
        learning: LearningSettings | None = None,
        line_width_m: float = 0.125,
    ) -> None:
        self.detector = LinePointDetector(camera, settings, line_width_m)
        self.settings = learning or LearningSettings()
        file = self.settings.colour_file
        self._kept: ColourModel | None = None if file is None else load_colours(file)
        self._begin_anew()

    @property
    def learns_colours(self) -> bool:
        """Whether the first images teach it its colours: not with a colour table."""
        return self._kept is None

    def reset(self) -> None:
        """Forget the colours."""
        self.detector.forget()
        self._begin_anew()

    def _begin_anew(self) -> None:
        """Learn from the next images; the old colours serve until then."""
        self._images: list[ImageArray] = []
        self._has_learned = False  # from all of them
        self._green = GreenWatch()
        self._faded_image: ImageArray | None = None

    def observe(self, frame: Frame) -> Observation:
        """Line points of a frame's image, none where no carpet is seen. Raises InputError for one of another size."""
        image, problem = image_of(frame, self.detector.camera), None
        if self._faded_image is not None:
            self._learn(self._faded_image)
            self._faded_image = None
        if not self._has_learned:
            problem = self._learn(image)
        if self.detector.colours is None:
            return Observation(frame.stamp_ns, problem=problem)
        detector = self.detector
        points = with_lean(detector.detect(image), frame, detector.camera, detector.settings.noise_px, NOISE_M)
        if self._kept is None and self.settings.paper.again:
            self._watch_green(image)
        return Observation(frame.stamp_ns, points, problem=problem)

    def stages(self, image: ImageArray) -> dict[str, ImageArray]:
        """Title -> picture (H, W, 3), B, G, R, of each step. Raises TouchlineError before any colours are known."""
        return self.detector.stages(image)

    def _learn(self, image: ImageArray) -> str | None:
        """Learn from this image and those kept; why nothing could be learned, if so."""
        self._images.append(image)
        # the first image serves at once, all together once they are there: learning costs as much as many frames
        if len(self._images) not in (1, self.settings.frames):
            return None
        try:
            if self._kept is not None:
                self.detector.use_colours(self._kept, self._images)
            else:
                self.detector.learn(self._images)
        except NoCarpetError as error:
            self._images.pop()
            return str(error)
        if len(self._images) == self.settings.frames:
            self._has_learned, self._images = True, []
        return None

    def _watch_green(self, image: ImageArray) -> None:
        if self._green.is_faded(self.detector.green_share) and 1 < len(self._images) < self.settings.frames:
            self._images.pop()  # broken, or hardly any field in it: not to be learned from with the others
        if self._green.has_faded:
            self._begin_anew()
            self._faded_image = image  # learned from before the next one: `stages` still shows what this one gave
