"""A detector that learns its colours from the images it is given, and again when the light has changed."""

from collections.abc import Callable, Sequence

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


class FirstImages:
    """The images that colours are learned from: the first serves at once, all together once they are there; and anew
    when much less of what is seen is green than usual, for some images in a row.
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self.begin()

    def begin(self) -> None:
        """Learn from the next images."""
        self._images: list[ImageArray] = []
        self.are_learned = False  # all of them
        self._keeps_newest = False
        self._usual, self._faded = 0.0, 0

    def take(self, image: ImageArray, learn: Callable[[Sequence[ImageArray]], None]) -> None:
        """Learn from an image and those before it where it is time: it costs as much as many frames.

        Raises NoCarpetError as `learn` does: the image is not kept then.
        """
        self._images.append(image)
        self._keeps_newest = True
        if len(self._images) not in (1, self._count):
            return
        try:
            learn(self._images)
        except NoCarpetError:
            self._images.pop()
            self._keeps_newest = False
            raise
        if len(self._images) == self._count:
            self.are_learned, self._images = True, []

    def watch(self, share: float) -> bool:
        """Whether the green has faded for so long that colours are learned anew; share: of an image that is green."""
        if share >= FADED_GREEN * self._usual:
            self._faded = 0
            self._usual += 0.1 * (share - self._usual) if self._usual else share
            return False
        self._faded += 1
        if len(self._images) > 1 and self._keeps_newest:
            self._images.pop()  # broken, or hardly any field in it: not to be learned from with the others
        if self._faded < FADED_FRAMES:
            return False
        self.begin()
        return True


class LearningPaper(Settings):
    """Switches to the papers' exact form."""

    again: bool = added(
        True,
        paper=False,
        description="colours follow the light's tint, and are learned again when the green fades; false: what was "
        "learned first stays, as the papers' colours, which are calibrated before a game",
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
        self._first = FirstImages(self.settings.frames)
        self._faded_image: ImageArray | None = None

    @property
    def learns_colours(self) -> bool:
        """Whether the first images teach it its colours: not with a colour table."""
        return self._kept is None

    def reset(self) -> None:
        """Forget the colours."""
        self.detector.forget()
        self._first.begin()
        self._faded_image = None

    def observe(self, frame: Frame) -> Observation:
        """Line points of a frame's image, none where no carpet is seen. Raises InputError for one of another size."""
        image, problem = image_of(frame, self.detector.camera), None
        if self._faded_image is not None:
            self._learn(self._faded_image)
            self._faded_image = None
        if not self._first.are_learned:
            problem = self._learn(image)
        if self.detector.colours is None:
            return Observation(frame.stamp_ns, problem=problem)
        detector = self.detector
        detector.fetch(image)
        if self._kept is None and self.settings.paper.again:
            detector.follow(image)
        points = with_lean(detector.detect(image), frame, detector.camera, detector.settings.noise_px, NOISE_M)
        if self._kept is None and self.settings.paper.again and self._first.watch(detector.green_share):
            self._faded_image = image  # learned from before the next one: `stages` still shows what this one gave
        return Observation(frame.stamp_ns, points, problem=problem)

    def stages(self, image: ImageArray) -> dict[str, ImageArray]:
        """Title -> picture (H, W, 3), B, G, R, of each step. Raises TouchlineError before any colours are known."""
        return self.detector.stages(image)

    def _learn(self, image: ImageArray) -> str | None:
        """Learn from this image and those kept; why nothing could be learned, if so."""
        try:
            self._first.take(image, self._learn_from)
        except NoCarpetError as error:
            return str(error)
        return None

    def _learn_from(self, images: Sequence[ImageArray]) -> None:
        if self._kept is not None:
            self.detector.use_colours(self._kept, images)
        else:
            self.detector.learn(images)
