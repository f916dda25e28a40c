"""A localizer outside of this package: a program that answers lines on its standard input with lines on its standard
output.

First the field, then one line for each question; the program answers each with one line, and ends when its input does.

    field 1 SEGMENTS ARCS                   how many lines of the field follow
    x1 y1 x2 y2                             a segment's centre line (m)
    cx cy radius start end                  an arc's, counter-clockwise; of a circle end is start plus 2 pi (m, rad)
    init X Y HEADING N x1 y1 … xN yN        where does the robot stand? begin at this pose; N points, robot frame
    compass HEADING N x1 y1 … xN yN         the same, with nothing but a heading
    none N x1 y1 … xN yN                    the same, with nothing
    image T M N                             where is the robot at the time T (s) of an image? M lines of odometry since
                                            the image before follow, and N of what it shows
    T X Y HEADING                           odometry (s, m, m, rad), in a frame of its own
    kind,x_m,y_m,…                          a row of observations.csv without its time

    X Y HEADING                             the answer (m, rad, field frame), or the word none
"""

import math
import os
import select
import shlex
import subprocess

from typing_extensions import Self

from touchline.errors import InputError, TouchlineError
from touchline.field import FieldModel
from touchline.geometry import Pose
from touchline.sources.observations import observation_rows
from touchline.types import Frame, LinePoints

_MAX_ANSWER = 1000
MAX_WAIT_S = 60.0  # for an answer


class OutsideProgram:
    """A program as a localizer. It is started at once, and ended by `close` or at the end of the block."""

    def __init__(self, command: str, field: FieldModel) -> None:
        """command: the program with its arguments, as in a shell. Raises InputError for one that does not start."""
        self.command = command
        try:
            words = shlex.split(command) or [""]
            self._process = subprocess.Popen(
                words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1, errors="replace"
            )
        except (OSError, ValueError, IndexError) as error:
            raise InputError(f"--program {command}: {getattr(error, 'strerror', None) or error}") from None
        self._tell(_field_lines(field))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the program: its input ends, and it has a second to follow."""
        try:
            self._process.communicate(timeout=1.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        except OSError:
            self._process.wait()

    def from_pose(self, points: LinePoints, start: Pose) -> Pose | None:
        return self._ask(f"init {float(start.x)!r} {float(start.y)!r} {float(start.heading)!r}", points)

    def from_heading(self, points: LinePoints, heading_rad: float) -> Pose | None:
        return self._ask(f"compass {float(heading_rad)!r}", points)

    def from_nothing(self, points: LinePoints) -> Pose | None:
        return self._ask("none", points)

    def at_image(self, frame: Frame) -> Pose | None:
        """Of a frame that holds an observation. Its questions make up a stream: the program may remember."""
        assert frame.observation is not None
        rows = [row.partition(",")[2] for row in observation_rows(frame.observation)]
        log = frame.odometry
        moved = () if log is None else zip((1e-9 * log.stamp_ns).tolist(), log.values.tolist(), strict=True)
        steps = [" ".join(map(repr, (stamp_s, *values))) for stamp_s, values in moved]
        return self._answer("\n".join([f"image {1e-9 * frame.stamp_ns!r} {len(steps)} {len(rows)}", *steps, *rows]))

    def _ask(self, begin: str, points: LinePoints) -> Pose | None:
        numbers = " ".join(map(repr, points.positions_m.ravel().tolist()))
        return self._answer(f"{begin} {len(points)} {numbers}")

    def _answer(self, question: str) -> Pose | None:
        begin = question.partition("\n")[0][:40]
        self._tell(question + "\n")
        assert self._process.stdout is not None
        # only there can a pipe be waited for
        if os.name == "posix" and not select.select([self._process.stdout], [], [], MAX_WAIT_S)[0]:
            said = f"no answer for {MAX_WAIT_S:.0f} s after '{begin}': does its output wait in a buffer?"
            raise TouchlineError(f"--program {self.command}: {said}")
        answer = self._process.stdout.readline(_MAX_ANSWER)
        if not answer.endswith("\n"):
            ended = "ended" if len(answer) < _MAX_ANSWER else "answered with a line that does not end"
            raise TouchlineError(f"--program {self.command}: {ended} after '{begin}'")
        if answer.strip() == "none":
            return None
        try:
            x, y, heading = (float(word) for word in answer.split())
        except ValueError:
            x = y = heading = math.nan
        if not all(map(math.isfinite, (x, y, heading))):
            raise TouchlineError(f"--program {self.command}: expected X Y HEADING or none, got {answer.strip()!r:.60}")
        return Pose(x, y, math.remainder(heading, 2.0 * math.pi))

    def _tell(self, text: str) -> None:
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(text)
            self._process.stdin.flush()
        except OSError:
            raise TouchlineError(f"--program {self.command}: reads no more of what it is told") from None


def _field_lines(field: FieldModel) -> str:
    circles = [(*circle, 0.0, 2.0 * math.pi) for circle in field.circles.tolist()]
    arcs = [*circles, *field.arcs.tolist()]
    rows = [*field.segments.tolist(), *arcs]
    head = f"field 1 {len(field.segments)} {len(arcs)}\n"
    return head + "".join(" ".join(map(repr, row)) + "\n" for row in rows)
