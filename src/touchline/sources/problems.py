"""What was odd about a recording: reported one by one, counted by kind, never fatal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from touchline.enums import StrEnum

KEPT_PER_KIND = 100  # enough to read; the counts go on, the memory does not


class ProblemKind(StrEnum):
    """What sort of oddity a `RecordingProblem` is."""

    MISSING_IMAGE = "missing image"
    BROKEN_IMAGE = "broken image"
    IMAGE_SIZE = "image size"
    LINEAR_IMAGE = "linear image"
    BROKEN_ROW = "broken row"
    NOT_A_NUMBER = "not a number"
    TIME_ORDER = "time order"
    SENSOR_GAP = "sensor gap"
    SENSOR_FILE = "unreadable sensor file"
    EMPTY_COLUMN = "empty column"
    TRUTH = "truth"
    SEQUENCE = "sequence"
    BAG = "damaged bag"
    TOPIC = "choice of topics"


@dataclass(frozen=True, slots=True)
class RecordingProblem:
    """One oddity. file: relative to the recording; line: counted from 1; frame: index of the image, from 0.

    place: file and line, or topic and message of a bag. message: a complete sentence that names the place by itself.
    """

    file: str
    line: int | None
    frame: int | None
    kind: ProblemKind
    place: str
    message: str

    def __str__(self) -> str:
        return self.message


class ProblemLog:
    """Problems in the order of discovery: `KEPT_PER_KIND` of each kind, the first of each file, and the counts.

    topics: of a bag, the topic that each table was written from: whoever recorded it knows no table.
    """

    def __init__(self, topics: Mapping[str, str] | None = None) -> None:
        self.topics = topics or {}
        self._kept: list[RecordingProblem] = []
        self.counts: Counter[ProblemKind] = Counter()
        self.file_counts: Counter[tuple[ProblemKind, str]] = Counter()

    def add(
        self, kind: ProblemKind, file: str, what: str, *, line: int | None = None, frame: int | None = None
    ) -> RecordingProblem:
        """Report a problem; its message is made of the place and `what`."""
        place = self.topics.get(file, file)
        if line is not None:
            place += f", message {line - 1}" if file in self.topics else f", line {line}"
        shown = place if frame is None else f"{place} (frame {frame})"
        problem = RecordingProblem(file, line, frame, kind, place, f"{shown}: {what}")
        if self.counts[kind] < KEPT_PER_KIND or not self.file_counts[kind, file]:
            self._kept.append(problem)
        self.counts[kind] += 1
        self.file_counts[kind, file] += 1
        return problem

    @property
    def total(self) -> int:
        """How many problems were reported, kept or not."""
        return sum(self.counts.values())

    def joined(self, other: ProblemLog) -> ProblemLog:
        """This log followed by the other, as a new log."""
        both = ProblemLog(self.topics)
        both._kept = [*self._kept, *other._kept]
        both.counts = self.counts + other.counts
        both.file_counts = self.file_counts + other.file_counts
        return both

    def summary(self) -> str:
        """The counts in words, for a line of output; empty if nothing was reported."""
        return ", ".join(f"{count} × {kind.value}" for kind, count in self.counts.items())

    def __getitem__(self, index: int) -> RecordingProblem:
        return self._kept[index]

    def __len__(self) -> int:
        """Number of problems kept (`total` counts all)."""
        return len(self._kept)

    def __iter__(self) -> Iterator[RecordingProblem]:
        return iter(self._kept)
