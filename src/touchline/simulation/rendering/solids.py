"""Everything upright as rows of one table: clutter, goals with nets, poles, robots, balls; and which of it lies where.

Columns (K, 14) float64: kind (0 cylinder, 1 box, 2 ball, 3 net), x, y of the middle, cos and sin of the heading, half
length (or radius), half width, bottom, top, bounding radius, first colour, number of bands (net: mesh in m), decal
colour or -1 (net: thread in m), share of the light of open ground. Colours index the palette (C, 3).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
import numpy.typing as npt
from numba import njit

from touchline.field import FieldModel
from touchline.geometry import FloatArray
from touchline.simulation.world.world import PAINTS, BallActor, Block, Colour, RobotActor, robot_blocks

CYLINDER, BOX, BALL, NET = 0, 1, 2, 3
COLUMNS = 14
NET_MESH_M, NET_THREAD_M = 0.12, 0.011


class Palette:
    """Colours by number; bands of one body are neighbours."""

    def __init__(self) -> None:
        self.rows: list[Colour] = []

    def add(self, colours: Iterable[Colour]) -> int:
        """The number of the first of some colours, appended together."""
        first = len(self.rows)
        self.rows += list(colours)
        return first

    def array(self) -> npt.NDArray[np.float64]:
        """All colours (C, 3)."""
        return np.array(self.rows, dtype=np.float64).reshape(-1, 3)


def block_row(block: Block, palette: Palette) -> list[float]:
    """The table row of one block."""
    round_body = block.kind == "cylinder"
    half_length = 0.5 * block.length
    half_width = half_length if round_body else 0.5 * block.width
    decal = -1 if block.decal is None else palette.add([block.decal])
    first = palette.add(block.bands)
    radius = half_length if round_body else math.hypot(half_length, half_width)
    return [
        float(CYLINDER if round_body else BOX),
        block.x,
        block.y,
        math.cos(block.heading),
        math.sin(block.heading),
        half_length,
        half_width,
        block.bottom,
        block.top,
        radius,
        float(first),
        float(len(block.bands)),
        float(decal),
        1.0,
    ]


def field_blocks(field: FieldModel) -> list[Block]:
    """Posts, crossbars and ground bars of the goals, and the poles, as blocks."""
    blocks = []
    for goal in field.goals:
        colour = PAINTS.get(goal.color, PAINTS["white"])
        kind = "cylinder" if goal.post_shape == "round" else "box"
        low, high, width = min(goal.y_posts), max(goal.y_posts), goal.post_width
        for y in goal.y_posts:
            blocks.append(Block(kind, goal.x, y, 0.0, width, width, 0.0, goal.height, (colour,)))
        middle, span = 0.5 * (low + high), high - low
        bar = Block("box", goal.x, middle, 0.0, width, span, goal.height - width, goal.height, (colour,))
        back = goal.x + math.copysign(goal.depth, goal.x)
        ground = Block("box", back, middle, 0.0, 0.05, span, 0.0, 0.05, (colour,))
        blocks += [bar, ground]
    for pole in field.poles:
        bands = tuple(PAINTS.get(name, PAINTS["white"]) for name in pole.bands_from_ground)
        blocks.append(Block("cylinder", pole.x, pole.y, 0.0, pole.diameter, pole.diameter, 0.0, pole.height, bands))
    return blocks


def net_rows(field: FieldModel, palette: Palette) -> list[list[float]]:
    """Upright nets behind and beside each goal: thin panels of which only the threads are seen."""
    rows = []
    thread = float(palette.add([PAINTS["white"]]))
    for goal in field.goals:
        low, high = min(goal.y_posts), max(goal.y_posts)
        depth = math.copysign(goal.depth, goal.x)
        panels = [(goal.x + depth, 0.5 * (low + high), 0.0, 1.0, 0.5 * (high - low))]
        panels += [(goal.x + 0.5 * depth, y, 1.0, 0.0, 0.5 * goal.depth) for y in (low, high)]
        for x, y, c, s, half in panels:
            rows.append(
                [float(NET), x, y, c, s, half, 0.0, 0.0, goal.height, half, thread, NET_MESH_M, NET_THREAD_M, 1.0]
            )
    return rows


def ball_row(ball: BallActor, palette: Palette) -> list[float]:
    """The table row of a ball lying on the ground."""
    first = float(palette.add([ball.colour]))
    r = ball.radius
    return [float(BALL), ball.x, ball.y, 1.0, 0.0, r, r, 0.0, 2.0 * r, r, first, 1.0, -1.0, 1.0]


def robot_rows(robots: Sequence[RobotActor], palette: Palette) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """Rows of all robots' bodies in their own frames, and the robot that each belongs to."""
    rows, owners = [], []
    for number, robot in enumerate(robots):
        for block in robot_blocks(robot):
            rows.append(block_row(block, palette))
            owners.append(number)
    return np.array(rows, dtype=np.float64).reshape(-1, COLUMNS), np.array(owners, dtype=np.int64)


def placed(rows: FloatArray, poses: FloatArray) -> FloatArray:
    """Rows of bodies moved from their own frames to field poses x, y, heading (one per row)."""
    moved = rows.copy()
    if len(rows) == 0:
        return moved
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    moved[:, 1] = poses[:, 0] + c * rows[:, 1] - s * rows[:, 2]
    moved[:, 2] = poses[:, 1] + s * rows[:, 1] + c * rows[:, 2]
    moved[:, 3] = c * rows[:, 3] - s * rows[:, 4]
    moved[:, 4] = s * rows[:, 3] + c * rows[:, 4]
    return moved


@njit(cache=True, error_model="numpy", inline="always")
def turn_number(x: float, y: float) -> float:
    """A number in [0, 4) that grows with the direction of (x, y), counter-clockwise from x; cheaper than an angle."""
    share = x / (abs(x) + abs(y) + 1e-300)
    return 1.0 - share if y >= 0.0 else 3.0 + share


@njit(cache=True, error_model="numpy")
def sort_into_cells(
    solids: FloatArray,
    x: float,
    y: float,
    aside: float,
    slack: float,
    low: float,
    high: float,
    angle: float,
    sectors: int,
    bins: int,
) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int16], FloatArray]:
    """Which bodies a ray may meet, by its direction: a list for each of sectors x bins cells, nearest first.

    Rays start within slack (m) of (x, y), no more than aside (m) beside it as they see it, and at a height between low
    and high. Sectors divide the full turn (`turn_number`), bins the rise per metre r as r / (1 + |r|) in [-1, 1).
    Lists also hold what lies within `angle` (rad) beside the cell. Returns starts (sectors * bins + 1,), items and each
    body's near distance (K,) in m.
    """  # fmt: skip
    near = np.empty(len(solids))
    first, span = np.zeros(len(solids), dtype=np.int64), np.zeros(len(solids), dtype=np.int64)
    bottom, top = np.zeros(len(solids), dtype=np.int64), np.zeros(len(solids), dtype=np.int64)
    starts = np.zeros(sectors * bins + 1, dtype=np.int32)
    for k in range(len(solids)):
        distance = np.hypot(solids[k, 1] - x, solids[k, 2] - y)
        near[k] = distance - solids[k, 9] - slack
        below, above = _rises(solids[k], max(near[k], 0.01), distance + solids[k, 9] + slack, low, high)
        steep = min(max(abs(below), abs(above)), 20.0)
        first[k], span[k] = _sectors_of(
            solids[k, 1] - x, solids[k, 2] - y, solids[k, 9] + aside, angle * np.sqrt(1.0 + steep * steep), sectors
        )
        bottom[k] = max(int((1.0 + below / (1.0 + abs(below)) - angle) * 0.5 * bins), 0)
        top[k] = min(int((1.0 + above / (1.0 + abs(above)) + angle) * 0.5 * bins), bins - 1)
        for n in range(span[k]):
            cell = (first[k] + n) % sectors * bins
            for level in range(bottom[k], top[k] + 1):
                starts[cell + level + 1] += 1
    for n in range(sectors * bins):
        starts[n + 1] += starts[n]
    items = np.empty(starts[-1], dtype=np.int16)
    fill = starts[:-1].copy()
    for k in np.argsort(near):
        for n in range(span[k]):
            cell = (first[k] + n) % sectors * bins
            for level in range(bottom[k], top[k] + 1):
                items[fill[cell + level]] = k
                fill[cell + level] += 1
    return starts, items, near


@njit(cache=True, error_model="numpy")
def _rises(solid: FloatArray, nearest: float, farthest: float, low: float, high: float) -> tuple[float, float]:
    """Least and greatest height gained per metre of rays from between two heights (m) that meet a body."""
    below, above = solid[7] - high, solid[8] - low
    return below / (nearest if below < 0.0 else farthest), above / (nearest if above > 0.0 else farthest)


@njit(cache=True, error_model="numpy")
def _sectors_of(ex: float, ey: float, reach: float, angle: float, sectors: int) -> tuple[int, int]:
    """First sector and number of sectors that a round body at (ex, ey) takes up, with an angle (rad) on each side."""
    distance = np.hypot(ex, ey)
    if distance <= reach * 1.0001:
        return 0, sectors
    half = np.arcsin(reach / distance) + angle + 1e-4
    if half > 3.0:
        return 0, sectors
    bearing = np.arctan2(ey, ex)
    low, high = bearing - half, bearing + half
    start = int(turn_number(np.cos(low), np.sin(low)) * (0.25 * sectors))
    end = int(turn_number(np.cos(high), np.sin(high)) * (0.25 * sectors))
    span = (end - start) % sectors + 1
    return start, sectors if half > 1.5 and span < sectors // 4 else span
