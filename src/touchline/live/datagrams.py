"""The protocol of `touchline live` over UDP: every datagram is one JSON object on one line, and bytes behind it.

To Touchline (stamps in ns of the robot's clock; m, rad; the robot's or the field's frame as in a recording):

    {"kind": "odometry", "stamp_ns": 1, "values": [x, y, theta]}      also wheels, gyro, compass, attitude
    {"kind": "image", "stamp_ns": 1, "part": 0, "parts": 1}           and behind the line bytes of a JPEG or PNG file;
                                                                      "camera": [x, y, z, roll, pitch, yaw], if it moves
    {"kind": "points", "stamp_ns": 1, "points": [[x, y], ...]}        line points, robot frame
    {"kind": "seen", "stamp_ns": 1, "rows": [{"kind": "L", "x_m": 1, ...}, ...]}   as the rows of observations.csv
    {"kind": "start", "pose": [x, y, theta], "covariance": [9 numbers]}   or "own_half": true, or nothing
    {"kind": "evidence", "source": "mate", "probability": 0.9, "place_m": [x, y], "seen_m": [x, y], "spread_m": 0.5}
                                                                      or "own_half": true or false instead of places;
                                                                      "message": 7, its number: repeated, it counts once
    {"kind": "game_state", "stamp_ns": 1, "phase": "playing", "penalty": "", "first_half": true}

From Touchline:

    {"kind": "pose", "stamp_ns": 1, "x": 0, "y": 0, "theta": 0, "covariance": [9 numbers], "status": "tracking",
     "reason": "", "protection_m": 0.06 or null, "protection_rad": 0.02 or null, "statistics": {"motion": 0.1},
     "image": true, "map_from_odom": [x, y, theta] or null, "probability": 1 or null, "end_probability": 1 or null,
     "residual_m": 0.01 or null, "points": 100, "mode": "" , "dropped": 0, "after_s": 0.003,
     "problems": [{"code": "images-mirrored", "sentence": "images are mirrored: ..."}],
     "perception_ms": 2.1, "localization_ms": 0.5, "look": {"bearing_rad": 0.5, "features": ["T crossing at 0.0, 3.0"]}}
                                                                      "look" of an image's pose alone, else null

An image of more than PART_BYTES comes in parts, numbered from 0, in any order.
"""

import json
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from touchline.errors import InputError
from touchline.geometry import Pose, Pose3
from touchline.live.heard import SENSORS, Heard, Published, Reading, Sight, Start, count_refused
from touchline.sources.observations import HEADER, observation_of, observation_rows
from touchline.types import MAX_OBSERVED_POINTS, MAX_VALUE, Evidence, GameState, Look, Observation, points_at

PART_BYTES = 48_000  # behind the line of one datagram, which holds 65,507 at most
MAX_PARTS = 200
MAX_BYTES = 65_000  # of a datagram
_MAX_WAITING = 4  # images of which parts are missing
_MAX_STAMP_NS = 2**62
_AS_ESTIMATED = (
    *("stamp_ns", "status", "reason", "protection_m", "protection_rad", "statistics", "probability"),
    *("end_probability", "residual_m", "points", "problems", "perception_ms", "localization_ms"),
)


class Datagrams:
    """Datagrams to what was heard; keeps the parts of images until the last one has come."""

    def __init__(self) -> None:
        self._waiting: dict[tuple[int, int], dict[int, bytes]] = {}  # by stamp and number of parts
        self.refused: Counter[str] = Counter()

    def read(self, datagram: bytes) -> Heard | None:
        """What a datagram says; None if it says nothing yet, or nothing that can be used, which is counted."""
        line, _, behind = datagram.partition(b"\n")
        try:
            message = json.loads(line)
            if not isinstance(message, dict):
                raise InputError("no JSON object")
            return self._heard(message, behind)
        except (InputError, ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError) as error:
            count_refused(self.refused, f"a message that can't be used ({_short(error)})")
            return None

    def _heard(self, message: Mapping[str, Any], behind: bytes) -> Heard | None:
        kind = message.get("kind")
        if kind in SENSORS:
            return Reading(kind, _stamp(message), _numbers(message["values"], SENSORS[kind]))
        if kind == "image":
            return self._image(message, behind)
        if kind == "points":
            points = np.asarray(message["points"], dtype=np.float64)
            if points.size and (points.ndim != 2 or points.shape[1] != 2):
                raise InputError("points that are no pairs x, y")
            points = points.reshape(-1, 2)[:MAX_OBSERVED_POINTS]
            return _sight(message, observation=Observation(_stamp(message), points_at(points)))
        if kind == "seen":
            rows = [{str(key): _cell(value) for key, value in row.items()} for row in message["rows"]]
            return _sight(message, observation=observation_of(_stamp(message), rows[:MAX_OBSERVED_POINTS]))
        if kind == "start":
            return _start(message)
        if kind == "evidence":
            return _evidence(message)
        if kind == "game_state":
            phase, penalty, first_half = (message.get(key) for key in ("phase", "penalty", "first_half"))
            if type(penalty) not in (str, type(None)) or type(first_half) not in (bool, type(None)):
                raise InputError("a game state whose penalty is no text, or whose first_half is neither true nor false")
            return GameState(_stamp(message), str(phase), (penalty or "")[:100], first_half is not False)
        raise InputError("of no kind that is known")

    def _image(self, message: Mapping[str, Any], behind: bytes) -> Heard | None:
        stamp_ns, part, parts = _stamp(message), message.get("part", 0), message.get("parts", 1)
        if not (type(part) is int and type(parts) is int and 0 <= part < parts <= MAX_PARTS):
            raise InputError("parts of an image that are none")
        if parts == 1:
            return _sight(message, image=behind)
        found = self._waiting.setdefault((stamp_ns, parts), {})
        found[part] = behind
        if len(found) == parts:
            del self._waiting[stamp_ns, parts]
            return _sight(message, image=b"".join(found[k] for k in sorted(found)))
        while len(self._waiting) > _MAX_WAITING:
            del self._waiting[next(iter(self._waiting))]
            self.refused["an image of which parts are missing"] += 1
        return None


def image_datagrams(stamp_ns: int, data: bytes, camera: Pose3 | None = None) -> Iterator[bytes]:
    """The datagrams of an image file's content."""
    pieces = [data[at : at + PART_BYTES] for at in range(0, len(data), PART_BYTES)] or [b""]
    for part, piece in enumerate(pieces):
        message = {"kind": "image", "stamp_ns": stamp_ns, "part": part, "parts": len(pieces)}
        yield _line({**message, **_camera(camera)}) + piece


def seen_datagram(observation: Observation, camera: Pose3 | None = None, most_bytes: int = MAX_BYTES) -> bytes:
    """The datagram of what a detector found. Of what does not fit every other row is left out."""
    columns = HEADER.split(",")[1:]
    rows = [dict(zip(columns, row.split(",")[1:], strict=True)) for row in observation_rows(observation)]
    kept = [{key: cell for key, cell in row.items() if cell} for row in rows]
    message = {"kind": "seen", "stamp_ns": observation.stamp_ns, **_camera(camera)}
    line = _line({**message, "rows": kept})
    while len(line) > most_bytes:
        kept = kept[::2]
        line = _line({**message, "rows": kept})
    return line


def reading_datagram(reading: Reading) -> bytes:
    """The datagram of a sensor's sample."""
    return _line({"kind": reading.sensor, "stamp_ns": reading.stamp_ns, "values": list(reading.values)})


def published_datagram(published: Published) -> bytes:
    """The datagram of an estimate."""
    e = published.estimate
    covariance = np.asarray(e.covariance).ravel()
    tree = e.to_dict()
    return _line(
        {
            "kind": "pose",
            **dict(zip(("x", "y", "theta"), e.pose, strict=True)),
            "covariance": covariance.tolist() if np.isfinite(covariance).all() else None,
            "image": published.image,
            "map_from_odom": None if published.map_from_odom is None else list(published.map_from_odom),
            "mode": tree["mode"] or "",
            "dropped": published.dropped,
            "after_s": round(published.after_s, 6),
            "look": _look(e.look) if published.image else None,
            **{name: tree[name] for name in _AS_ESTIMATED},
        }
    )


def _look(look: Look | None) -> dict[str, Any] | None:
    return None if look is None else {"bearing_rad": round(look.bearing_rad, 4), "features": list(look.features)}


def _camera(camera: Pose3 | None) -> dict[str, list[float]]:
    return {} if camera is None else {"camera": [*camera.translation_m.tolist(), *camera.roll_pitch_yaw()]}


def _line(message: Mapping[str, Any]) -> bytes:
    return json.dumps(message, separators=(",", ":")).encode() + b"\n"


def _sight(message: Mapping[str, Any], image: bytes | None = None, observation: Observation | None = None) -> Sight:
    camera = None
    if message.get("camera") is not None:
        x, y, z, roll, pitch, yaw = _numbers(message["camera"], 6)
        camera = Pose3.from_roll_pitch_yaw(roll, pitch, yaw, (x, y, z))
    return Sight(_stamp(message), time.monotonic(), image, observation, camera)


def _start(message: Mapping[str, Any]) -> Start:
    pose, covariance = message.get("pose"), message.get("covariance")
    unknown = set(message) - {"kind", "pose", "covariance", "own_half", "stamp_ns"}
    if unknown or message.get("own_half", False) not in (True, False):
        raise InputError("a start that says something else than pose, covariance, or own_half: true")
    return Start(
        None if pose is None else Pose(*_numbers(pose, 3)),
        None if covariance is None else np.reshape(_numbers(covariance, 9), (3, 3)),
        message.get("own_half") is True,
    )


def _evidence(message: Mapping[str, Any]) -> Evidence:
    fields = {"kind", "source", "probability", "own_half", "place_m", "seen_m", "spread_m", "stamp_ns", "message"}
    unknown = set(message) - fields
    if unknown or not isinstance(message["source"], str):
        raise InputError("evidence that says something else, or not by whom")
    places = {key: _numbers(message[key], 2) for key in ("place_m", "seen_m") if message.get(key) is not None}
    given = [key for key in ("probability", "spread_m") if message.get(key) is not None]
    numbers = {key: _numbers([message[key]], 1)[0] for key in given}
    own_half = message.get("own_half")
    if own_half not in (None, True, False):
        raise InputError("evidence whose own_half is neither true nor false")
    number = message.get("message")
    if number is not None and type(number) is not int:
        raise InputError("evidence whose message is no whole number")
    said: dict[str, Any] = {**places, **numbers}
    return Evidence(message["source"][:100], own_half=own_half, message=number, **said)


def _stamp(message: Mapping[str, Any]) -> int:
    stamp = message["stamp_ns"]
    if not isinstance(stamp, int) or isinstance(stamp, bool) or abs(stamp) >= _MAX_STAMP_NS:
        raise InputError("a stamp that is no whole number of nanoseconds")
    return stamp


def _numbers(given: Any, count: int) -> tuple[float, ...]:
    if not isinstance(given, list) or not all(type(value) in (int, float) for value in given):
        raise InputError(f"not {count} numbers")
    values = tuple(float(value) for value in given)
    if len(values) != count or not all(abs(value) < MAX_VALUE for value in values):
        raise InputError(f"not {count} numbers")
    return values


def _cell(value: Any) -> str:
    return "" if value is None else str(value)[:100]


def _short(error: Exception) -> str:
    return f"{type(error).__name__}" if not isinstance(error, InputError) else str(error)[:80]
