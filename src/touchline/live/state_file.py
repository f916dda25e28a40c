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
from touchline.types import Estimate, Prior, Status, WeightedPose

EVERY_S = 1.0
MAX_AGE_S = 3600.0  # from which it tells nothing of the pose
# of a robot that went on while nothing was localised: with less a fast one was found at the wrong end
SPEED_M_S, TURN_RAD_S = 1.0, 1.5
MAX_DEVIATION_M, MAX_DEVIATION_RAD = 4.0, math.pi
STOOD, WENT_ON, STILL_THERE_S = 0.5, 0.4, 900.0  # weights at once; the time after which it was rather carried off
BLURRED = np.diag(np.square([0.05, 0.05, 0.03]))
MAX_POSES, MAX_BYTES = 4, 1_000_000


class StateFile:
    """Writes what is tracked once a second. The file is always whole: it is replaced, never written over."""

    def __init__(self, path: Path, localizer: Localizer) -> None:
        self._path, self._localizer, self._written_s = path, localizer, -math.inf
        self._writer: threading.Thread | None = None

    def take(self, estimate: Estimate) -> None:
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
        age_s = max(time.time() - float(state["unix_s"]), 0.0)
        prior = prior_of(state["poses"], age_s)
        if state["field"] != localizer.field.name or age_s > MAX_AGE_S:
            return f"{path}: of another field or more than an hour old; begins with nothing"
        localizer.resume(prior, state["camera_errors"])
        x, y, _ = prior.poses[0].pose
    except (InputError, ValueError, KeyError, IndexError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(f"--state {path}: is no state of `touchline live` ({error}); delete it") from None
    return f"{path}: goes on from {age_s:.0f} s ago, x {x:.2f} m, y {y:.2f} m"


def prior_of(poses: list[dict[str, Any]], age_s: float) -> Prior:
    """The robot stands where it was, went on, or was carried off: the longer ago, the likelier."""
    there = math.exp(-age_s / STILL_THERE_S)
    position_m, turn = min(SPEED_M_S * age_s, MAX_DEVIATION_M), min(TURN_RAD_S * age_s, MAX_DEVIATION_RAD)
    moved: FloatArray = np.diag(np.square([position_m, position_m, turn]))
    found: list[WeightedPose] = []
    for one in poses[:MAX_POSES]:
        covariance = np.reshape(np.array(one["covariance"], dtype=np.float64), (3, 3)) + BLURRED
        for share, spread in ((STOOD, 0.0), (WENT_ON, 1.0)):
            weight = min(float(one["probability"]), 1.0) * share * there
            found.append(WeightedPose(Pose(*map(float, one["pose"])), covariance + spread * moved, weight))
    return Prior(poses=tuple(found))
