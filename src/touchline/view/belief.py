"""The field from above with what one frame's features say of the pose (figure 4 of Schulz and Behnke 2012), and the
particles.

The belief is that of the paper's own observation model, equations (5) to (8), on a grid: for each position the most
likely heading, as large as it is likely. Ours is narrower than the grid is fine.
"""

import math
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from touchline.field import FieldModel
from touchline.field.drawing import FieldView, draw_field, field_view
from touchline.geometry import FloatArray, Pose
from touchline.localization.registration.feature_model import FeatureModel
from touchline.localization.registration.features import FeaturePaper, Features
from touchline.perception.feature_pictures import CROSSING_PAINT, LANDMARK_PAINT, LINE_PAINT, label, landmark_name
from touchline.perception.stages import SHIFT, Legend, Paint, with_legend
from touchline.systems import LocalizationSystem
from touchline.types import Estimate, ImageArray, Observation, Status
from touchline.view.overlay import LINE_COLOR

BELIEF_COLOR, PARTICLE_COLOR = (255, 200, 0), (170, 255, 150)  # BGR; orange are points beside the lines
GUESS_COLOR = (245, 190, 240)  # pale: of a robot that is not located, and of the twin
_STEP_M, _HEADINGS = 0.25, 48
_BEYOND_M = 0.5
_MIN_LIKELIHOOD = 0.02  # likelihood, beside the highest, that is drawn
_SIDE_PX = 1200


class Belief(NamedTuple):
    """poses: (P, 3) x, y (m) and of all headings (rad) the likeliest there. likelihoods: (P,), 1 at most."""

    poses: FloatArray
    likelihoods: FloatArray


def particles_of(system: LocalizationSystem) -> FloatArray | None:
    """(N, 4) particles that features weigh: x, y (m), heading (rad), weight; None of a system that has none."""
    return getattr(system, "weighed_poses", None)


def belief_of(system: LocalizationSystem, field: FieldModel, seen: Observation) -> Belief | None:
    """What one observation alone says of the pose; None of a system without a model of features, and of no features."""
    own: FeatureModel | None = getattr(system, "feature_model", None)
    if own is None:
        return None
    features: Features = system.features  # type: ignore[attr-defined]
    settings = features.settings
    paper = FeaturePaper(covariances=False, oriented_t=settings.paper.oriented_t, marks=settings.paper.marks)
    settings = settings.model_copy(update={"paper": paper})
    view = Features(features.associations, settings, features.height_m).of(seen)
    if view.size == 0:
        return None
    model = FeatureModel(own.tables, own.lines, polar=True)
    half_x, half_y = 0.5 * field.length + _BEYOND_M, 0.5 * field.width + _BEYOND_M
    headings = 2.0 * math.pi * np.arange(_HEADINGS) / _HEADINGS - math.pi
    x, y = np.arange(-half_x, half_x + 1e-6, _STEP_M), np.arange(-half_y, half_y + 1e-6, _STEP_M)
    grid = np.stack(np.broadcast_arrays(x[:, np.newaxis, np.newaxis], y[:, np.newaxis], headings), axis=-1)
    poses = np.ascontiguousarray(grid.reshape(-1, 3))
    logs = model.log_likelihoods(view, poses).reshape(-1, _HEADINGS)
    best = logs.argmax(axis=1)
    rows = np.arange(len(best))
    return Belief(poses.reshape(-1, _HEADINGS, 3)[rows, best], np.exp(logs[rows, best] - logs.max()))


def belief_picture(
    field: FieldModel,
    belief: Belief | None,
    particles: FloatArray | None,
    estimate: Estimate | None = None,
) -> ImageArray:
    """The field from above, BGR, with the belief, particles (N, 4), and the robot where the estimate has it.

    What it sees is drawn if it is located; where its pose is but a guess, and a twin at the other end, both are pale.
    """
    scale = _SIDE_PX / (field.length + 2.0 * field.border)
    view, picture = field_view(field, scale), draw_field(field, scale)
    picture = (0.75 * picture).astype(np.uint8)
    legend: Legend = []
    if belief is not None:
        _draw_belief(picture, view, belief)
        legend.append(("belief of this image alone", BELIEF_COLOR))
    located = estimate is not None and estimate.status is Status.TRACKING
    if located and estimate is not None and estimate.observation is not None:
        seen = estimate.observation
        _draw_features(picture, view, estimate.pose, seen)
        legend += [("lines", LINE_PAINT)] * bool(len(seen.lines))
        legend += [("crossings", CROSSING_PAINT)] * bool(len(seen.crossings))
        legend += [("landmarks", LANDMARK_PAINT)] * bool(len(seen.landmarks))
    if particles is not None:
        _draw_particles(picture, view, particles)
        legend.append(("particles", PARTICLE_COLOR))
    if estimate is not None:
        for twin in estimate.hypotheses:
            _draw_robot(picture, view, twin.pose, GUESS_COLOR, "twin: looks the same")
        _draw_robot(picture, view, estimate.pose, LINE_COLOR if located else GUESS_COLOR, "" if located else "a guess")
        legend.append(("the robot", LINE_COLOR) if located else ("the robot, not located", GUESS_COLOR))
    return with_legend(picture, legend)


def _draw_belief(picture: ImageArray, view: FieldView, belief: Belief) -> None:
    reach = 0.5 * _STEP_M
    for (x, y, heading), likelihood in zip(belief.poses, belief.likelihoods, strict=True):
        if likelihood < _MIN_LIKELIHOOD:
            continue
        size = reach * math.sqrt(float(likelihood))
        nose = (x + 2.0 * size * math.cos(heading), y + 2.0 * size * math.sin(heading))
        radius = round(size * view.pixels_per_metre * 2**SHIFT)
        at, to = _fixed(view, np.array([[x, y], nose]))
        cv2.circle(picture, at, radius, BELIEF_COLOR, -1, cv2.LINE_AA, SHIFT)
        cv2.line(picture, at, to, BELIEF_COLOR, 2, cv2.LINE_AA, SHIFT)


def _draw_particles(picture: ImageArray, view: FieldView, particles: FloatArray) -> None:
    heading = np.column_stack((np.cos(particles[:, 2]), np.sin(particles[:, 2])))
    for start, end in zip(_fixed(view, particles[:, :2]), _fixed(view, particles[:, :2] + 0.12 * heading), strict=True):
        cv2.line(picture, start, end, PARTICLE_COLOR, 1, cv2.LINE_AA, SHIFT)
        cv2.circle(picture, start, 2 * 2**SHIFT, PARTICLE_COLOR, -1, cv2.LINE_AA, SHIFT)


def _draw_features(picture: ImageArray, view: FieldView, pose: Pose, seen: Observation) -> None:
    for ends in seen.lines.ends_m:
        start, end = _fixed(view, pose.transform(ends))
        cv2.line(picture, start, end, LINE_PAINT, 3, cv2.LINE_AA, SHIFT)
    kinds = seen.crossings.kinds.tolist() + [landmark_name(kind) for kind in seen.landmarks.kinds.tolist()]
    paints = [CROSSING_PAINT] * len(seen.crossings) + [LANDMARK_PAINT] * len(seen.landmarks)
    places = np.concatenate((seen.crossings.positions_m, seen.landmarks.positions_m))
    for kind, paint, place in zip(kinds, paints, _fixed(view, pose.transform(places)), strict=True):
        cv2.circle(picture, place, 7 * 2**SHIFT, paint, 2, cv2.LINE_AA, SHIFT)
        label(picture, (place[0] >> SHIFT, place[1] >> SHIFT), kind, (255, 255, 255))


def _draw_robot(picture: ImageArray, view: FieldView, pose: Pose, paint: Paint, name: str) -> None:
    start, end = _fixed(view, pose.transform(np.array([[0.0, 0.0], [0.6, 0.0]])))
    radius = round(0.15 * view.pixels_per_metre * 2**SHIFT)
    cv2.circle(picture, start, radius, paint, 3, cv2.LINE_AA, SHIFT)
    cv2.arrowedLine(picture, start, end, paint, 3, cv2.LINE_AA, SHIFT, 0.3)
    if name:
        label(picture, ((start[0] + radius) >> SHIFT, start[1] >> SHIFT), name, paint)


def _fixed(view: FieldView, places: npt.ArrayLike) -> list[tuple[int, int]]:
    """Places (N, 2) of the field as OpenCV's fixed-point numbers; what lies far outside stays near the picture."""
    pixels = np.clip(view.picture_from_field(places), -1e4, 1e4)
    return [(int(u), int(v)) for u, v in np.round(pixels * 2**SHIFT).astype(np.int64)]
