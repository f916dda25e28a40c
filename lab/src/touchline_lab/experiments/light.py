"""light: what is found of a field's paint under every light of the simulator, image by image, for both cameras.

No figure of a paper. The renderer knows where paint is: each image is rendered with the lines and without them, and
what differs is paint, seen past robots and worn as it is.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import cv2
import numpy as np
from matplotlib.figure import Figure

from touchline.camera import GroundView, leaning
from touchline.geometry import BoolArray, Float32Array, FloatArray, Pose
from touchline.motion import LeanFilter
from touchline.perception import observe
from touchline.systems import RobotSetup, open_system
from touchline.systems.touchline import Touchline
from touchline.types import Frame, LandmarkKind, Observation, Prior, Status
from touchline_lab.experiments.clutter import distances_to_segment
from touchline_lab.experiments.harness import (
    NONE,
    ExperimentResult,
    Headline,
    Row,
    gathered,
    seed_range,
    share_text,
    spread,
)
from touchline_lab.experiments.scenes import BLUE, RED, new_figure
from touchline_lab.feature_truth import Tally, TrueFeatures
from touchline_lab.simulation.cameras.image_sensor import ImageSensor
from touchline_lab.simulation.cameras.omni import SimulatedOmniCamera
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

CAMERAS = ("mirror", "humanoid")
SCENARIOS = {
    "mirror": ("straight-tracks", "camera.rate_hz=2.5", "camera.motion_blur=false", "disturbances.shove_every_s=0"),
    "humanoid": ("humanoid-walk", "camera.rate_hz=2.5", "field=hsl-s-9x6"),
}
IMAGES = 5  # of a robot
_LAMPS = ("light.lamps=1.0",)
LIGHTS: dict[str, tuple[str, ...]] = {
    "lamps": _LAMPS,
    "sun patches": ("light.sun=6", "light.windows=4", "light.ambient=0.6"),
    "low sun": ("light.sun=5", "light.windows=4", "light.sun_elevation_deg=16", "light.ambient=0.5"),
    "one row of lamps": (
        *_LAMPS,
        "light.ambient=0.08",
        "light.changes=[{time_s: 0, lamps: 0}, {time_s: 0, row: 0, lamps: 1.5}]",
    ),
    "dim": ("light.lamps=0.06", "light.ambient=0.03"),
    "worn lines": (*_LAMPS, "hall.scuffed=0.35"),
    "dirty lines": (*_LAMPS, "hall.scuffed=0.1", "hall.dirt=0.45"),
    "coloured lamps": (*_LAMPS, "light.ambient=0.1", "light.tints=[[1.3, 1.0, 0.55], [0.8, 1.0, 1.3]]"),
    "glossy carpet": ("light.sun=6", "light.windows=4", "light.ambient=0.6", "hall.gloss=0.35"),
    "dark surround": (*_LAMPS, "hall.carpet_border_m=0.05", "hall.dark_floor=true"),
}
CLOUD = "passing cloud"  # within the images of a run; colours and exposure stay those of the first
LIGHTS[CLOUD] = LIGHTS["sun patches"]
_CLOUD_LEVELS = (1.0, 0.6, 0.35, 0.35, 0.8)  # of the light at each image
_BLUER = np.array([-0.2, 0.0, 0.25]) / 0.65  # of R, G, B for each share of the light that is lost
KINDS = ("crossings", "circle", "posts", "marks")
REACH_M = {"mirror": 6.0, "humanoid": 5.0}
_EXPOSED, _MAX_MS, _MAX_GAIN = 0.2, 30.0, 8.0  # mean of the sensor's values that an exposure gives
_PAINT = 0.5  # of a pixel
_NEAR_PX = 3.0
_MIN_HALF_PX = 0.6  # thinner lines are none of an image
_ARM_M = 0.15  # what lies so near to another line is that line's, too


@dataclass(frozen=True, slots=True)
class Found:
    """Sums over the images of one robot. lines: places of the paint every 5 cm that were there and found, points found
    and right; outer: the places on the touch and goal lines; others: by KINDS. boundary_px: |error| of each column;
    errors_m: of the tracked poses.
    """

    lines: Tally
    outer: Tally
    others: Mapping[str, Tally]
    boundary_px: Sequence[float]
    errors_m: Sequence[float]
    tracked: float


class Truth(NamedTuple):
    """One image's: paint (H, W), share of each pixel; places (N, 2) px of paint that can be seen and which of them (N,)
    lie on the outer lines; circle: whether a third of it is among them.
    """

    paint: Float32Array
    places: FloatArray
    outer: BoolArray
    circle: bool


def simulation(camera: str, light: str, seed: int) -> Simulation:
    """A robot with this camera, in this light."""
    name, *changes = SCENARIOS[camera]
    scenario = open_scenario(name, seed, IMAGES / 2.5, (*changes, *LIGHTS[light]))
    return Simulation(scenario, "points")


def images(run: Simulation, cloud: bool = False) -> list[tuple[Frame, Truth]]:
    """Frames with images, exposed as automatic exposure would, and where their paint is.

    cloud: whether one passes meanwhile, faster than the exposure follows.
    """
    found, exposure = [], None
    for index in range(len(run)):
        time_s = float(run.image_times_s[index])
        pose, attitude, state = run.track.pose_at(time_s), run.track.attitude_at(time_s), run.state(time_s)
        radiance, paint = run.camera_model.paint_ratio(run.world, state, pose, attitude)
        if cloud:
            level = _CLOUD_LEVELS[index % len(_CLOUD_LEVELS)]
            radiance *= (level * (1.0 + (1.0 - level) * _BLUER)).astype(np.float32)
        if exposure is None or not cloud:
            exposure = exposed(radiance)
        rng = np.random.default_rng([run.scenario.seed, 5, index])
        image = run.camera_model.sensor.develop(radiance, *exposure, rng)
        frame = replace(run.frame(index), image=image, observation=None)
        found.append((frame, _truth(run, pose, attitude, paint)))
    return found


def exposed(radiance: Float32Array) -> tuple[float, float]:
    """Exposure (ms) and gain at which the mean of what a sensor gives, at most 1 each, is `_EXPOSED`."""
    green = radiance[::4, ::4, 1]
    green = green[green > 0.0]
    scale = _EXPOSED / max(float(green.mean()), 1e-9)
    for _ in range(4):
        scale *= _EXPOSED / max(float(np.minimum(scale * green, 1.0).mean()), 1e-9)
    product_ms = scale / ImageSensor().k
    exposure = min(product_ms, _MAX_MS)
    return exposure, min(max(product_ms / exposure, 1.0), _MAX_GAIN)


def _truth(run: Simulation, pose: Pose, attitude: tuple[float, float], paint: Float32Array) -> Truth:
    camera, field = run.camera_model, run.field
    reach_m = REACH_M["mirror" if isinstance(camera, SimulatedOmniCamera) else "humanoid"]
    rows = []
    for number, line in enumerate(field.polylines(0.05)):
        along = np.gradient(line, axis=0)
        across = np.column_stack((-along[:, 1], along[:, 0])) / np.linalg.norm(along, axis=1, keepdims=True)
        pixels, side = (
            camera.project(pose.inverse().transform(line + shift * across), attitude)
            for shift in (0.0, 0.5 * field.line_width)
        )
        half = np.hypot(*(side - pixels).T)
        near = (np.hypot(*(line - (pose.x, pose.y)).T) < reach_m) & (half > _MIN_HALF_PX)
        rows.append(np.column_stack((pixels, line, np.full(len(line), number)))[near])
    table = np.concatenate(rows)
    u, v = (np.nan_to_num(table[:, k], nan=-1.0) for k in (0, 1))
    inside = (u >= 2) & (u < paint.shape[1] - 2) & (v >= 2) & (v < paint.shape[0] - 2)
    table = table[inside]
    table = table[paint[np.rint(table[:, 1]).astype(int), np.rint(table[:, 0]).astype(int)] > _PAINT]
    segments = len(field.segments)
    straight = table[:, 4] < segments
    on_circle = (table[:, 4] >= segments) & (table[:, 4] < segments + len(field.circles))
    whole = 2.0 * np.pi * float(field.circles[0, 2]) / 0.05 if len(field.circles) else np.inf
    half_size = np.abs(field.segments).max(axis=0)
    outer = (np.abs(np.abs(table[:, 2]) - max(half_size[0], half_size[2])) < 0.01) | (
        np.abs(np.abs(table[:, 3]) - max(half_size[1], half_size[3])) < 0.01
    )
    kept = straight | (isinstance(camera, SimulatedOmniCamera) & on_circle)
    return Truth(paint, table[kept, :2], outer[kept] & straight[kept], bool(on_circle.sum() > whole / 3.0))


def score(run: Simulation, seen: Observation, truth: Truth) -> tuple[Tally, Tally]:
    """How much of the paint was found, in all and on the outer lines, and how many points are right."""
    camera = run.camera_model
    if isinstance(camera, SimulatedOmniCamera):
        centre = np.array(camera.design.center)
        spacing = np.pi / 72.0 * np.hypot(*(truth.places - centre).T)
        near = _to_points(truth.places, seen.points.pixels) <= spacing + _NEAR_PX
    else:
        to_plane = camera.design.camera_rays
        places, ends = (
            (rays[..., 1:] / rays[..., :1])
            for rays in (to_plane(truth.places), to_plane(seen.lines.pixels.reshape(-1, 2)))
        )
        away = [distances_to_segment(places, line) for line in ends.reshape(-1, 4)]
        near = np.min(away, axis=0, initial=np.inf) * camera.design.fx <= _NEAR_PX
    size = 2 * int(_NEAR_PX) + 1
    wide = cv2.dilate(truth.paint, np.ones((size, size), np.uint8))
    u, v = np.rint(seen.points.pixels).astype(int).T
    right = int(np.count_nonzero(wide[v, u] > _PAINT))
    lines = Tally(right, len(u), len(near), int(near.sum()))
    return lines, Tally(0, 0, int(truth.outer.sum()), int((near & truth.outer).sum()))


def _to_points(places: FloatArray, points: FloatArray) -> FloatArray:
    """Distance (N,) of each place (N, 2) from the nearest of points (M, 2)."""
    if not len(points):
        return np.full(len(places), np.inf)
    return np.hypot(*np.moveaxis(places[:, np.newaxis] - points, -1, 0)).min(axis=1)


def _tallies(run: Simulation, seen: Observation, truth: Truth, frame: Frame, pose: Pose) -> dict[str, Tally]:
    """Crossings, posts and marks against the field, the circle against what can be seen of it; of a lens alone."""
    true = TrueFeatures(run.field, pose, _view(run, frame), 2.0 * truth.paint)
    landmarks = true.tally_landmarks(seen.landmarks, REACH_M["humanoid"])
    circles = int(np.count_nonzero(seen.landmarks.kinds == LandmarkKind.CIRCLE))
    return {
        "crossings": true.tally_crossings(seen.crossings, REACH_M["humanoid"])["all"],
        "circle": Tally(min(circles, int(truth.circle)), circles, int(truth.circle), int(truth.circle and circles > 0)),
        "posts": landmarks[LandmarkKind.POST],
        "marks": landmarks[LandmarkKind.PENALTY_MARK],
    }


def _view(run: Simulation, frame: Frame) -> GroundView:
    index = int(np.searchsorted(run.image_stamps, frame.stamp_ns))
    attitude = run.track.attitude_at(float(run.image_times_s[index]))
    return GroundView(run.camera, leaning(run.camera, *attitude))


def of_robot(task: tuple[int, str, str]) -> dict[tuple[str, str], Found]:
    """What a robot of this seed with this camera finds under a light, by light and camera."""
    seed, camera, name = task
    return {(name, camera): _of_run(simulation(camera, name, seed), name == CLOUD)}


def _of_run(run: Simulation, cloud: bool) -> Found:
    setup = RobotSetup(run.field, run.camera, run.wheel_directions_rad)
    system = open_system("touchline", setup, None, np.random.default_rng(0))
    assert isinstance(system, Touchline)
    system.reset(Prior(pose=run.track.pose_at(0.0)))
    scores: list[tuple[Tally, Tally]] = []
    tallies: list[dict[str, Tally]] = []
    boundary_px, errors_m, tracked, leaning_filter = [], [], 0, LeanFilter()
    for index, (frame, truth) in enumerate(images(run, cloud)):
        pose = run.truth[index]
        seen = observe(leaning_filter.at_image(frame), system.detector, setup.max_range_m)
        estimate = system.step(replace(frame, image=None, observation=seen))
        scores.append(score(run, seen, truth))
        if estimate.status == Status.TRACKING:
            tracked += 1
            errors_m.append(estimate.pose.distance_to(pose))
        if run.camera_kind == "omni":
            continue
        tallies.append(_tallies(run, seen, truth, frame, pose))
        true = TrueFeatures(run.field, pose, _view(run, frame), truth.paint)
        off = true.boundary_error_px(seen.boundary.pixels)
        boundary_px += np.abs(off[np.isfinite(off)]).tolist()
    lines, outer = map(Tally.total, zip(*scores, strict=True))
    others = {kind: Tally.total(each[kind] for each in tallies) for kind in KINDS}
    return Found(lines, outer, others, boundary_px, errors_m, tracked / max(len(run), 1))


COLUMNS = (
    "camera", "light", "lines: recall", "of that under lamps", "lines: precision", "touch and goal lines: recall",
    *(f"{kind}: precision, recall" for kind in KINDS), "boundary (px)", "pose error (cm)", "of that under lamps ",
    "tracked",
)  # fmt: skip


_NOTE = (
    f"Robots as built on straight tracks (mirror) and walking (humanoid), {IMAGES} images each at 2.5 Hz without "
    "motion blur, exposed so that their mean is the same; under the passing cloud the light falls to 35 % and turns "
    "bluer, while exposure stays that of the first image. The renderer takes each image with the lines and without: "
    "what differs is paint. Recall: of the places every 5 cm along the lines that can be seen, how many have a line "
    "or a point of it within 3 px (a mirror's scan lines pass within their own spacing). Precision: of the line "
    "points, how many lie on paint within 3 px. Crossings, circle, posts and marks as in schulz-features; boundary: "
    "mean error of its columns, which what stands on the field adds to. The pose is that of touchline from its start "
    "on."
)


def _sum(robots: Sequence[Found]) -> Tally:
    return Tally.total(each.lines for each in robots)


def _row(camera: str, name: str, found: Mapping[tuple[str, str], Sequence[Found]]) -> Row:
    robots, lamps = found[name, camera], found["lamps", camera]
    lines, outer = _sum(robots), Tally.total(each.outer for each in robots)
    errors, usual = ([np.mean(r.errors_m) for r in some if r.errors_m] for some in (robots, lamps))
    others = [Tally.total(each.others[kind] for each in robots) for kind in KINDS]
    cells = [f"{share_text(total.precision)}, {share_text(total.recall)}" for total in others]
    boundary = [px for each in robots for px in each.boundary_px]
    return (
        camera, name, share_text(lines.recall), share_text(lines.recall / _sum(lamps).recall),
        share_text(lines.precision), share_text(outer.recall), *cells,
        f"{np.mean(boundary):.1f}" if boundary else NONE,
        spread(100.0 * np.array(errors)), f"{np.mean(errors) / np.mean(usual):.2f}" if errors and usual else NONE,
        share_text(float(np.mean([each.tracked for each in robots]))),
    )  # fmt: skip


def light(seeds: int) -> ExperimentResult:
    """Every light on a robot a seed of each camera."""
    found = gathered(of_robot, list(product(seed_range(seeds), CAMERAS, LIGHTS)), "robots and lights")
    worst = [
        f"{camera} {100.0 * min(_ratio(camera, name, found) for name in LIGHTS):.1f} %, "
        f"{100.0 * min(_sum(found[name, camera]).precision for name in LIGHTS):.1f} %"
        for camera in CAMERAS
    ]
    return ExperimentResult(
        "What is found of the paint under every light of the simulator",
        COLUMNS,
        [_row(camera, name, found) for camera, name in product(CAMERAS, LIGHTS)],
        Headline("worst light: recall of lines against that under lamps, precision", NONE, "; ".join(worst)),
        (_NOTE,),
        (("lines", _picture(found)),),
    )


def _ratio(camera: str, name: str, found: Mapping[tuple[str, str], Sequence[Found]]) -> float:
    """Recall against that under lamps."""
    return _sum(found[name, camera]).recall / _sum(found["lamps", camera]).recall


def _picture(found: Mapping[tuple[str, str], Sequence[Found]]) -> Figure:
    figure, axes = new_figure(1, 2, (7.2, 3.4), CAMERAS, ("%", ""))
    heights = np.arange(len(LIGHTS))[::-1]
    for each, camera in zip(axes, CAMERAS, strict=True):
        recalls = [100.0 * _ratio(camera, name, found) for name in LIGHTS]
        precisions = [100.0 * _sum(found[name, camera]).precision for name in LIGHTS]
        each.plot(recalls, heights, "o", color=BLUE, label="recall, of that under lamps")
        each.plot(precisions, heights, "s", color=RED, label="precision")
        each.set_yticks(heights, list(LIGHTS) if camera == CAMERAS[0] else [])
        each.set_xlim(75.0, 105.0)
    axes[1].legend(fontsize=7)
    return figure
