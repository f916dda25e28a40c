"""The hall around a field, and the things in it from a seed: panels with posters, boxes, columns, people."""

import math
from dataclasses import replace

import numpy as np

from touchline.field import FieldModel
from touchline.geometry import FloatArray
from touchline_lab.simulation.world.lights import Lights, hall_lamps
from touchline_lab.simulation.world.world import PAINTS, Block, Colour, GroundMark, World

_PANELS = ("white", "light grey", "grey", "green", "blue", "red", "yellow", "cyan", "orange", "brown", "black")
_CLOTHES = ("red", "orange", "blue", "brown", "white", "green", "black", "yellow", "light grey")
_CABLE_STEP_M = 0.15
BESIDE_GAP_M = 2.0  # between the carpets of two fields


def hall_for(
    field_model: FieldModel, margin_m: float = 1.8, height_m: float = 6.0, aside_m: float = 0.0
) -> tuple[float, float, float]:
    """A hall whose walls stand margin_m beyond the carpet, those along the field aside_m farther off."""
    return (
        field_model.length + 2.0 * (field_model.border + margin_m),
        field_model.width + 2.0 * (field_model.border + margin_m + aside_m),
        height_m,
    )


def beside_lines(field_model: FieldModel) -> FloatArray:
    """(S, 4) lines x1, y1, x2, y2 of a like field to the left of this one, BESIDE_GAP_M between both carpets."""
    offset_m = field_model.width + 2.0 * field_model.border + BESIDE_GAP_M
    return field_model.segments + np.array([0.0, offset_m, 0.0, offset_m])


def field_beside(field_model: FieldModel, hall: tuple[float, float, float]) -> tuple[Block, ...]:
    """As much of the field beside this one as the hall has room for: its carpet and its lines, as thin slabs."""
    edge, wall = 0.5 * field_model.width + field_model.border + BESIDE_GAP_M, 0.5 * hall[1] - 0.05
    slabs = [Block("box", 0.0, 0.5 * (edge + wall), 0.0, hall[0] - 0.1, wall - edge, 0.0, 0.002, (PAINTS["carpet"],))]
    for x1, y1, x2, y2 in beside_lines(field_model):
        low, high = min(y1, y2), min(max(y1, y2), wall)
        if low > wall - field_model.line_width:
            continue
        x, y, across = 0.5 * float(x1 + x2), 0.5 * float(low + high), field_model.line_width
        length, width = max(float(abs(x2 - x1)), across), max(float(high - low), across)
        slabs.append(Block("box", x, y, 0.0, length, width, 0.002, 0.004, (PAINTS["white"],)))
    return tuple(slabs)


def stands(hall: tuple[float, float, float], rng: np.random.Generator) -> tuple[Block, ...]:
    """Three white tiers along the southern wall, two thirds of its length, with people on them."""
    blocks = []
    for tier in range(3):
        y, top = -0.5 * hall[1] + 0.45 + 0.8 * (2 - tier), 0.35 + 0.35 * tier
        blocks.append(Block("box", 0.0, y, 0.0, 0.66 * hall[0], 0.8, 0.0, top, (PAINTS["white"],)))
        for x in np.arange(-0.31, 0.31, 0.09) * hall[0]:
            if rng.random() < 0.7:
                clothes = (_paint(rng, _CLOTHES), _paint(rng, _CLOTHES))
                blocks.append(Block("box", float(x), y, 0.0, 0.45, 0.3, top, top + 0.85, clothes))
    return tuple(blocks)


def default_world(
    field_model: FieldModel, seed: int = 0, lights: Lights | None = None, clutter: bool = True, aside_m: float = 0.0
) -> World:
    """A furnished hall around a field: lamps, walls, clutter from the seed; no robots, no balls."""
    hall = hall_for(field_model, 1.0 if field_model.length > 12.0 else 1.4, aside_m=aside_m)
    lights = lights or Lights(hall_lamps(*hall))
    world = World(field_model, hall, lights, board_height=0.12 if field_model.length > 12.0 else 0.0, seed=seed)
    if not clutter:
        return world
    return replace(world, clutter=tuple(random_clutter(hall, world.carpet, np.random.default_rng([seed, 11]))))


def random_clutter(
    hall: tuple[float, float, float], carpet: tuple[float, float], rng: np.random.Generator, share: float = 0.6
) -> list[Block]:
    """Blocks between carpet and walls that fill about `share` of the hall's circumference.

    hall: length, width, height; carpet: length, width (m). The same generator state gives the same things.
    """
    blocks: list[Block] = []
    gap = 0.5 * min(hall[0] - carpet[0], hall[1] - carpet[1])
    for side in range(4):
        along = hall[0] if side % 2 == 0 else hall[1]
        across = 0.5 * (hall[1] if side % 2 == 0 else hall[0])
        position = -0.5 * along + 0.4
        while position < 0.5 * along - 1.2:
            size = float(rng.uniform(0.35, 1.5))
            if rng.random() < share:
                depth = across - float(rng.uniform(0.15, max(0.2, 0.75 * gap)))
                blocks += _thing(rng, *_place(side, position + 0.5 * size, depth), side, size)
            position += size + float(rng.uniform(0.05, 0.5))
    return blocks


def cables(
    carpet: tuple[float, float], count: int, rng: np.random.Generator, colour: Colour = PAINTS["black"]
) -> tuple[GroundMark, ...]:
    """Cables on a carpet (length, width; m): each winds inwards from its edge for 2 to 6 m, 1.5 cm wide."""
    marks = []
    for _ in range(count):
        side = int(rng.integers(4))
        along, across = float(rng.uniform(-0.5, 0.5)) * carpet[side % 2], 0.5 * carpet[(side + 1) % 2]
        x, y = _place(side, along, across)
        heading, turn = math.atan2(-y, -x) + float(rng.uniform(-0.5, 0.5)), 0.0
        for _ in range(int(rng.uniform(2.0, 6.0) / _CABLE_STEP_M)):
            turn = 0.8 * turn + 0.25 * float(rng.standard_normal())
            heading += turn
            middle = x + 0.5 * _CABLE_STEP_M * math.cos(heading), y + 0.5 * _CABLE_STEP_M * math.sin(heading)
            marks.append(GroundMark(*middle, heading, _CABLE_STEP_M + 0.01, 0.015, colour))
            x, y = x + _CABLE_STEP_M * math.cos(heading), y + _CABLE_STEP_M * math.sin(heading)
    return tuple(marks)


def _place(side: int, along: float, across: float) -> tuple[float, float]:
    return [(along, across), (across, along), (along, -across), (-across, along)][side]


def _thing(rng: np.random.Generator, x: float, y: float, side: int, size: float) -> list[Block]:
    turn = float(rng.normal(0.0, 0.15)) + (0.5 * math.pi if side % 2 else 0.0)
    kind = rng.random()
    if kind < 0.45:  # a panel, often with something printed on it
        decal = _paint(rng, _PANELS) if rng.random() < 0.6 else None
        top = float(rng.uniform(0.5, 1.4))
        return [Block("box", x, y, turn, size, 0.05, 0.0, top, (_paint(rng, _PANELS),), decal)]
    if kind < 0.7:
        depth, top = float(rng.uniform(0.25, 0.5)), float(rng.uniform(0.3, 0.8))
        return [Block("box", x, y, turn, min(size, 0.8), depth, 0.0, top, (_paint(rng, _PANELS),))]
    if kind < 0.85:  # somebody watching
        legs, torso = _paint(rng, _CLOTHES), _paint(rng, _CLOTHES)
        skin = (0.45, 0.27, 0.18)
        return [
            Block("box", x, y, turn, 0.34, 0.2, 0.0, 0.85, (legs,)),
            Block("box", x, y, turn, 0.44, 0.24, 0.85, 1.45, (torso,)),
            Block("cylinder", x, y, turn, 0.2, 0.2, 1.48, 1.72, (skin,)),
        ]
    bands = tuple(_paint(rng, _PANELS) for _ in range(int(rng.integers(1, 4))))
    return [Block("cylinder", x, y, 0.0, 0.25, 0.25, 0.0, float(rng.uniform(0.6, 1.4)), bands)]


def _paint(rng: np.random.Generator, names: tuple[str, ...]) -> Colour:
    red, green, blue = PAINTS[names[int(rng.integers(len(names)))]]
    shade = float(rng.uniform(0.8, 1.15))
    return (min(0.9, red * shade), min(0.9, green * shade), min(0.9, blue * shade))
