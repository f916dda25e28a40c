"""Everything upright as rows of one table: clutter, goals with nets, poles, robots, balls; and which of it lies where.

Columns (K, 13) float64, see the numbers below: kind, x, y of the middle, cos and sin of the heading, half length (or
radius), half width, bottom, top, bounding radius, first colour, number of bands (net: mesh in m), decal colour or -1
(net: thread in m). Colours index the palette (C, 3).
"""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from touchline.field import FieldModel
from touchline.geometry import FloatArray, Int32Array, IntArray
from touchline_lab.simulation.rendering.casting import BINS, SECTORS
from touchline_lab.simulation.world.world import PAINTS, BallActor, Block, BlockKind, Colour, RobotActor, robot_blocks

CYLINDER, BOX, BALL, NET = 0, 1, 2, 3
KIND, X, Y, COS, SIN, HALF_LENGTH, HALF_WIDTH, BOTTOM, TOP, RADIUS, COLOUR, BANDS, DECAL = range(13)
COLUMNS = 13
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
        float(CYLINDER if round_body else BOX), block.x, block.y, math.cos(block.heading), math.sin(block.heading),
        half_length, half_width, block.bottom, block.top, radius, float(first), float(len(block.bands)), float(decal),
    ]  # fmt: skip


def field_blocks(field: FieldModel) -> list[Block]:
    """Posts, crossbars and ground bars of the goals, and the poles, as blocks."""
    blocks = []
    for goal in field.goals:
        colour = PAINTS.get(goal.color, PAINTS["white"])
        kind: BlockKind = "cylinder" if goal.post_shape == "round" else "box"
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
            rows.append([float(NET), x, y, c, s, half, 0.0, 0.0, goal.height, half, thread, NET_MESH_M, NET_THREAD_M])
    return rows


def ball_row(ball: BallActor, palette: Palette) -> list[float]:
    """The table row of a ball lying on the ground."""
    first = float(palette.add([ball.colour]))
    r = ball.radius
    return [float(BALL), ball.x, ball.y, 1.0, 0.0, r, r, 0.0, 2.0 * r, r, first, 1.0, -1.0]


def robot_rows(robots: Sequence[RobotActor], palette: Palette) -> tuple[FloatArray, IntArray]:
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


class Cells(NamedTuple):
    """Which bodies a ray may meet, by its direction: a list for each of SECTORS x BINS cells, nearest first.

    Sectors divide the full turn (`_turn_number`), bins the rise per metre r as r / (1 + |r|) in [-1, 1).
    starts (cells + 1,), items: numbers of bodies, cell by cell; near (K,): from how near on (m) each may be met.
    """

    starts: Int32Array
    items: npt.NDArray[np.int16]
    near: FloatArray


@njit(cache=True, error_model="numpy")
def sort_into_cells(
    solids: FloatArray, middle: FloatArray, reach: tuple[float, float], heights: tuple[float, float]
) -> Cells:
    """The cells of rays that start around a place.

    middle (2 or 3,): x, y (m). reach (m): how far rays pass beside it at most, and how far from it they start; heights
    (m): between which they start.
    """
    count, (aside, slack) = len(solids), reach
    near, spans = np.empty(count), np.zeros((count, 4), dtype=np.int64)  # first sector, sectors, first and last bin
    starts = np.zeros(SECTORS * BINS + 1, dtype=np.int32)
    for k in range(count):
        ex, ey = solids[k, X] - middle[0], solids[k, Y] - middle[1]
        distance, radius = np.hypot(ex, ey), solids[k, RADIUS]
        near[k] = distance - radius - slack
        nearest, farthest = max(near[k], 0.01), distance + radius + slack
        below, above = solids[k, BOTTOM] - heights[1], solids[k, TOP] - heights[0]
        below /= nearest if below < 0.0 else farthest
        above /= nearest if above > 0.0 else farthest
        spans[k, 0], spans[k, 1] = _sectors_of(ex, ey, radius + aside)
        spans[k, 2] = max(int((1.0 + below / (1.0 + abs(below)) - 1e-4) * 0.5 * BINS), 0)
        spans[k, 3] = min(int((1.0 + above / (1.0 + abs(above)) + 1e-4) * 0.5 * BINS), BINS - 1)
        for n in range(spans[k, 1]):
            cell = (spans[k, 0] + n) % SECTORS * BINS
            for level in range(spans[k, 2], spans[k, 3] + 1):
                starts[cell + level + 1] += 1
    for n in range(SECTORS * BINS):
        starts[n + 1] += starts[n]
    items, fill = np.empty(starts[-1], dtype=np.int16), starts[:-1].copy()
    for k in np.argsort(near):
        for n in range(spans[k, 1]):
            cell = (spans[k, 0] + n) % SECTORS * BINS
            for level in range(spans[k, 2], spans[k, 3] + 1):
                items[fill[cell + level]] = k
                fill[cell + level] += 1
    return Cells(starts, items, near)


@njit(cache=True, error_model="numpy")
def _turn_number(x: float, y: float) -> float:
    """A number in [0, 4) that grows with the direction of (x, y), counter-clockwise from x; cheaper than an angle."""
    part = x / (abs(x) + abs(y) + 1e-300)
    return 1.0 - part if y >= 0.0 else 3.0 + part


@njit(cache=True, error_model="numpy")
def _sectors_of(ex: float, ey: float, reach: float) -> tuple[int, int]:
    """First sector and number of sectors that a round body at (ex, ey) takes up."""
    distance = np.hypot(ex, ey)
    if distance <= reach * 1.0001:
        return 0, SECTORS
    half = np.arcsin(reach / distance) + 1e-4
    bearing = np.arctan2(ey, ex)
    low, high = bearing - half, bearing + half
    start = int(_turn_number(np.cos(low), np.sin(low)) * (0.25 * SECTORS))
    end = int(_turn_number(np.cos(high), np.sin(high)) * (0.25 * SECTORS))
    span = (end - start) % SECTORS + 1
    return start, SECTORS if half > 1.5 and span < SECTORS // 4 else span
