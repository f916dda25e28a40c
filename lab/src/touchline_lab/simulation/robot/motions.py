"""The track of a scenario's robot: its kind of motion, its kidnaps and its collisions."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from touchline.errors import InputError
from touchline.field import FieldModel
from touchline.geometry import BoolArray, FloatArray, IntArray, wrap_angles
from touchline_lab.simulation.robot.drive import DriveLimits, Jumps, drive_through
from touchline_lab.simulation.robot.match import CARRIED, Happening, lean_in_falls, make_match
from touchline_lab.simulation.robot.noise import drift
from touchline_lab.simulation.robot.track import STEP_S, Track
from touchline_lab.simulation.scenario import MotionSettings, Place, Scenario

_SHOVE_S = 0.15
_BESIDE_M = 0.8  # between the carpet's edge and the walls, less a robot's radius
_PASS_M = 0.5  # in a match the robot turns to its next aim this far from the last


def make_track(scenario: Scenario, field: FieldModel, rng: np.random.Generator) -> Track:
    """The true motion over the whole run. Raises InputError for places beyond the carpet."""
    rows = math.ceil(scenario.seconds / STEP_S) + 11  # beyond the last image by what interpolation may ask for
    place_rng, kidnap_rng, shove_rng, sway_rng, match_rng = rng.spawn(5)
    targets, dwell_s = targets_for(scenario.motion, field, place_rng)
    carried_rows, carried_to, covered, events = _kidnaps(scenario, field, rows, kidnap_rng)
    shoved, shove_events = _shoves(scenario, rows, shove_rng)
    motion = scenario.motion
    top, pass_m = motion.turn_rad_s, _PASS_M if motion.kind == "match" else 0.0
    limits = DriveLimits(motion.speed_m_s, motion.acceleration_m_s2, top, 3.0 * top, pass_m)
    game = scenario.game
    match = make_match(game.half_s, game.every_s, scenario.seconds, field, match_rng) if game.half_s else ()
    if match:
        poses, carried_rows = _played(match, rows, lambda jumps: drive_through(targets, dwell_s, limits, jumps))
        for each in match:
            covered[each.rows] = each.kind in CARRIED
        events = (*events, *({"t": round(each.start_s, 4), "kind": each.kind, "until_s": each.end_s} for each in match))
    else:
        poses = drive_through(targets, dwell_s, limits, Jumps(carried_rows, carried_to, shoved))
    carried = np.zeros_like(poses)
    for row in carried_rows:
        carried[row] = poses[row] - poses[row - 1]
        shoved[row] = 0.0
    attitude: FloatArray = np.zeros((rows, 2))
    if motion.kind in ("walk", "walk-in-place"):
        attitude = _sway(motion, poses, carried + shoved, sway_rng)
    lean_in_falls(attitude, match)
    _check_stays(poses, field)
    happened = sorted(events + shove_events, key=lambda event: float(event["t"]))
    return Track(poses, shoved, carried, attitude, covered, tuple(happened), match)


def _played(match: Sequence[Happening], rows: int, drive: Callable[[Jumps], FloatArray]) -> tuple[FloatArray, IntArray]:
    """Poses (rows, 3) of a robot that goes nowhere while something happens to it, and at which rows it is moved."""
    stands = np.zeros(rows, dtype=np.bool_)
    for each in match:
        stands[each.rows] = True
    index = np.cumsum(~stands) - 1  # the step of its own way at each row
    moved = [each for each in match if each.to is not None or each.moved is not None]
    at = [(each.rows.start + each.rows.stop) // 2 for each in moved]
    to, still = np.zeros((len(moved), 3)), np.zeros((int(index[-1]) + 1, 3))
    for k, each in enumerate(moved):  # a fall begins where the robot is by then
        here = drive(Jumps(index[at[:k]] + 1, to[:k], still))[index[each.rows.start]]
        to[k] = here + each.moved if each.to is None else each.to
    poses = drive(Jumps(index[at] + 1, to, still))[index]
    for row, each, place in zip(at, moved, to, strict=True):
        poses[row : each.rows.stop] = place
    return poses, np.array(at, dtype=np.int64)


def targets_for(motion: MotionSettings, field: FieldModel, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Targets (M, 3) x, y (m), heading (rad), and the time (M,) to stand at each (s)."""
    makers: dict[str, Callable[[MotionSettings, FieldModel, np.random.Generator], FloatArray]] = {
        "stand": _standing,
        "walk-in-place": _standing,
        "turn": _turning,
        "waypoints": lambda m, f, r: _places(m.waypoints),
        "tracks": _straight_tracks,
        "tour": lambda *setting: _anywhere(motion.points, *setting),
        "match": lambda *setting: _anywhere(1000, *setting),  # so that a run repeats itself after many minutes only
        "walk": _walk,
    }
    targets = makers[motion.kind](motion, field, rng)
    _check_on_carpet("motion", targets, field)
    dwell_s = np.full(len(targets), motion.dwell_s)
    if motion.kind == "walk":
        dwell_s[1::2] = 0.0  # turned towards the next area, it walks off at once
    return targets, dwell_s


def _check_on_carpet(name: str, places: FloatArray, field: FieldModel) -> None:
    """InputError unless all places (N, 3) lie on the carpet."""
    half_x, half_y = 0.5 * field.length + field.border, 0.5 * field.width + field.border
    for x, y, _ in places:
        if not (abs(x) <= half_x and abs(y) <= half_y):
            raise InputError(
                f"{name}: the robot can't go to {x:g}, {y:g}: that is outside the carpet of "
                f"{2 * half_x:g} x {2 * half_y:g} m around the field {field.name}"
            )


def _check_stays(poses: FloatArray, field: FieldModel) -> None:
    """InputError where collisions push the robot (N, 3) off the carpet and into a wall."""
    beyond = np.abs(poses[:, :2]) > np.array([field.length, field.width]) * 0.5 + field.border + _BESIDE_M
    if beyond.any():
        row = int(np.argmax(beyond.any(axis=1)))
        raise InputError(
            f"disturbances: at {row * STEP_S:g} s a shove brings the robot to {poses[row, 0]:.1f}, {poses[row, 1]:.1f},"
            " into a wall of the hall; a smaller disturbances.shove_m or a larger motion.margin_m keeps it inside"
        )


def random_pose(field: FieldModel, margin_m: float, rng: np.random.Generator) -> FloatArray:
    """(3,) a pose anywhere on the field, margin_m inside its outer lines, with any heading."""
    half_x, half_y = _inside(field, margin_m)
    return np.array([rng.uniform(-half_x, half_x), rng.uniform(-half_y, half_y), rng.uniform(-math.pi, math.pi)])


def _inside(field: FieldModel, margin_m: float) -> tuple[float, float]:
    """Half the length and half the width of the field less a margin."""
    half_x, half_y = 0.5 * field.length - margin_m, 0.5 * field.width - margin_m
    if half_x <= 0.0 or half_y <= 0.0:
        raise InputError(f"motion.margin_m: a margin of {margin_m:g} m leaves nothing of the field {field.name}")
    return half_x, half_y


def _places(places: tuple[Place, ...]) -> FloatArray:
    table = np.array(places, dtype=np.float64).reshape(-1, 3)
    table[:, 2] = np.radians(table[:, 2])
    return table


def _standing(motion: MotionSettings, field: FieldModel, rng: np.random.Generator) -> FloatArray:
    pose = random_pose(field, motion.margin_m, rng)[np.newaxis]
    return _places((motion.pose,)) if motion.pose is not None else pose


def _turning(motion: MotionSettings, field: FieldModel, rng: np.random.Generator) -> FloatArray:
    """One place, `points` headings in even steps of a full turn."""
    targets = np.repeat(_standing(motion, field, rng), motion.points, axis=0)
    targets[:, 2] = wrap_angles(targets[:, 2] + 2.0 * math.pi / motion.points * np.arange(motion.points))
    return targets


def _straight_tracks(motion: MotionSettings, field: FieldModel, rng: np.random.Generator) -> FloatArray:
    """Up and down the field on parallel lines, as a robot is pushed along the seams of the carpet."""
    half_x, half_y = _inside(field, motion.margin_m)
    offsets = np.linspace(half_y, -half_y, motion.tracks) if motion.tracks > 1 else np.zeros(1)
    targets = []
    for index, y in enumerate(offsets):
        side = 1.0 if index % 2 == 0 else -1.0
        heading = 0.0 if side > 0 else math.pi
        targets += [(-side * half_x, y, heading), (side * half_x, y, heading)]
    return np.array(targets)


def _anywhere(count: int, motion: MotionSettings, field: FieldModel, rng: np.random.Generator) -> FloatArray:
    return np.array([random_pose(field, motion.margin_m, rng) for _ in range(count)])


def _walk(motion: MotionSettings, field: FieldModel, rng: np.random.Generator) -> FloatArray:
    """From area to area: turn towards the next one, walk there with the face ahead."""
    half_x, half_y = 0.3 * field.length, 0.27 * field.width
    areas = _places(motion.waypoints or tuple((half_x * sx, half_y * sy, 0.0) for sx, sy in _CORNERS))[:, :2]
    targets = []
    for here, there in zip(areas, np.roll(areas, -1, axis=0), strict=True):
        heading = math.atan2(there[1] - here[1], there[0] - here[0])
        targets += [(*here, heading), (*there, heading)]
    return np.array(targets)


_CORNERS = ((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0))


def _kidnaps(
    scenario: Scenario, field: FieldModel, rows: int, rng: np.random.Generator
) -> tuple[IntArray, FloatArray, BoolArray, tuple[dict[str, Any], ...]]:
    """Rows and places of kidnaps; the jump lies half an image period before the first image at the new place."""
    disturbances, period_s = scenario.disturbances, 1.0 / scenario.camera.rate_hz
    covered = np.zeros(rows, dtype=np.bool_)
    jump_rows: list[int] = []
    places: list[FloatArray] = []
    events: list[dict[str, Any]] = []
    given = _places(disturbances.kidnap_to)
    _check_on_carpet("disturbances.kidnap_to", given, field)
    images = round(disturbances.kidnap_every_s / period_s)
    first_new = images
    while disturbances.kidnap_every_s > 0.0 and first_new * period_s < scenario.seconds:
        jump_s = (first_new + 0.5) * period_s  # images are taken at (index + 1) periods
        row = round(jump_s / STEP_S)
        start_s = (first_new - disturbances.covered_images + 1) * period_s
        covered[max(round((start_s - 0.25 * period_s) / STEP_S), 0) : row] = True
        place = given[len(places) % len(given)] if len(given) else random_pose(field, scenario.motion.margin_m, rng)
        if row < rows:
            jump_rows.append(row)
            places.append(place)
            if disturbances.covered_images:
                events.append({"t": round(start_s, 4), "kind": "occluded", "frames": disturbances.covered_images})
            events.append({"t": round(jump_s, 4), "kind": "kidnap"})
        first_new += images
    return np.array(jump_rows, dtype=np.int64), np.array(places).reshape(-1, 3), covered, tuple(events)


def _shoves(scenario: Scenario, rows: int, rng: np.random.Generator) -> tuple[FloatArray, tuple[dict[str, Any], ...]]:
    """(N, 3) displacement by collisions in the step to each row, spread over 0.15 s each; and their events."""
    shoved = np.zeros((rows, 3))
    events: list[dict[str, Any]] = []
    disturbances = scenario.disturbances
    if disturbances.shove_every_s <= 0.0:
        return shoved, ()
    steps = round(_SHOVE_S / STEP_S)
    time_s = 1.0 + float(rng.exponential(disturbances.shove_every_s))
    while time_s + _SHOVE_S < scenario.seconds:
        row = round(time_s / STEP_S)
        direction, length = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(*disturbances.shove_m)
        turn = math.radians(disturbances.shove_deg) * rng.standard_normal()
        whole = np.array([length * math.cos(direction), length * math.sin(direction), turn])
        shoved[row : row + steps] = whole / steps
        events.append({"t": round(row * STEP_S, 4), "kind": "slip"})
        time_s += 1.0 + float(rng.exponential(disturbances.shove_every_s))
    return shoved, tuple(events)


def _sway(motion: MotionSettings, poses: FloatArray, jumps: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(N, 2) roll and pitch of a walking body: its stride, twice its stride in pitch, and slow uneven leaning.

    Proportions and uneven part as in a recording of a teen-size robot; all grow with the speed of walking or turning.
    """
    n = len(poses)
    steps = np.diff(poses, axis=0, prepend=poses[:1]) - jumps
    speed = np.hypot(steps[:, 0], steps[:, 1]) / STEP_S / motion.speed_m_s + 0.5 * np.abs(steps[:, 2]) / STEP_S
    if motion.kind == "walk-in-place":
        speed = np.ones(n)
    window = round(0.4 / STEP_S)
    effort = np.convolve(np.minimum(speed, 1.0), np.ones(window) / window, mode="same")[:n]
    phase = 2.0 * math.pi * motion.gait_hz * STEP_S * np.arange(n) + rng.uniform(0.0, 2.0 * math.pi)
    phase += drift(n, STEP_S, 0.6, 4.0, rng)
    size = math.radians(motion.sway_deg)
    uneven = np.stack([_smoothed(drift(n, STEP_S, 0.18 * size, 0.8, rng)) for _ in range(2)], axis=1)
    roll = size * np.sin(phase)
    pitch = size * (0.68 * np.sin(phase + 1.0) + 0.42 * np.sin(2.0 * phase + 0.4))
    return effort[:, np.newaxis] * (np.stack((roll, pitch), axis=1) + uneven)


def _smoothed(values: FloatArray) -> FloatArray:
    """Mean over a fifth of a second: a body has mass."""
    window = round(0.2 / STEP_S)
    return np.convolve(values, np.ones(window) / window, mode="same")
