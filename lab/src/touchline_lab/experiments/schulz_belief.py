"""schulz-belief (figure 4): what one frame's features say of the pose, on a grid over the whole field."""

import math
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from touchline.errors import TouchlineError
from touchline.field import FieldModel, open_field
from touchline.field.association import FieldAssociations
from touchline.geometry import FloatArray, Pose, wrap_angles
from touchline.localization.registration.feature_model import FeatureModel, field_lines
from touchline.localization.registration.features import Features
from touchline.types import LandmarkKind, Observation
from touchline_lab.experiments import schulz_runs as humanoids
from touchline_lab.experiments.harness import ExperimentResult, Headline, follow, percent, seed_range, spread
from touchline_lab.experiments.scenes import BLUE, MAGENTA, new_figure
from touchline_lab.experiments.schulz_runs import OURS, PAPER

FIELD = "indoor-9x6"
STEP_M, HEADINGS = 0.1, 72
_BEYOND_M = 0.5
_SHOWN_M = 0.3  # between the particles of the figure
_SECONDS = 60.0
_MODE_M, _MODE_RATIO = 1.0, 0.2
PANELS = {
    "lines": ("crossings", "posts", "poles"),
    "crossings": ("lines", "posts", "poles"),
    "pole": ("lines", "crossings", "posts"),
    "lines, crossings, pole": ("posts",),
}
_PAPER = {
    "lines": "shown",
    "crossings": "two positions",
    "pole": "position not at all clear",
    "lines, crossings, pole": "almost one",
}
_NOTES = (
    f"Per seed the first frame of a walk on {FIELD} at the observation level that shows what figure 2 shows: two lines "
    "or more, two crossings or more, and of all that is coloured one pole alone.",
    f"Likelihoods on a grid of {100 * STEP_M:.0f} cm and {360 // HEADINGS}°. Positions: peaks of at least "
    f"{_MODE_RATIO:g} of the highest, {_MODE_M:g} m apart. Belief that is right: its share within 0.5 m and 20° of the "
    "truth. Area: of the grid where the best heading has half the highest likelihood.",
    "The picture is of the first seed and the paper's own form: at each position the most likely heading, as large as "
    "it is likely; magenta the truth.",
)


class Belief(NamedTuple):
    """Likelihoods (ny, nx, HEADINGS) of poses (ny, nx, HEADINGS, 3), 1 at most."""

    poses: FloatArray
    likelihoods: FloatArray


class Seen(NamedTuple):
    """A frame as in figure 2: lines, two crossings or more, and of what is coloured one pole alone."""

    observation: Observation
    pose: Pose


def schulz_belief(seeds: int) -> ExperimentResult:
    """One frame per seed, the belief by four sets of features in both forms of the observation model."""
    field = open_field(FIELD)
    seen = [chosen_frame(seed) for seed in follow(seed_range(seeds), "frames")]
    shown = {panel: belief_of(field, seen[0].observation, panel, PAPER) for panel in PANELS}
    found = {
        (system, panel): [_summary(belief_of(field, s.observation, panel, system), s.pose) for s in seen]
        for system in (PAPER, OURS)
        for panel in PANELS
    }
    rows = []
    for key, values in found.items():
        modes, mass, wide = (np.array(column) for column in zip(*values, strict=True))
        rows.append((*key, _PAPER[key[1]], spread(modes, 1), percent(mass), spread(wide, 2)))
    corners, ours = (spread([v[0] for v in found[PAPER, name]], 1) for name in ("crossings", "lines, crossings, pole"))
    return ExperimentResult(
        "Figure 4 of Schulz and Behnke 2012: the belief by the features of one frame",
        ("observation model", "features", "paper: positions", "positions", "belief that is right", "area (m²)"),
        rows,
        Headline("positions left by crossings; by lines, crossings and one pole", "2; almost 1", f"{corners}; {ours}"),
        _NOTES,
        (("figure4", _figure(field, shown, seen[0])),),
    )


def chosen_frame(seed: int) -> Seen:
    """The first frame that fits, in walks from place to place drawn from the seed."""
    for attempt in range(20):
        number = 100 * seed + attempt
        walked = humanoids.walk(FIELD, humanoids.AS_SIMULATED, number, _SECONDS, humanoids.random_areas(FIELD, number))
        for frame, truth in zip(walked.frames, walked.truth, strict=True):
            seen = frame.observation
            if seen is not None and _fits(seen):
                return Seen(seen, Pose(*truth))
    raise TouchlineError("schulz-belief: no frame shows what figure 2 shows")


def _fits(seen: Observation) -> bool:
    kinds = seen.landmarks.kinds.tolist()
    coloured = [kind for kind in kinds if kind in (LandmarkKind.POST, LandmarkKind.GOAL, LandmarkKind.POLE)]
    return len(seen.lines) >= 2 and len(seen.crossings) >= 2 and coloured == [LandmarkKind.POLE]


def belief_of(field: FieldModel, seen: Observation, panel: str, form: str) -> Belief:
    """Equation (8) for the poses of a grid, with the features of one of PANELS."""
    chosen = humanoids.settings(form, humanoids.NO_MARKS, *(f"features.use.{kind}=false" for kind in PANELS[panel]))
    associations = FieldAssociations(field)
    features = Features(associations, chosen.features)
    model = FeatureModel(associations.tables, field_lines(field), polar=not chosen.features.paper.covariances)
    poses = _grid(field)
    logs = model.log_likelihoods(features.of(seen), np.ascontiguousarray(poses.reshape(-1, 3)))
    return Belief(poses, np.exp(logs - logs.max()).reshape(poses.shape[:3]))


def _grid(field: FieldModel) -> FloatArray:
    half_x, half_y = 0.5 * field.length + _BEYOND_M, 0.5 * field.width + _BEYOND_M
    x, y = np.arange(-half_x, half_x + 1e-6, STEP_M), np.arange(-half_y, half_y + 1e-6, STEP_M)
    headings = 2.0 * math.pi * np.arange(HEADINGS) / HEADINGS - math.pi
    return np.stack(np.broadcast_arrays(x[:, np.newaxis], y[:, np.newaxis, np.newaxis], headings), axis=-1)


def _summary(belief: Belief, truth: Pose) -> tuple[int, float, float]:
    """Number of positions, share of the belief that is right, area (m²) where the best heading is likely."""
    poses, likelihoods = belief
    near = np.hypot(poses[..., 0] - truth.x, poses[..., 1] - truth.y) <= humanoids.RIGHT_M
    near &= np.abs(wrap_angles(poses[..., 2] - truth.heading)) <= humanoids.RIGHT_RAD
    best = likelihoods.max(axis=2)
    places, left, modes = poses[:, :, 0, :2], best.copy(), 0
    while left.max() >= _MODE_RATIO * best.max():
        modes += 1
        peak = places.reshape(-1, 2)[int(left.argmax())]
        left[np.hypot(places[..., 0] - peak[0], places[..., 1] - peak[1]) < _MODE_M] = 0.0
    return modes, float(likelihoods[near].sum() / likelihoods.sum()), float(np.sum(best >= 0.5) * STEP_M**2)


def _figure(field: FieldModel, shown: dict[str, Belief], seen: Seen) -> Figure:
    figure, axes = new_figure(2, 2, (8.0, 5.8), list(shown), field=field, beyond_m=_BEYOND_M)
    for axis, belief in zip(axes, shown.values(), strict=True):
        _draw(axis, belief)
        x, y, heading = seen.pose
        axis.quiver(x, y, math.cos(heading), math.sin(heading), color=MAGENTA, scale=18.0, width=0.008, zorder=4)
    return figure


def _draw(axis: Axes, belief: Belief) -> None:
    """Particles with their headings; each is the likeliest of its surroundings."""
    every = round(_SHOWN_M / STEP_M)
    ny, nx = (n // every * every for n in belief.likelihoods.shape[:2])
    shape = (ny // every, every, nx // every, every * HEADINGS)
    likelihoods = belief.likelihoods[:ny, :nx].reshape(ny // every, every, nx // every, every, HEADINGS)
    poses = belief.poses[:ny, :nx].reshape(ny // every, every, nx // every, every, HEADINGS, 3)
    blocks = likelihoods.transpose(0, 2, 1, 3, 4).reshape(shape[0] * shape[2], -1)
    choices = poses.transpose(0, 2, 1, 3, 4, 5).reshape(shape[0] * shape[2], -1, 3)
    index = blocks.argmax(axis=1)
    size, best = blocks.max(axis=1), choices[np.arange(len(index)), index]
    axis.scatter(best[:, 0], best[:, 1], s=40.0 * size, color=BLUE, zorder=2, linewidths=0.0)
    likely = size > 0.03
    arrows = 0.35 * size[likely, np.newaxis] * np.column_stack((np.cos(best[likely, 2]), np.sin(best[likely, 2])))
    axis.quiver(*best[likely, :2].T, *arrows.T, angles="xy", scale_units="xy", scale=1.0, width=0.004, zorder=3)
