"""What a robot knew, kept in a file while it plays, so that a process that was killed goes on where it was."""

import json
import math
import os
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from touchline.errors import InputError, TouchlineError
from touchline.files.new import replace_file
from touchline.files.opened import read_text
from touchline.geometry import FloatArray, Pose
from touchline.localizer import Localizer
from touchline.types import Estimate, Frame, Prior, Status, WeightedPose

EVERY_S = 1.0
MAX_AGE_S = 3600.0  # from which it tells nothing of the pose
# of a robot that went on while nothing was localised, slowly or fast: with less a fast one was found at the wrong end
SPEEDS_M_S, TURN_RAD_S = (0.3, 2.0), 1.5
MAX_DEVIATION_M, MAX_DEVIATION_RAD = 8.0, 2.0 * math.pi  # as good as anywhere in a field
STOOD, WENT_ON, STILL_THERE_S = 0.5, 0.2, 900.0  # weights at once; the time after which it was rather carried off
# where odometry goes on: weight of where it leads; what is left for the two others; its drift by time (m/s, rad/s)
BY_ODOMETRY, ELSE, DRIFT_M_S, DRIFT_RAD_S = 0.9, 0.06, 0.03, 0.03
MAX_APART_NS, MAX_CLOCK_S = 400_000_000, 5.0  # of an odometry sample and an image; of the two clocks, as an image waits
MAX_SPEED_M_S, NEAR_ORIGIN_M = 4.0, 0.3  # by odometry; so near to its origin it has rather begun anew
MAX_IMAGES = 10  # until odometry has to have come
BLURRED = np.diag(np.square([0.05, 0.05, 0.03]))
MAX_POSES, MAX_BYTES = 4, 1_000_000


class StateFile:
    """Writes what is tracked once a second. The file is always whole: it is replaced, never written over."""

    def __init__(self, path: Path, localizer: Localizer) -> None:
        self._path, self._localizer, self._written_s = path, localizer, -math.inf
        self._writer: threading.Thread | None = None

    def take(self, estimate: Estimate, map_from_odom: Pose | None = None) -> None:
        """Keep an estimate, if it is tracked and a second has passed; a disk that is full stops no robot."""
        now_s = time.monotonic()
        if estimate.status is not Status.TRACKING or now_s - self._written_s < EVERY_S:
            return
        self._written_s = now_s
        each = [(estimate.pose, estimate.covariance, estimate.probability or 0.99)]
        each += [
            (o.pose, o.covariance, o.probability)
            for o in estimate.hypotheses
            if o.covariance is not None and o.probability
        ]
        known = sorted(each, key=lambda one: -one[2])[:MAX_POSES]
        state = {
            "field": self._localizer.field.name,
            "unix_s": time.time(),
            "stamp_ns": estimate.stamp_ns,
            "odometry": None if map_from_odom is None else list(map_from_odom.inverse().compose(estimate.pose)),
            "poses": [{"pose": list(p), "covariance": np.asarray(c).tolist(), "probability": w} for p, c, w in known],
            "camera_errors": self._localizer.camera_errors,
        }
        if self._writer is None or not self._writer.is_alive():  # a slow disk delays no image
            self._writer = threading.Thread(target=self._write, args=(json.dumps(state).encode(),), daemon=True)
            self._writer.start()

    def close(self) -> None:
        """Wait for what is being written."""
        if self._writer is not None:
            self._writer.join()

    def _write(self, data: bytes) -> None:
        with suppress(TouchlineError):
            replace_file(self._path, data)


class Resumption:
    """Where a robot may stand at an image, by what is known of the time since the state was written."""

    def __init__(self, state: dict[str, Any]) -> None:
        """Raises ValueError, KeyError or TypeError for what is no state."""
        self._poses, self._unix_s, self._stamp_ns = state["poses"], float(state["unix_s"]), int(state["stamp_ns"])
        self._odometry = None if state["odometry"] is None else Pose(*map(float, state["odometry"]))
        self._images = 0
        prior_of(self._poses, self.age_s)

    @property
    def age_s(self) -> float:
        """How long ago it was written."""
        return max(time.time() - self._unix_s, 0.0)

    def prior(self, frame: Frame) -> Prior | None:
        """At an image; None: nothing new."""
        self._images += 1
        moved = self.moved(frame) if self._images <= MAX_IMAGES else None
        if moved is None and self._images > 1:
            return None
        self._images = self._images if moved is None else MAX_IMAGES
        return prior_of(self._poses, self.age_s, moved)

    def moved(self, frame: Frame) -> Pose | None:
        """How the robot moved since by its odometry; None where that began anew, or the clock did."""
        samples, was = frame.odometry, self._odometry
        if samples is None or was is None:
            return None
        nearest = int(np.abs(samples.stamp_ns - frame.stamp_ns).argmin())
        passed_s = 1e-9 * (frame.stamp_ns - self._stamp_ns)
        if (
            abs(int(samples.stamp_ns[nearest]) - frame.stamp_ns) > MAX_APART_NS
            or abs(passed_s - self.age_s) > MAX_CLOCK_S
        ):
            return None
        now = Pose(*samples.values[nearest].tolist())
        way_m = was.distance_to(now)
        begun_anew = math.hypot(now.x, now.y) < min(NEAR_ORIGIN_M, way_m)
        return None if begun_anew or way_m > MAX_SPEED_M_S * passed_s else was.inverse().compose(now)


def resume(path: Path, localizer: Localizer) -> str:
    """Start a localizer where the file says that the robot was; what is to be said of it.

    Raises InputError for a file that is none, or can't be written; one that is not there begins with nothing.
    """
    if not os.access(path if path.exists() else path.absolute().parent, os.W_OK):
        raise InputError(f"--state {path}: cannot be written")
    if not path.exists():
        return f"{path}: written from now on"
    try:
        state = json.loads(read_text(path, MAX_BYTES))
        resumed = Resumption(state)
        age_s = resumed.age_s
        if state["field"] != localizer.field.name or age_s > MAX_AGE_S:
            return f"{path}: of another field or more than an hour old; begins with nothing"
        localizer.resume(resumed.prior, state["camera_errors"])
        x, y, _ = state["poses"][0]["pose"]
    except (InputError, ValueError, KeyError, IndexError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(f"--state {path}: is no state of `touchline live` ({error}); delete it") from None
    return f"{path}: goes on from {age_s:.0f} s ago, x {x:.2f} m, y {y:.2f} m"


def prior_of(poses: list[dict[str, Any]], age_s: float, moved: Pose | None = None) -> Prior:
    """The robot stands where it was, went on, or was carried off: the longer ago, the likelier. moved: as its odometry
    says, if that has gone on.
    """
    there = math.exp(-age_s / STILL_THERE_S)
    rest = 1.0 if moved is None else ELSE
    drift = _spread(0.1 + DRIFT_M_S * age_s, DRIFT_RAD_S * age_s)
    ways = [_spread(speed * age_s, TURN_RAD_S * age_s) for speed in SPEEDS_M_S]
    found: list[WeightedPose] = []
    for one in poses[:MAX_POSES]:
        pose, weight = Pose(*map(float, one["pose"])), min(float(one["probability"]), 1.0) * there
        covariance = np.reshape(np.array(one["covariance"], dtype=np.float64), (3, 3)) + BLURRED
        found += [WeightedPose(pose, covariance, STOOD * rest * weight)]
        found += [WeightedPose(pose, covariance + went, WENT_ON * rest * weight) for went in ways]
        if moved is not None:
            found += [WeightedPose(pose.compose(moved), covariance + drift, BY_ODOMETRY * weight)]
    return Prior(poses=tuple(found))


def _spread(position_m: float, turn_rad: float) -> FloatArray:
    """The covariance (3, 3) of so much, within bounds."""
    position_m, turn_rad = min(position_m, MAX_DEVIATION_M), min(turn_rad, MAX_DEVIATION_RAD)
    return np.diag(np.square([position_m, position_m, turn_rad]))
