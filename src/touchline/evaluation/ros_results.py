"""The results of a run as the messages of ROS that `live` publishes: one file shows field, robot and what it saw."""

import itertools
from collections.abc import Callable, Iterable

import numpy as np

from touchline.evaluation.run import Run
from touchline.geometry import Pose, wrap_angles
from touchline.sources import ProblemLog, Recording
from touchline.sources.bags.result_messages import TF, TYPES, Outgoing, ResultMessages
from touchline.sources.bags.standard import on_ground
from touchline.sources.bags.with_rosbags import Codec
from touchline.sources.bags.writing import BagWriter, epoch_ns
from touchline.sources.tables import open_table, read_blocks, to_stamps
from touchline.types import Estimate, Frame, Samples

_REACH_NS = 200_000_000  # an odometry sample farther away tells nothing of an image
Look = Callable[[Frame, Estimate], tuple[Estimate, bytes | None]]


def write_results(
    run: Run, writer: BagWriter, codec: Codec, look: Look | None = None, on_image: Callable[[], None] = lambda: None
) -> None:
    """Write every estimate of a run, on the clock of the bag that its recording came from, and close the bag.

    The transforms are map → odom → base where the recording has odometry at the image's time, else map → base
    (REP 105). look: an estimate with what was seen in its image, and a picture (JPEG) of that. on_image: called after
    every image. Raises InputError if the recording is no longer where it was.
    """
    recording, table = run.recording(), run.estimates
    epoch, odometry = epoch_ns(recording), _odometry(recording)
    results = ResultMessages(codec, recording.field)
    results.while_searching = True  # of the past it tells where the robot was taken to be

    def write(stamp_ns: int, messages: Iterable[Outgoing]) -> None:
        for out in messages:
            writer.write(out.topic, out.kind, stamp_ns, codec.encode(out.kind, out.message))

    frames: Iterable[Frame | None] = itertools.repeat(None) if look is None else recording.again()
    for row, frame in zip(range(len(table)), frames, strict=False):
        estimate = table.estimate(row)
        stamp_ns = max(estimate.stamp_ns + epoch, 0)
        if row == 0:
            write(stamp_ns, results.field(stamp_ns))
        if look is not None and frame is not None and frame.stamp_ns == estimate.stamp_ns:
            estimate, picture = look(frame, estimate)
            write(stamp_ns, [] if picture is None else [results.overlay(stamp_ns, picture)])
        at = _odometry_at(odometry, estimate.stamp_ns)
        map_from_odom = None if at is None else estimate.pose.compose(at.inverse())
        write(stamp_ns, results.located(stamp_ns, estimate, map_from_odom))
        if at is not None:
            frames_of = results.standard.frames
            moved = results.standard.transform(stamp_ns, frames_of.odom, frames_of.base, on_ground(at))
            write(stamp_ns, [Outgoing(TF, TYPES[TF], moved)])
        write(stamp_ns, results.explained(stamp_ns, estimate))
        on_image()
    writer.close()


def _odometry(recording: Recording) -> Samples | None:
    """All of odometry.csv; None where there is none that can be read."""
    if "odometry.csv" not in recording.sensor_files:
        return None
    table = open_table(recording.file("odometry.csv"), ("t", "x", "y", "theta"))
    blocks = [block.values for block in read_blocks(table, ("t", "x", "y", "theta"), ProblemLog())]
    if not blocks:
        return None
    rows = np.concatenate(blocks)
    order = np.argsort(rows[:, 0], kind="stable")
    return Samples(to_stamps(rows[order, 0]), rows[order, 1:])


def _odometry_at(odometry: Samples | None, stamp_ns: int) -> Pose | None:
    """Where the odometry says that the robot is; None where no sample is near."""
    if odometry is None:
        return None
    stamps = odometry.stamp_ns
    after = min(int(np.searchsorted(stamps, stamp_ns)), len(stamps) - 1)
    before = max(after - 1, 0) if stamps[after] > stamp_ns else after
    if min(abs(int(stamps[after]) - stamp_ns), abs(int(stamps[before]) - stamp_ns)) > _REACH_NS:
        return None
    step_ns = int(stamps[after] - stamps[before])
    step = odometry.values[after] - odometry.values[before]
    step[2] = wrap_angles(step[2:])[0]
    at = odometry.values[before] + ((stamp_ns - int(stamps[before])) / step_ns if step_ns else 0.0) * step
    return Pose(*at.tolist())
