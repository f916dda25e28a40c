"""What was seen and measured as the messages of robot teams: the way back from `touchline.sources.bags.team_features`.

Covariances, colours, middles of goals and poles have no place in them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from drives import Drive

from touchline.sources.bags.roles import DETECTION_TOPIC
from touchline.sources.bags.standard import BASE, StandardMessages
from touchline.sources.bags.with_rosbags import Codec
from touchline.sources.bags.writing import McapWriter
from touchline.types import CrossingKind, Crossings, LandmarkKind, Observation, Samples

EPOCH_NS = 1_763_780_000_000_000_000  # the clock of the bags
LATE_NS, JITTER_NS = 60_000_000, 3_000_000  # of the vision; of what comes without a stamp

SEGMENTS_TOPIC = "/booster_soccer/line_segments"
ODOMETER_TOPIC, HEAD_TOPIC, LOW_STATE_TOPIC = "/odometer_state", "/head_pose", "/low_state"
MARKINGS_TOPIC, GOALPOSTS_TOPIC = "/soccer_vision/markings", "/soccer_vision/goalposts"
BOOSTER_TYPES = {
    DETECTION_TOPIC: "vision_interface/msg/Detections",
    SEGMENTS_TOPIC: "vision_interface/msg/LineSegments",
    ODOMETER_TOPIC: "booster_interface/msg/Odometer",
    LOW_STATE_TOPIC: "booster_interface/msg/LowState",
}
SOCCER_VISION_TYPES = {
    MARKINGS_TOPIC: "soccer_vision_3d_msgs/msg/MarkingArray",
    GOALPOSTS_TOPIC: "soccer_vision_3d_msgs/msg/GoalpostArray",
}
_LABELS = {"L": "LCross", "T": "TCross", "X": "XCross", "penalty_mark": "PenaltyPoint", "post": "Goalpost"}
_ARMS_RAD = {
    CrossingKind.L: (-0.25 * math.pi, 0.25 * math.pi),
    CrossingKind.T: (0.0, 0.5 * math.pi, -0.5 * math.pi),
    CrossingKind.X: (0.0, 0.5 * math.pi, math.pi, -0.5 * math.pi),
}
_MARK_M, _CIRCLE_M = 0.1, 1.5  # diameters, of which only the order counts
_POST_M = (0.1, 0.1, 1.2)


class TeamMessage(NamedTuple):
    """topic, type, and the message itself."""

    topic: str
    kind: str
    message: Any


class TeamMessages:
    """Makes messages of observations in the robot frame; stamps are in nanoseconds."""

    def __init__(self, codec: Codec) -> None:
        self._make, self._standard = codec.make, StandardMessages(codec)

    def booster(self, stamp_ns: int, seen: Observation) -> Iterator[TeamMessage]:
        """What the vision of Booster's robots publishes of an image."""
        header = self._standard.header(stamp_ns, BASE)
        crossings, landmarks = seen.crossings, seen.landmarks
        objects = [
            self._object(_LABELS[str(kind)], place, sure)
            for features in (crossings, landmarks)
            for kind, place, sure in zip(features.kinds, features.positions_m, features.confidences, strict=True)
            if str(kind) in _LABELS
        ]
        empty = np.zeros(0, dtype=np.float32)
        kind = BOOSTER_TYPES[DETECTION_TOPIC]
        found = self._make(
            kind, header=header, detected_objects=objects, radar_x=empty, radar_y=empty, corner_pos=empty
        )
        yield TeamMessage(DETECTION_TOPIC, kind, found)
        kind, ends = BOOSTER_TYPES[SEGMENTS_TOPIC], seen.lines.ends_m.ravel().astype(np.float32)
        lines = self._make(kind, header=header, coordinates=ends, coordinates_uv=np.zeros(len(ends), dtype=np.float32))
        yield TeamMessage(SEGMENTS_TOPIC, kind, lines)

    def odometer(self, x: float, y: float, theta: float) -> TeamMessage:
        """booster_interface/Odometer, which has no stamp."""
        kind = BOOSTER_TYPES[ODOMETER_TOPIC]
        return TeamMessage(ODOMETER_TOPIC, kind, self._make(kind, x=x, y=y, theta=theta))

    def low_state(self, attitude: Sequence[float], rates: Sequence[float]) -> TeamMessage:
        """booster_interface/LowState of roll, pitch, yaw (rad) and rates (rad/s), which has no stamp, and no motors."""
        kind = BOOSTER_TYPES[LOW_STATE_TOPIC]
        imu = self._make(
            "booster_interface/msg/ImuState",
            rpy=np.array(attitude, dtype=np.float32),
            gyro=np.array(rates, dtype=np.float32),
            acc=np.zeros(3, dtype=np.float32),
        )
        return TeamMessage(
            LOW_STATE_TOPIC, kind, self._make(kind, imu_state=imu, motor_state_parallel=[], motor_state_serial=[])
        )

    def soccer_vision(self, stamp_ns: int, seen: Observation) -> Iterator[TeamMessage]:
        """The messages of soccer_vision_3d_msgs, in the base frame."""
        make, header, landmarks = self._make, self._standard.header(stamp_ns, BASE), seen.landmarks
        package, kind = "soccer_vision_3d_msgs/msg", SOCCER_VISION_TYPES[MARKINGS_TOPIC]
        placed = list(zip(landmarks.kinds, landmarks.positions_m, landmarks.confidences, strict=True))
        sizes = {LandmarkKind.PENALTY_MARK: _MARK_M, LandmarkKind.CIRCLE: _CIRCLE_M}
        ellipses = [
            make(
                f"{package}/MarkingEllipse", diameter=size, center=self._pose(place), confidence=self._confidence(sure)
            )
            for each, place, sure in placed
            if (size := sizes.get(LandmarkKind(str(each))))
        ]
        segments = [
            make(
                f"{package}/MarkingSegment",
                start=self._point(ends[0]),
                end=self._point(ends[1]),
                confidence=self._confidence(sure),
            )
            for ends, sure in zip(seen.lines.ends_m, seen.lines.confidences, strict=True)
        ]
        crossings = self._crossings(seen.crossings)
        markings = make(kind, header=header, ellipses=ellipses, intersections=crossings, segments=segments)
        yield TeamMessage(MARKINGS_TOPIC, kind, markings)
        attributes = make("soccer_vision_attribute_msgs/msg/Goalpost", side=0, team=0)
        size = make("geometry_msgs/msg/Vector3", **dict(zip("xyz", _POST_M, strict=True)))
        posts = [
            make(
                f"{package}/Goalpost",
                bb=make("vision_msgs/msg/BoundingBox3D", center=self._pose(place), size=size),
                attributes=attributes,
                confidence=self._confidence(sure),
            )
            for each, place, sure in placed
            if each == LandmarkKind.POST
        ]
        kind = SOCCER_VISION_TYPES[GOALPOSTS_TOPIC]
        yield TeamMessage(GOALPOSTS_TOPIC, kind, make(kind, header=header, posts=posts))

    def _crossings(self, crossings: Crossings) -> list[Any]:
        """soccer_vision_3d_msgs/MarkingIntersection of each; without rays where the orientation is unknown."""
        made = []
        for kind, place, turn, sure in zip(
            crossings.kinds, crossings.positions_m, crossings.orientations_rad, crossings.confidences, strict=True
        ):
            arms = _ARMS_RAD[CrossingKind(str(kind))]
            angles = [float(turn) + arm for arm in arms] if math.isfinite(turn) else []
            vector = "geometry_msgs/msg/Vector3"
            made.append(
                self._make(
                    "soccer_vision_3d_msgs/msg/MarkingIntersection",
                    center=self._pose(place),
                    num_rays=len(arms),
                    rays=[self._make(vector, x=math.cos(angle), y=math.sin(angle), z=0.0) for angle in angles],
                    confidence=self._confidence(sure),
                )
            )
        return made

    def _object(self, label: str, place: Any, sure: float) -> Any:
        at, empty = np.array([*place, 0.0], dtype=np.float32), np.zeros(0, dtype=np.float32)
        box = dict.fromkeys(("xmin", "ymin", "xmax", "ymax"), 0)
        return self._make(
            "vision_interface/msg/DetectedObject",
            label=label,
            color="",
            confidence=100.0 * float(sure),
            **box,
            target_uv=empty,
            received_pos=empty,
            position=at,
            position_projection=at,
            position_cam=empty,
            position_confidence=0,
        )

    def _point(self, place: Any) -> Any:
        return self._make("geometry_msgs/msg/Point", x=float(place[0]), y=float(place[1]), z=0.0)

    def _pose(self, place: Any) -> Any:
        upright = self._make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
        return self._make("geometry_msgs/msg/Pose", position=self._point(place), orientation=upright)

    def _confidence(self, sure: float) -> Any:
        return self._make("soccer_vision_attribute_msgs/msg/Confidence", confidence=float(sure))


def write_bag(walked: Drive, path: Path, seed: int) -> None:
    """A walk as an MCAP file of the robot's own topics."""
    codec, rng = Codec(), np.random.default_rng([seed, 41])
    make, writer = TeamMessages(codec), McapWriter(path, codec)
    found: list[tuple[int, str, str, Any]] = []
    for frame in walked.frames:
        stamp_ns = EPOCH_NS + frame.stamp_ns
        seen = frame.observation or Observation(frame.stamp_ns)
        for each in make.booster(stamp_ns, seen):
            found.append((stamp_ns + LATE_NS, *each))
        for t, row in _rows(frame.odometry):
            found.append((_received(t, rng), *make.odometer(*row)))
        tilt = dict(_rows(frame.tilt))
        for t, rates in _rows(frame.gyro):
            found.append((_received(t, rng), *make.low_state((*tilt.get(t, (0.0, 0.0)), 0.0), rates)))
    for log_ns, topic, kind, message in sorted(found, key=lambda each: each[0]):
        writer.write(topic, kind, log_ns, codec.encode(kind, message))
    writer.close()


def _received(stamp_ns: int, rng: np.random.Generator) -> int:
    return EPOCH_NS + stamp_ns + round(rng.exponential(JITTER_NS))


def _rows(samples: Samples | None) -> Iterator[tuple[int, list[float]]]:
    if samples is not None:
        yield from zip(samples.stamp_ns.tolist(), samples.values.tolist(), strict=True)
