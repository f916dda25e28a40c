"""The robust kernel's gate and the temperature of a search's modes, chosen on point sets for tuning.

    python lab/benchmarks/registration_constants.py [--sets 10] [--seed 1000]

Sets are drawn as in the experiment `own`, which judges on the seeds from 0 on; the public point set is judged on, too.
Gate: mean error of registration from a start near by, over the Cramér-Rao bound, the worse of position and heading.
Temperature: log loss of the probabilities that a search of half views and sectors of 120° gives the places it keeps.
"""

from __future__ import annotations

import argparse

import numpy as np

from touchline.geometry import wrap_angle
from touchline.localization.registration.bound import mean_errors
from touchline.localization.registration.kernels import Plan
from touchline.localization.registration.registration import TRACKING, Registration
from touchline.localization.search import pose_search
from touchline_lab.experiments.own_points import FRAMES, FULL, VIEWS, drawn_set, kept_modes

GATES2 = (9.0, 12.0, 16.0, 20.0, 25.0, 36.0)
TEMPERATURES = (1.0, 1.25, 1.5, 1.75, 2.0, 2.5)
NARROW = VIEWS[-2:]


def over_the_bound(gate2: float, seeds: range) -> float:
    """Mean error over the bound with a gate, the worse of position and heading."""
    plan = Plan(TRACKING.widths_m, gate2, TRACKING.floor_m2, TRACKING.clutter_per_m)
    errors, bounds = [], []
    for seed in seeds:
        points = drawn_set(FULL, FRAMES, np.random.default_rng([seed, 15]))
        registration = Registration(points.field.distance_map())
        for k, (seen, truth) in enumerate(zip(points.points, points.truth, strict=True)):
            pose = registration.fit(seen.positions_m, seen.covariances_m2, points.init[k], plan).pose
            errors.append((np.hypot(*(pose - truth)[:2]), abs(wrap_angle(float(pose[2] - truth[2])))))
            bounds.append(mean_errors(points.bound_of(k)))
    return float((np.mean(errors, axis=0) / np.mean(bounds, axis=0)).max())


def log_loss(temperature: float, seeds: range) -> float:
    """Mean log loss of the probabilities of places."""
    pose_search.TEMPERATURE = temperature
    losses = []
    for view in NARROW:
        for seed in seeds:
            kept = kept_modes(drawn_set(view, FRAMES, np.random.default_rng([seed, 17])))
            given = np.clip(kept.probabilities, 1e-3, 1.0 - 1e-3)
            losses.append(-np.mean(np.where(kept.is_right, np.log(given), np.log1p(-given))))
    return float(np.mean(losses))


def main() -> None:
    """Print both tables; the present values are starred."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1000)
    given = parser.parse_args()
    seeds = range(given.seed, given.seed + given.sets)
    used = TRACKING.gate2, pose_search.TEMPERATURE
    for name, values, figure, now in (
        ("gate (squared standard deviations): error over the bound", GATES2, over_the_bound, used[0]),
        ("temperature: log loss", TEMPERATURES, log_loss, used[1]),
    ):
        print(name)
        for value in values:
            print(f"{'*' if value == now else ' '}{value:6.2f}  {figure(value, seeds):.4f}", flush=True)


if __name__ == "__main__":
    main()
