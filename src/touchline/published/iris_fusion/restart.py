"""When the particles start anew over the field: the robot is lost, or a search for it has found nothing.

Ismail et al. 2021 start them once; this rule is ours.
"""

from touchline.config import Settings, added

MIN_RATIO = 0.6  # share of points on lines below which an image contradicts the particles
# such images in a row after which the particles start anew over the field, or images while the pose is lost
# (fusion.lost_m): as many as make the pose doubtful, so that a kidnapped robot is right again within ten
FRAMES = 3
HOPELESS_RATIO = 0.2  # share of points on lines below which two such images are enough: no shove leaves so few
# images without usable points in a row after which one such image is enough: whoever was covered may have been carried
BLIND_FRAMES = 2
MAX_CYCLES = 16  # cycles after which a search that found nothing starts anew: it takes 4 to 9
# factor by which every new start widens the first headings about the compass, or about the heading known before
WIDENING = 1.5


class RestartPaper(Settings):
    """Switches to the paper's exact form."""

    image_cycles: int = added(
        2,
        paper=1,
        ge=1,
        le=10_000,
        description="cycles per image while searching, or with nothing known of the motion: halves the time to find "
        "the robot; 1 as in the paper",
    )
    heading_rad: float | None = added(
        1.6,
        paper=None,
        gt=0,
        description="difference from the compass (rad) that shows the wrong end of a symmetric field, where the lines "
        "look the same; none as in the paper, whose compass serves at the start alone",
    )
    again: bool = added(
        True,
        paper=False,
        description="particles start anew over the field when images contradict them, or a search has found nothing; "
        "false as in the paper: they start once",
    )
    lone_line: bool = added(
        False,
        paper=True,
        description="find a robot that is searched for by images of a single straight line, which fits many places "
        "and may be none of the field's; true as in the paper",
    )


class RestartSettings(Settings):
    """When the particles start anew, and how."""

    paper: RestartPaper = RestartPaper()


class RestartRule:
    """Counts what speaks against the pose while the robot is followed, and the cycles of a search for it."""

    def __init__(self, settings: RestartSettings | None = None) -> None:
        self.settings = settings or RestartSettings()
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._starts = 0
        self._cycles = 0
        self._contradicted = 0.0
        self._blind = 0

    def see_nothing(self) -> None:
        """An image without usable points."""
        self._blind += 1

    def is_refuted(self, inlier_ratio: float, lost: bool = False) -> bool:
        """Judge one image with points while the robot is followed; True if the particles must start anew.

        inlier_ratio: share of points on lines. lost: the pose has become so unsure that images which don't bring it
        back contradict it, however well they fit elsewhere.
        """
        enough = 1 if self._blind >= BLIND_FRAMES else FRAMES
        self._blind = 0
        says = FRAMES / 2 if inlier_ratio < HOPELESS_RATIO else 1
        self._contradicted = self._contradicted + says if lost or inlier_ratio < MIN_RATIO else 0
        return self.settings.paper.again and self._contradicted >= enough

    def start_is_due(self) -> bool:
        """Whether a search has not begun yet, or has gone on for too long. To be asked before every image of it."""
        return self._starts == 0 or (self._cycles >= MAX_CYCLES and self.settings.paper.again)

    def count_cycle(self) -> None:
        """The particles have taken one more cycle."""
        self._cycles += 1

    @property
    def failed(self) -> int:
        """Searches since the robot was last found that ended without it; asked before the next `start`."""
        return self._starts

    def start(self) -> float:
        """A search starts, or starts anew; returns how many times wider than at first the headings shall be."""
        self._starts += 1
        self._cycles, self._contradicted = 0, 0.0
        return WIDENING ** (self._starts - 1)

    def found(self) -> None:
        """The robot is found, or still followed: the next search begins with the first start again."""
        self._starts = 0
        self._blind = 0
