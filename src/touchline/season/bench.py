"""How well a system localises a recording that holds the truth: figures in one row."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from touchline.errors import InputError, TouchlineError
from touchline.evaluation.metrics import associate, error_table
from touchline.evaluation.outside_program import OutsideProgram
from touchline.evaluation.runner import robot_setup
from touchline.geometry import Pose
from touchline.messages import unexpected
from touchline.perception.covered import is_covered
from touchline.season.recordings import at_hand
from touchline.sources import Recording, open_source
from touchline.systems import open_system
from touchline.systems.ordered import OrderedSystem
from touchline.types import Frame, Samples, Status


@dataclass(frozen=True, slots=True)
class RecordingScore:
    """Errors of all images from the first that was localised on, black ones left out; tracked: share of those with
    tracking as status. ms_per_image: median time of a step, reading left out. problems: of the recording, counted
    by kind.
    """

    images: int
    tracked: float
    mean_position_m: float
    max_position_m: float
    mean_heading_rad: float
    max_heading_rad: float
    ms_per_image: float
    problems: str


class BenchTask(NamedTuple):
    """A recording, and the name of its row."""

    name: str
    recording: str


class BenchRow(NamedTuple):
    """What became of a recording; without a score, failure says why."""

    name: str
    score: RecordingScore | None
    failure: str = ""

    def to_dict(self) -> dict[str, Any]:
        """As JSON has it."""
        return {"name": self.name, **(asdict(self.score) if self.score else {}), "failure": self.failure}


Step = Callable[[Frame], tuple[int, Pose | None, bool]]  # stamp, pose, and whether it is tracked


@contextmanager
def opened(source: Recording, system: str, program: str | None) -> Iterator[Step]:
    """A system, or a program that is asked image by image, whose every pose counts as tracked."""
    if program is None:
        stepped = OrderedSystem(open_system(system, robot_setup(source)))

        def step(frame: Frame) -> tuple[int, Pose | None, bool]:
            estimate = stepped.step(frame)
            return estimate.stamp_ns, estimate.pose, estimate.status is Status.TRACKING

        yield step
        return
    with OutsideProgram(program, source.field) as outside:

        def ask(frame: Frame) -> tuple[int, Pose | None, bool]:
            if frame.observation is None:
                raise InputError(f"{source.name}: holds images; --program takes recordings with observations.csv")
            pose = outside.at_image(frame)
            return frame.stamp_ns, pose, pose is not None

        yield ask


def bench_row(task: BenchTask, system: str, program: str | None = None) -> BenchRow:
    """Run a system, or a program, over a recording; what goes wrong is its row's failure, the others go on."""
    try:
        with at_hand(task.recording) as path:
            return BenchRow(task.name, bench_recording(path, system, program))
    except TouchlineError as error:
        return BenchRow(task.name, None, str(error))
    except Exception as error:  # a fault of a system, or of one recording's decoder: a row, and not the end
        return BenchRow(task.name, None, unexpected(error))


def bench_recording(folder: Path, system: str, program: str | None = None) -> RecordingScore:
    """Run a system, or a program, over a recording, from nothing. Raises InputError for one without true poses."""
    source = open_source(folder)
    if source.truth is None:
        raise InputError(f"{folder}: holds no true poses (ground_truth.tum) to compare with")
    stamps: list[int] = []
    poses: list[Pose] = []
    tracked: list[bool] = []
    black: list[tuple[int, int]] = []
    times_s: list[float] = []
    with opened(source, system, program) as step:
        for frame in source:
            begun_s = time.perf_counter()
            stamp_ns, pose, sure = step(frame)
            times_s.append(time.perf_counter() - begun_s)
            if stamps and stamp_ns <= stamps[-1]:
                continue
            stamps.append(stamp_ns)
            poses.append(pose or (poses[-1] if poses else Pose(0.0, 0.0, 0.0)))
            tracked.append(sure)
            if frame.image is not None and is_covered(frame.image):
                black.append((stamp_ns, stamp_ns))
    trajectory = Samples(np.array(stamps, np.int64), np.array(poses, np.float64).reshape(-1, 3))
    truth, located = source.truth.samples(), np.array(tracked, np.bool_)
    errors = error_table(trajectory, truth, located=located, black_ns=black)
    counted = (associate(trajectory.stamp_ns, truth.stamp_ns) >= 0) & np.maximum.accumulate(located)
    share = float(located[counted].sum()) / max(int(counted.sum()) - errors.black, 1)
    position, heading = errors.position, errors.heading
    median_ms = 1e3 * float(np.median(times_s))
    figures = position.mean, position.max, heading.mean, heading.max
    return RecordingScore(errors.frames, min(share, 1.0), *figures, median_ms, source.problems.summary())
