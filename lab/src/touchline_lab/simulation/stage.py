"""The world of a scenario: hall, light, clutter, the others' bodies, and what is laid out for a calibration."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from touchline.errors import InputError
from touchline.field import FieldModel
from touchline_lab.simulation.robot.others import Others
from touchline_lab.simulation.scenario import LightSettings, Scenario
from touchline_lab.simulation.world.calibration_layout import Layout
from touchline_lab.simulation.world.hall import cables, default_world, field_beside, stands
from touchline_lab.simulation.world.lights import Lamp, LightChange, Lights, Window, hall_lamps
from touchline_lab.simulation.world.world import PAINTS, BallActor, RobotActor, World

_MARKERS = ("magenta", "cyan")
_MSL_M, _HUMANOID_M = (0.26, 0.80), (0.24, 0.92)  # radius and height of the others' bodies, as in the recordings
_PERSON_M = (0.25, 1.72)
_ASIDE_M = 4.5  # by how much the hall is wider on each side where there are stands, or another field
PERSON_PARTS = ((0.17, 0.86), (0.2, 1.72))  # radius and top (m) of the cylinders that a person hides lines with
# what of them hides lines, as upright cylinders from foot to head: shares of radius and height (`world.robot_blocks`);
# of a humanoid legs, trunk with arms, and head, each as broad as it looks in the mean over all directions
_MSL_PARTS = ((0.24 / 0.26, 0.475), (0.55, 0.70), (0.45, 1.0))
_HUMANOID_PARTS = ((0.5, 0.5), (0.85, 0.86), (0.35, 1.0))


def body_size(kind: str) -> tuple[float, float]:
    """Radius and height (m) of the other robots' bodies that a camera of this kind plays among."""
    return _MSL_M if kind == "omni" else _HUMANOID_M


def body_parts(kind: str) -> list[tuple[float, float]]:
    """Radius and top (m) of the upright cylinders, from foot to head, that another robot hides lines with."""
    radius, height = body_size(kind)
    parts = _MSL_PARTS if kind == "omni" else _HUMANOID_PARTS
    return [(part * radius, top * height) for part, top in parts]


def make_world(scenario: Scenario, field: FieldModel, others: Others, layout: Layout) -> World:
    """Everything that can be seen. Raises InputError for lights and sizes that make no hall."""
    # the seed of carpet and clutter: from the scenario's, but no number that any other part draws from
    seed = int(np.random.SeedSequence([scenario.seed, 7]).generate_state(1)[0]) >> 1
    hall = scenario.hall
    roomy = hall.stands or hall.beside
    world = default_world(field, seed, clutter=scenario.clutter, aside_m=_ASIDE_M if roomy else 0.0)
    robots, balls = others.at(0.0)
    humanoid = scenario.camera.kind != "omni"
    actors = [
        RobotActor(
            float(x), float(y), float(heading), *body_size(scenario.camera.kind),
            shape="humanoid" if humanoid else "msl",
            marker_colour=PAINTS[_MARKERS[index % 2]],
        )
        for index, (x, y, heading) in enumerate(robots[: scenario.others.robots])
    ]  # fmt: skip
    people = [
        RobotActor(float(x), float(y), float(heading), *_PERSON_M, PAINTS["blue"], PAINTS["red"], shape="person")
        for x, y, heading in robots[scenario.others.robots :]
    ]
    more = field_beside(field, world.hall) if hall.beside else ()
    more += stands(world.hall, np.random.default_rng([seed, 31])) if hall.stands else ()
    world = dataclasses.replace(
        world,
        clutter=(*world.clutter, *more),
        lights=_lights(scenario.light, world.hall),
        robots=(*actors, *people),
        balls=tuple(BallActor(float(x), float(y)) for x, y in balls),
        carpet_border_m=hall.carpet_border_m,
        floor=PAINTS["dark"] if hall.dark_floor else world.floor,
        line_wear=(hall.scuffed, hall.dirt),
        gloss=hall.gloss,
    )
    lying = cables(world.carpet, hall.cables, np.random.default_rng([seed, 29]))
    return dataclasses.replace(world, marks=(*lying, *layout.marks))


def events_of_light(settings: LightSettings) -> list[dict[str, object]]:
    """Changes of the light as sequence.yaml lists them."""
    events = []
    for change in settings.changes:
        levels = change.model_dump(include={"lamps", "sun", "ambient"}, exclude_none=True)
        row = {} if change.row is None else {"row": change.row}
        event = {"t": change.time_s, "kind": "light_change", **{f"{k}_level": v for k, v in levels.items()}, **row}
        events.append(event)
    return events


def _lights(settings: LightSettings, hall: tuple[float, float, float]) -> Lights:
    lamps = hall_lamps(*hall)
    if settings.tints:
        rows = sorted({lamp.y for lamp in lamps})
        tints = {y: settings.tints[row % len(settings.tints)] for row, y in enumerate(rows)}
        lamps = tuple(dataclasses.replace(lamp, colour=tints[lamp.y]) for lamp in lamps)
    changes = tuple(each for change in settings.changes for each in _changes(change, lamps))
    return Lights(
        lamps, settings.ambient, settings.lamps, settings.sun,
        math.radians(settings.sun_azimuth_deg), math.radians(settings.sun_elevation_deg),
        _windows(settings.windows, hall[0]), changes,
    )  # fmt: skip


def _changes(change: LightSettings.Change, lamps: Sequence[Lamp]) -> list[LightChange]:
    """One change of the light as the lights take it: for all lamps, or for each lamp of a row along the field."""
    if change.row is None:
        return [LightChange(change.time_s, change.lamps, change.sun, change.ambient, None, change.fade_s)]
    rows = sorted({lamp.y for lamp in lamps})
    if change.row >= len(rows):
        raise InputError(
            f"light.changes: row {change.row} is unknown; there are rows 0 to {len(rows) - 1}, from -y to y"
        )
    switched = [index for index, lamp in enumerate(lamps) if lamp.y == rows[change.row]]
    return [
        LightChange(change.time_s, None, change.sun, change.ambient, None, change.fade_s),
        *(LightChange(change.time_s, change.lamps, None, None, index, change.fade_s) for index in switched),
    ]


def _windows(count: int, length_m: float) -> tuple[Window, ...]:
    """Windows of the northern wall, each taking half of its share of the wall."""
    if count == 0:
        return ()
    share = length_m / count
    starts = -0.5 * length_m + share * (np.arange(count) + 0.25)
    return tuple(Window("north", float(start), float(start + 0.5 * share), 0.8, 4.5) for start in starts)
