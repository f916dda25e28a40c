"""Everything upright as rows of one table: clutter, goals with nets, poles, robots, balls; and which of it lies where.

Columns (K, 14) float64: kind (0 cylinder, 1 box, 2 ball, 3 net), x, y of the middle, cos and sin of the heading, half
length (or radius), half width, bottom, top, bounding radius, first colour, number of bands (net: mesh in m), decal colour
or -1 (net: thread in m), share of the light of open ground. Colours index the palette (C, 3).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
import numpy.typing as npt
from numba import njit

from touchline.field import FieldModel
from touchline.geometry import FloatArray
from touchline.simulation.world import PAINTS, BallActor, Block, Colour, RobotActor, robot_blocks

CYLINDER, BOX, BALL, NET = 0, 1, 2, 3
COLUMNS = 14
SECTORS = 512
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
def first_bodies(
    starts: npt.NDArray[np.int32], items: npt.NDArray[np.int16], near: FloatArray
) -> npt.NDArray[np.float64]:
    """Distance (m) of the first body in each sector; negative where the camera stands within its reach."""
    first = np.full(len(starts) - 1, 1e6)
    for n in range(len(first)):
        if starts[n + 1] > starts[n]:
            first[n] = near[items[starts[n]]]
    return first


@njit(cache=True, error_model="numpy")
def sort_into_sectors(
    solids: FloatArray, x: float, y: float, slack: float
) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int16], FloatArray]:
    """Which bodies a ray may meet, by its direction: a list for each of 512 sectors around (x, y), nearest first.

    slack: how far (m) rays may start from (x, y). Returns starts (513,), items and each body's near distance (K,) in m.
    """
    count = len(solids)
    near = np.empty(count)
    first = np.zeros(count, dtype=np.int64)
    span = np.zeros(count, dtype=np.int64)
    for k in range(count):
        ex, ey = solids[k, 1] - x, solids[k, 2] - y
        distance = np.sqrt(ex * ex + ey * ey)
        reach = solids[k, 9] + slack
        near[k] = distance - reach
        if distance <= reach * 1.0001:
            span[k] = SECTORS
            continue
        half = np.arcsin(reach / distance)
        bearing = np.arctan2(ey, ex)
        low, high = bearing - half, bearing + half
        start = int(turn_number(np.cos(low), np.sin(low)) * (SECTORS / 4.0))
        end = int(turn_number(np.cos(high), np.sin(high)) * (SECTORS / 4.0))
        first[k] = start
        span[k] = min((end - start) % SECTORS + 1, SECTORS)
    starts = np.zeros(SECTORS + 1, dtype=np.int32)
    for k in range(count):
        for n in range(span[k]):
            starts[(first[k] + n) % SECTORS + 1] += 1
    for n in range(SECTORS):
        starts[n + 1] += starts[n]
    items = np.empty(starts[SECTORS], dtype=np.int16)
    fill = starts[:-1].copy()
    for k in np.argsort(near):
        for n in range(span[k]):
            sector = (first[k] + n) % SECTORS
            items[fill[sector]] = k
            fill[sector] += 1
    return starts, items, near
