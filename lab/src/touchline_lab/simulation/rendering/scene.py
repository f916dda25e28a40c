"""A world as arrays, built once; what moves or shines is brought up to date for each image."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from touchline.errors import InputError
from touchline.geometry import ByteArray, Float32Array, FloatArray
from touchline_lab.simulation.rendering.carpet import SEAM_M, SEAM_OFFSET, pile_pyramid, wear_map
from touchline_lab.simulation.rendering.illumination import (
    FLAGS_PER_M,
    HAS_PAINT,
    HAS_SEAM,
    mark_shadows,
    mark_sunlight,
    sunward,
)
from touchline_lab.simulation.rendering.paint import CELL_M, PaintGrid, build_paint, painted_cells
from touchline_lab.simulation.rendering.solids import (
    COLUMNS,
    Cells,
    Palette,
    ball_row,
    block_row,
    field_blocks,
    net_rows,
    placed,
    robot_rows,
)
from touchline_lab.simulation.world.lights import lamps_on_ground
from touchline_lab.simulation.world.world import PAINTS, World, WorldState

RADIANCE_PER_LEVEL = 0.295  # white paint (0.87) under level 1: 0.26, as in the recorded images under hall lamps
_LIGHT_STEP_M = 0.125
_ROOM_PAINTS = ((0.019, 0.019, 0.02), (0.55, 0.51, 0.42), (0.75, 0.71, 0.61))  # board, walls, ceiling
# standard deviations of brightness as measured over the floors of the recordings: blotches, strips, pile
_WEAR, _STRIP_TONE, _PILE = 0.053, 0.034, 1.25


class SceneArrays(NamedTuple):
    """All that the loops read, from one camera's place; each is explained where it is made."""

    solids: FloatArray
    cells: Cells
    palette: FloatArray
    room: FloatArray
    room_colours: FloatArray
    flags: ByteArray
    paint: PaintGrid
    paints: FloatArray
    wear: FloatArray
    carpet: FloatArray
    pyramid: Float32Array
    light: Float32Array
    light_frame: FloatArray
    casters: FloatArray
    sun: FloatArray
    windows: FloatArray


class Scene:
    """The arrays that the rendering loops read. Field frame, metres.

    room (8,), room_colours (4, 3) of floor, board, walls and ceiling, paint, paints (1 + marks, 3), wear (2,) of the
    lines, carpet (7,): colour, spacing of the seams, contrast of the pile, gloss, whether lamps are coloured; pyramid:
    see the loops. After `update`: solids (K, 13), casters (M, 4), light (ny, nx, 5), sun (4,), flags (ny, nx).
    """

    def __init__(self, world: World) -> None:
        self.world = world
        self.flags: ByteArray
        self._still_flags: ByteArray
        self._lit_flags: ByteArray
        rng = np.random.default_rng([world.seed, 23])
        field = world.field
        board = field.length + 2.0 * field.border, field.width + 2.0 * field.border
        sizes = 0.5 * np.array([*world.carpet, *board, *world.hall[:2]])
        self.room = np.array([*sizes, world.hall[2], world.board_height])
        self.wear = np.array(world.line_wear)
        self.room_colours = np.array([world.floor, *_ROOM_PAINTS])
        self.paint = build_paint(world.field, world.marks, world.hall)
        self.paints = np.array([PAINTS["white"], *(mark.colour for mark in world.marks)])
        self._lamp_colours = np.array([lamp.colour for lamp in world.lights.lamps]).reshape(-1, 3)
        coloured = float((self._lamp_colours != 1.0).any())
        pile = _PILE * world.carpet_contrast
        self.carpet = np.array([*PAINTS["carpet"], world.seam_spacing, pile, world.gloss, coloured])
        self.pyramid = pile_pyramid(rng)
        self._build_solids()
        self._build_light(rng)
        self._build_flags()

    def update(self, state: WorldState) -> None:
        """Bring everything that moves or shines to a state. Raises InputError for a body outside the hall."""
        world = self.world
        robots = _table(state.robots or [(r.x, r.y, r.heading) for r in world.robots], 3)
        balls = _table(state.balls or [(b.x, b.y) for b in world.balls], 2)
        if len(robots) != len(world.robots) or len(balls) != len(world.balls):
            raise InputError(
                f"state at {state.time_s:g} s: {len(robots)} robots and {len(balls)} balls, but the world has "
                f"{len(world.robots)} and {len(world.balls)}"
            )
        for name, places in (("robot", robots), ("ball", balls)):
            for number, place in enumerate(places):
                world.check_inside(f"{name} {number} at {state.time_s:g} s", float(place[0]), float(place[1]))
        moving = placed(self._robot_rows, robots[self._robot_owners])
        rolling = self._ball_rows.copy()
        if len(rolling):
            rolling[:, 1:3] = balls
        self.solids = np.concatenate((self._standing, moving, rolling))
        self.casters = np.column_stack((np.concatenate((robots[:, :2], balls)), self._caster_sizes))
        self._shine(state.time_s)
        np.copyto(self.flags, self._lit_flags if self.sun[0] > 0.0 else self._still_flags)
        mark_shadows(self.casters, self.sun, self.paint.frame, self.flags)

    def arrays(self, cells: Cells) -> SceneArrays:
        """Everything for the loops, with the solids sorted into cells around a camera."""
        own = {name: getattr(self, name) for name in SceneArrays._fields if name != "cells"}
        return SceneArrays(cells=cells, **own)

    def _build_solids(self) -> None:
        world, palette = self.world, Palette()
        rows = [block_row(block, palette) for block in (*field_blocks(world.field), *world.clutter)]
        rows += net_rows(world.field, palette)
        self._standing = _table(rows, COLUMNS)
        self._robot_rows, self._robot_owners = robot_rows(world.robots, palette)
        self._ball_rows = _table([ball_row(ball, palette) for ball in world.balls], COLUMNS)
        palette.add([PAINTS["white"]])  # never empty
        self.palette = palette.array()
        sizes = [(r.radius, r.height) for r in world.robots] + [(b.radius, 2.0 * b.radius) for b in world.balls]
        self._caster_sizes = _table(sizes, 2)

    def _build_light(self, rng: np.random.Generator) -> None:
        world = self.world
        columns, rows = (int(np.ceil(size / _LIGHT_STEP_M)) + 3 for size in world.hall[:2])
        self.light_frame = np.array(
            [-0.5 * (columns - 1) * _LIGHT_STEP_M, -0.5 * (rows - 1) * _LIGHT_STEP_M, 1.0 / _LIGHT_STEP_M]
        )
        x = self.light_frame[0] + np.arange(columns) * _LIGHT_STEP_M
        y = self.light_frame[1] + np.arange(rows) * _LIGHT_STEP_M
        self._lamp_ratios = lamps_on_ground(world.lights.lamps, *np.meshgrid(x, y))
        self.light = np.ones((rows, columns, 5), dtype=np.float32)
        self._carpet_brightness = 1.0 + _WEAR * world.carpet_contrast * wear_map(rng, columns, rows, _LIGHT_STEP_M)
        if world.seam_spacing > 0.0:  # no two strips are of quite the same tone
            strips = np.floor(x / world.seam_spacing + SEAM_OFFSET).astype(int)
            tones = _STRIP_TONE * rng.standard_normal(int(strips[-1] - strips[0]) + 1)
            self._carpet_brightness *= 1.0 + world.carpet_contrast * tones[strips - strips[0]]
        self._levels: npt.NDArray[np.float64] | None = None
        walls = {"east": (0.0, self.room[4]), "west": (0.0, -self.room[4])}
        walls |= {"north": (1.0, self.room[5]), "south": (1.0, -self.room[5])}
        lit = world.lights.windows
        openings = [(*walls[w.wall], w.start_m, w.end_m, w.bottom_m, w.top_m, *w.bars, w.bar_width_m) for w in lit]
        self.windows = sunward(_table(openings, 9), world.lights.sun_azimuth_rad)

    def _shine(self, time_s: float) -> None:
        lights = self.world.lights
        lamps, sun, ambient = lights.levels(time_s)
        levels = np.array([*lamps, ambient])
        if self._levels is None or not np.array_equal(levels, self._levels):
            total = np.tensordot(lamps, self._lamp_ratios, axes=1) + ambient
            self.light[:, :, 0] = total * RADIANCE_PER_LEVEL
            self.light[:, :, 1] = self.light[:, :, 0] * self._carpet_brightness
            if self.carpet[6]:
                coloured = np.tensordot(self._lamp_ratios, lamps[:, np.newaxis] * self._lamp_colours, axes=(0, 0))
                self.light[:, :, 2:] = (coloured + ambient) / total[..., np.newaxis]
            self._levels = levels
        azimuth, slope = lights.sun_azimuth_rad, np.tan(lights.sun_elevation_rad)
        self.sun = np.array([sun * RADIANCE_PER_LEVEL, np.cos(azimuth), np.sin(azimuth), slope])
        if sun > 0.0 and self._lit_flags is self._still_flags:
            self._lit_flags = np.array(self._still_flags)
            mark_sunlight(self.sun, self.windows, self.paint.frame, self._lit_flags)

    def _build_flags(self) -> None:
        """What the flag cells of the ground hold that never moves."""
        x0, _, columns, rows = self.paint.frame
        shape = (round(rows * CELL_M * FLAGS_PER_M), round(columns * CELL_M * FLAGS_PER_M))
        self._still_flags = np.zeros(shape, dtype=np.uint8)
        self._still_flags[painted_cells(self.paint, shape, int(FLAGS_PER_M))] |= HAS_PAINT
        spacing = self.world.seam_spacing
        if spacing > 0.0 and self.world.carpet_contrast > 0.0:
            strip = (x0 + (np.arange(shape[1]) + 0.5) / FLAGS_PER_M) / spacing + SEAM_OFFSET
            near = np.abs(strip - np.round(strip)) * spacing < 0.5 / FLAGS_PER_M + 0.5 * SEAM_M + 0.05
            self._still_flags[:, near] |= HAS_SEAM
        self._lit_flags = self._still_flags
        self.flags = self._still_flags.copy()


def _table(rows: Sequence[Sequence[float]], columns: int) -> FloatArray:
    """(N, columns), of no rows, too."""
    return np.array(rows, dtype=np.float64).reshape(-1, columns)
