"""The results of a run as messages of ROS: pose with covariance, map → odom, diagnostics."""

import numpy as np

from touchline.evaluation.run import Run
from touchline.geometry import Pose, wrap_angles
from touchline.sources import ProblemLog, Recording
from touchline.sources.bags.standard import StandardMessages
from touchline.sources.bags.with_rosbags import Codec
from touchline.sources.bags.writing import BagWriter, epoch_ns
from touchline.sources.tables import open_table, read_blocks, to_stamps
from touchline.types import Samples

POSE_TOPIC = "/touchline/pose"
_REACH_NS = 200_000_000  # an odometry sample farther away tells nothing of an image


def write_results(run: Run, writer: BagWriter, codec: Codec) -> None:
    """Write every estimate of a run, on the clock of the bag that its recording came from, and close the bag.

    The transform is map → odom where the recording has odometry at the image's time, else map → base (REP 105).
    Raises InputError if the recording is no longer where it was.
    """
    recording, table = run.recording(), run.estimates
    epoch, odometry = epoch_ns(recording), _odometry(recording)
    make = StandardMessages(codec)
    for row in range(len(table)):
        estimate = table.estimate(row)
        stamp_ns = max(estimate.stamp_ns + epoch, 0)
        map_from_odom = _map_from_odom(estimate.pose, odometry, estimate.stamp_ns)
        for topic, kind, message in (
            (POSE_TOPIC, "geometry_msgs/msg/PoseWithCovarianceStamped", make.estimated(stamp_ns, estimate)),
            ("/tf", "tf2_msgs/msg/TFMessage", make.map_from(stamp_ns, estimate, map_from_odom)),
            ("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", make.diagnostics(stamp_ns, estimate)),
        ):
            writer.write(topic, kind, stamp_ns, codec.encode(kind, message))
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


def _map_from_odom(pose: Pose, odometry: Samples | None, stamp_ns: int) -> Pose | None:
    """Where the odometry frame lies; None where no sample is near."""
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
    return pose.compose(Pose(*at.tolist()).inverse())
