"""summary.json: what was run, how far it came and how good it was."""

from typing import Any

from pydantic import BaseModel, InstanceOf

from touchline.evaluation.metrics import ErrorStatistics

UNFINISHED = "unfinished"
"""`RunSummary.ended` of a run that goes on, or was cut off."""
Text = InstanceOf[str]  # may hold the bytes of a path that is no UTF-8, which pydantic's own `str` refuses


class RunRecording(BaseModel):
    """The recording of a run. bag: what the command said of a bag, as `BagOptions.to_dict` has it."""

    path: Text | None = None
    bag: dict[str, Any] | None = None
    name: Text = "an unnamed recording"
    description: Text = ""
    field: Text = ""


class RunPrior(BaseModel):
    """Start given to the system. pose: x, y (m), heading (rad)."""

    pose: tuple[float, float, float] | None = None
    own_half: bool = False


class BlackImages(BaseModel):
    """How many images were black; the first and last stamp of every stretch of them."""

    count: int = 0
    stretches_ns: list[tuple[int, int]] = []


class EitherSide(BaseModel):
    """In how many images the other end of the field fits as well, the last such pose there and its probability."""

    count: int = 0
    other_pose: tuple[float, float, float] | None = None
    probability: float | None = None


class SaidPhrase(BaseModel):
    """What the system said in successive images, in the first of them at `t` (s), in the last at `until`."""

    t: float
    until: float
    images: int = 1
    code: Text
    what: Text


class Durations(BaseModel):
    """Median, 99th percentile and maximum (ms); None without frames."""

    median: float | None = None
    p99: float | None = None
    max: float | None = None


class Latency(BaseModel):
    """Time per image (ms) without the first `first_left_out`, of which the longest took `start_max`."""

    first_left_out: int = 0
    perception: Durations = Durations()
    localization: Durations = Durations()
    total: Durations = Durations()
    start_max: float | None = None


class ReadingProblems(BaseModel):
    """Problems of the recording: how many of each kind, and the first messages."""

    counts: dict[str, int] = {}
    messages: list[Text] = []


class RunErrors(BaseModel):
    """Error statistics, as `ErrorTable.as_dict` has them."""

    x_m: ErrorStatistics
    y_m: ErrorStatistics
    position_m: ErrorStatistics
    heading_rad: ErrorStatistics
    tracked_x_m: ErrorStatistics | None = None
    tracked_y_m: ErrorStatistics | None = None
    tracked_position_m: ErrorStatistics | None = None
    tracked_heading_rad: ErrorStatistics | None = None
    frames: int
    skipped: int = 0
    black: int = 0
    before_first: int = 0
    without_truth: int = 0
    lost: int = 0
    protection_position: dict[str, float | None] | None = None
    protection_heading: dict[str, float | None] | None = None
    end_open: int = 0


class RunSummary(BaseModel):
    """All of summary.json. ended: complete, interrupted, failed or unfinished; failure: the exception that ended it.

    A run that goes on, or was cut off, lacks what is known at its end; then the defaults stand.
    """

    format: int = 1
    started: str = ""
    recording: RunRecording = RunRecording()
    system: str = ""
    settings: dict[str, Any] = {}
    learns_colours: bool = False
    notices: list[Text] = []
    prior: RunPrior = RunPrior()
    seed: int = 0
    versions: dict[str, str] = {}
    platform: str = ""
    cpu: str = ""
    ended: str = "complete"
    failure: Text | None = None
    frames: int = 0
    duration_s: float = 0.0
    recording_rate_hz: float | None = None
    rate_fps: float | None = None
    status: dict[str, int] = {"tracking": 0, "searching": 0, "lost": 0}
    mode: dict[str, int] | None = None
    missing_images: int = 0
    late_frames: int = 0
    unconfirmed_frames: int = 0
    unmoved_frames: int = 0
    clock_set_back: int = 0
    black_images: BlackImages = BlackImages()
    either_side: EitherSide = EitherSide()
    said: list[SaidPhrase] = []
    latency_ms: Latency = Latency()
    errors: RunErrors | None = None
    why_no_errors: Text = ""
    problems: ReadingProblems = ReadingProblems()
    why_not_localised: Text | None = None

    def updated(self, other: "RunSummary") -> "RunSummary":
        """The same with all that was given to the other summary."""
        return self.model_copy(update={name: getattr(other, name) for name in other.model_fields_set})
