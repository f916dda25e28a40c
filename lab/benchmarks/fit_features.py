"""Fits the features of the observation level to what nimbro-lines' detector finds: `PINHOLE_FEATURES`.

    python lab/benchmarks/fit_features.py [--every 10] [--seeds 2] [--worn]

A humanoid walks over both fields and is rendered; `--worn` in a hall as halls are. `LineGraphDetector` sees each image
with the camera's true lean; what it finds is paired with what `ObservedFeatures` says is there to be found.
How often that is and how far off follow by maximum likelihood and from the middle 68 % of the errors; they are printed
as they stand in `feature_noise.py`. The lean is measured as what the IMU says at the images' times less the truth.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from fit_crossings import spread, tail_of
from fit_observation_level import minimised

from touchline.camera import GroundView, PinholeCamera, leaning
from touchline.geometry import FloatArray, wrap_angle
from touchline.perception.line_graph import LineGraphDetector, LineGraphSettings
from touchline.types import LandmarkKind, Observation
from touchline_lab.simulation.observation.feature_noise import PINHOLE_FEATURES
from touchline_lab.simulation.observation.features import Looking, ObservedFeatures
from touchline_lab.simulation.observation.observed_lines import occluders
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

FIELDS = ("indoor-9x6", "humanoid-kid-9x6")
AS_HALLS_ARE = (
    "hall.scuffed=0.2", "hall.stands=true", "hall.beside=true", "camera.motion_blur=true", "others.robots=5",
    "others.moving=true", "others.near_m=2", "others.speed_m_s=0.5",
)  # fmt: skip
_NEAR_PX, _NEAR_M = 12.0, 0.25  # a feature that far from where one is is another
_LANDMARK_M, _LANDMARK_RATIO = 0.5, 0.1  # the same of landmarks, and how much more per metre
_ON_LINE_M, _ON_LINE_RATIO, _BEYOND_M = 0.08, 0.02, 0.4  # of a line's ends off a segment, and beyond its ends
_LONG_M = 1.0  # stretches that tell how thin a line may be


class View(NamedTuple):
    """One image: what was found in it, and what could have been found by whom."""

    found: Observation
    observer: ObservedFeatures
    looking: Looking
    field_name: str


def views(simulation: Simulation, every: int) -> Iterator[View]:
    """Every so many images of a run."""
    camera = simulation.camera
    assert isinstance(camera, PinholeCamera)
    detector = LineGraphDetector(camera, LineGraphSettings(), simulation.field)
    noise = PINHOLE_FEATURES
    for index in range(every // 2 - 1, len(simulation), every):
        time_s = float(simulation.image_times_s[index])
        built = replace(camera, base_from_camera=leaning(camera, *map(float, simulation.track.attitude_at(time_s))))
        found = detector.detect(simulation.image(index), GroundView(built))
        observer = ObservedFeatures(built, simulation.field, noise)
        hiding = occluders(simulation._bodies(time_s), noise.height_m)
        yield View(
            found,
            observer,
            Looking(simulation.track.pose_at(time_s), hiding, np.zeros((0, 2))),
            simulation.scenario.field,
        )


def crossing_rows(view: View) -> FloatArray:
    """(N, 6) of each crossing in view: width of its thinner arm (px), whether it was found, whether as what it is; if
    so, its error outwards and across (px) and that of its direction (rad).
    """
    observer, found, pose = view.observer, view.found.crossings, view.looking.pose
    field, rows = observer.field, []
    widths = observer.arm_widths(pose)
    for k in np.flatnonzero(observer.visible_crossings(view.looking)):
        crossing = field.crossings[k]
        ground = pose.inverse().transform(np.array([[crossing.x, crossing.y]]))
        pixel = observer.camera.image_from_ground(ground)[0]
        away_px, away_m = (np.hypot(*(a - b).T) for a, b in ((found.pixels, pixel), (found.positions_m, ground[0])))
        near = np.flatnonzero((away_px < _NEAR_PX) | (away_m < _NEAR_M))
        if not len(near):
            rows.append((widths[k], 0.0, 0.0, 0.0, 0.0, 0.0))
            continue
        best = near[np.argmin(away_px[near])]
        out, off = observer.view.outwards(ground)[0], found.pixels[best] - pixel
        turned = wrap_angle(float(found.orientations_rad[best]) - crossing.orientation_rad + pose.heading)
        turned = (turned + 0.25 * math.pi) % (0.5 * math.pi) - 0.25 * math.pi if crossing.kind == "X" else turned
        right = float(found.kinds[best] == crossing.kind)
        rows.append((widths[k], 1.0, right, float(off @ out), float(off @ (-out[1], out[0])), turned))
    return np.array(rows).reshape(-1, 6)


def reach_on(view: View, segment: FloatArray, ends: FloatArray) -> FloatArray:
    """(2,) how far (m) along a segment the ends (2, 2) of a found line lie; (0,) if it is not on the segment."""
    step = segment[2:] - segment[:2]
    length = math.hypot(*step)
    along, aside = step / length, np.array([-step[1], step[0]]) / length
    placed = view.looking.pose.transform(ends) - segment[:2]
    slack = _ON_LINE_M + _ON_LINE_RATIO * np.hypot(*ends.T)
    reach: FloatArray = placed @ along
    is_on = (np.abs(placed @ aside) < slack).all() and reach.min() > -_BEYOND_M and reach.max() < length + _BEYOND_M
    return reach if is_on else reach[:0]


def lines_on(view: View, segment: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(L, 2) from where to where (m) along a segment the found lines on it reach, and their ends' distance from it in
    the image (2 L,), px.
    """
    pose, camera = view.looking.pose, view.observer.camera
    start, along = segment[:2], (segment[2:] - segment[:2]) / math.hypot(*(segment[2:] - segment[:2]))
    spans, offs = [], []
    for ends, pixels in zip(view.found.lines.ends_m, view.found.lines.pixels, strict=True):
        reach = reach_on(view, segment, ends)
        if len(reach):
            spans.append((reach.min(), reach.max()))
            feet = camera.image_from_ground(pose.inverse().transform(start + reach[:, np.newaxis] * along))
            direction = (feet[1] - feet[0]) / np.hypot(*(feet[1] - feet[0]))
            offs += ((pixels - feet) @ (-direction[1], direction[0])).tolist()
    return np.array(spans).reshape(-1, 2), np.array(offs)


def covered_rows(view: View) -> FloatArray:
    """(N, 2) of places on long lines in view: width of the line there (px), and whether it was found there."""
    observer, rows = view.observer, []
    for segment, places in zip(observer.field.segments, observer._along, strict=False):
        seen = places[observer.view.shows(view.looking, places)]
        if len(seen) < 2 or math.hypot(*(seen[-1] - seen[0])) < _LONG_M:
            continue
        spans, _ = lines_on(view, segment)
        direction = (segment[2:] - segment[:2]) / math.hypot(*(segment[2:] - segment[:2]))
        widths = observer.view.widths(
            view.looking.pose, seen, np.tile(direction, (len(seen), 1)), observer.field.line_width
        )
        at = (seen - segment[:2]) @ direction
        rows.append(np.column_stack((widths, ((spans[:, :1] < at) & (at < spans[:, 1:])).any(axis=0))))
    return np.concatenate(rows) if rows else np.zeros((0, 2))


def line_rows(view: View) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(N, 2) of each stretch of a line in view its length (px) and whether it was found; errors of the ends along them
    (m) and across (px).
    """
    observer, rows, ends_m, offs_px = view.observer, [], [], []
    stretches = observer.visible_lines(view.looking)
    for segment, stretch in zip(observer.field.segments, stretches, strict=False):
        if not len(stretch):
            continue
        spans, offs = lines_on(view, segment)
        length_px = float(observer.lengths(view.looking.pose, stretch[np.newaxis])[0])
        rows.append((length_px, float(len(spans) > 0)))
        if len(spans):
            direction = (segment[2:] - segment[:2]) / math.hypot(*(segment[2:] - segment[:2]))
            reach = (stretch - segment[:2]) @ direction
            ends_m += [reach[0] - spans[:, 0].min(), spans[:, 1].max() - reach[1]]
            offs_px += offs.tolist()
    return np.array(rows).reshape(-1, 2), np.array(ends_m), np.array(offs_px)


def net_rows(view: View) -> FloatArray:
    """(N, 2) of each coloured goal whose net is in view: its length (px), and whether a line was found there."""
    observer = view.observer
    stretches = observer.visible_lines(view.looking)[len(observer.field.segments) :]
    rows = []
    for stretch in stretches:
        if len(stretch):
            spans, _ = lines_on(view, stretch.ravel())
            rows.append((float(observer.lengths(view.looking.pose, stretch[np.newaxis])[0]), float(len(spans) > 0)))
    return np.array(rows).reshape(-1, 2)


def false_lines(view: View) -> int:
    """How many lines were found that lie on no line of the field and on no net."""
    nets = [np.concatenate((places[0], places[-1])) for places in view.observer._nets]
    segments = [*view.observer.field.segments, *nets]
    return sum(not any(len(reach_on(view, segment, ends)) for segment in segments) for ends in view.found.lines.ends_m)


def landmark_rows(view: View, kind: LandmarkKind) -> FloatArray:
    """(N, 4) of each landmark of a kind in view: range (m), whether it was found, its errors outwards, across (px)."""
    observer, pose, found = view.observer, view.looking.pose, view.found.landmarks
    rows = []
    for of_kind, place, *_ in observer._landmarks:
        ground = pose.inverse().transform(np.array([place]))
        if kind is LandmarkKind.CIRCLE:
            visible = observer.shows_circle(view.looking)
        else:
            visible = bool(observer.view.shows(view.looking, np.array([place]))[0])
        if of_kind is not kind or not visible:
            continue
        away = float(np.hypot(*ground[0]))
        near = found.positions_m[found.kinds == kind.value]
        off_m = np.hypot(*(near - ground[0]).T)
        if not len(near) or off_m.min() > _LANDMARK_M + _LANDMARK_RATIO * away:
            rows.append((away, 0.0, 0.0, 0.0))
            continue
        ends = observer.camera.image_from_ground(np.array([ground[0], near[np.argmin(off_m)]]))
        out = observer.view.outwards(ground)[0]
        step = ends[1] - ends[0]
        rows.append((away, 1.0, float(step @ out), float(step @ (-out[1], out[0]))))
    return np.array(rows).reshape(-1, 4)


def fit_share(sizes: FloatArray, found: FloatArray, rising: bool) -> tuple[float, float, float]:
    """Share, half and slope of a logistic rise or fall with a size, by maximum likelihood."""
    sign = 1.0 if rising else -1.0

    def cost(v: FloatArray) -> float:
        share = np.clip(v[0], 0.01, 0.995) / (1.0 + np.exp(-sign * (sizes - v[1]) / max(abs(v[2]), 0.02)))
        share = np.clip(share, 1e-3, 1.0 - 1e-3)
        return -float(np.mean(np.where(found > 0.0, np.log(share), np.log(1.0 - share))))

    middle = float(np.median(sizes))
    share, half, slope = minimised(cost, np.array([0.9, middle, 0.3]), np.array([0.05, 0.2, 0.1]))
    return float(min(share, 0.995)), float(half), max(abs(float(slope)), 0.02)


def error_sizes(errors: FloatArray, tail: float) -> tuple[float, float]:
    """Sizes of errors (N, 2) outwards and across: their middle 68 % tell the ratio, their median length the scale."""
    size = tail / math.sinh(tail)
    shape = np.array([size * spread(errors[:, 0]), size * spread(errors[:, 1])])
    chance = np.random.default_rng(1).standard_normal((20_000, 2))
    made = np.hypot(*(shape * np.sinh(tail * chance) / tail).T)
    outwards, across = shape * float(np.median(np.hypot(*errors.T)) / np.median(made))
    return float(outwards), float(across)


def report(seen: list[View]) -> None:
    """Print the figures as they stand in `PINHOLE_FEATURES`."""
    rows = np.concatenate([crossing_rows(view) for view in seen])
    placed = rows[(rows[:, 1] > 0.0) & (rows[:, 2] > 0.0)]
    tail = math.exp(np.mean([math.log(tail_of(placed[:, column])) for column in (3, 4, 5)]))
    size = tail / math.sinh(tail)
    share, half, slope = fit_share(np.log(rows[:, 0]), rows[:, 1], True)
    wrong = 1.0 - rows[rows[:, 1] > 0.0, 2].mean()
    print(f"{len(seen)} images; {len(rows)} crossings in view, {int(rows[:, 1].sum())} found")
    outwards, across = error_sizes(placed[:, 3:5], tail)
    turned = size * spread(placed[:, 5])
    print(f"tail {tail:.2f}, outwards_px {outwards:.3f}, across_px {across:.3f}")
    print(f"orientation_deg {math.degrees(turned):.2f}, wrong_kind_ratio {wrong:.4f}")
    print(f"found_ratio {share:.3f}, found_half_px {math.exp(half):.2f}, found_log_slope {slope:.2f}")
    covered = np.concatenate([covered_rows(view) for view in seen])
    widths = np.linspace(0.5, 3.0, 126)
    thinnest = widths[np.argmin([np.mean((covered[:, 0] >= width) != covered[:, 1]) for width in widths])]
    print(f"thinnest_px {thinnest:.2f} of {len(covered)} places")
    tables = [line_rows(view) for view in seen]
    stretches, ends_m, offs_px = (np.concatenate([table[k] for table in tables]) for k in range(3))
    share, half, slope = fit_share(np.log(stretches[:, 0]), stretches[:, 1], True)
    print(f"{len(stretches)} stretches of lines, {int(stretches[:, 1].sum())} found")
    print(f"line_ratio {share:.3f}, line_half_px {math.exp(half):.1f}, line_log_slope {slope:.2f}")
    print(f"line_px {size * spread(offs_px):.3f}, line_end_m {size * spread(ends_m):.3f}")
    nets = np.concatenate([net_rows(view) for view in seen])
    long_enough = nets[nets[:, 0] > 2.0 * math.exp(half)]
    print(f"false_lines {np.mean([false_lines(view) for view in seen]):.2f}")
    print(f"net_ratio {long_enough[:, 1].mean() if len(long_enough) else 0.0:.2f} of {len(long_enough)}")
    _report_landmarks(seen, tail)


def _report_landmarks(seen: list[View], tail: float) -> None:
    for kind in (LandmarkKind.POST, LandmarkKind.POLE, LandmarkKind.PENALTY_MARK, LandmarkKind.CIRCLE):
        for field_name in (*FIELDS, None):
            parts = [landmark_rows(v, kind) for v in seen if field_name in (None, v.field_name)]
            rows = np.concatenate(parts)
            if len(rows) < 20:
                continue
            share, half, slope = fit_share(rows[:, 0], rows[:, 1], False)
            right = rows[(rows[:, 1] > 0.0) & np.isfinite(rows).all(axis=1)]
            outwards, across = error_sizes(right[:, 2:], tail)
            print(
                f"{kind} on {field_name or 'both'}: {len(rows)} in view, {int(rows[:, 1].sum())} found; "
                f"ratio {share:.3f}, half_m {half:.2f}, slope_m {slope:.2f}; outwards_px {outwards:.2f}, "
                f"across_px {across:.2f}; mean {right[:, 2].mean():.2f} outwards"
            )


def lean_errors(seeds: int) -> FloatArray:
    """(seeds, 2) deviation (degrees) of the IMU's roll and pitch from the truth at the images, about each run's mean:

    of the sample at hand when the image is taken, and of the one that tells of that moment, a lag later.
    """
    found = []
    for seed in range(1, seeds + 1):
        simulation = Simulation(open_scenario("humanoid-walk", seed, 60.0), "points")
        imu, late_ns = simulation.sensors.imu, 1e9 * simulation.scenario.sensors.imu.tilt_and_yaw_lag_s
        truth = np.array([simulation.track.attitude_at(t) for t in simulation.image_times_s])
        row = []
        for wait_ns in (0.0, late_ns):
            told = [np.interp(simulation.image_stamps + wait_ns, imu.stamp_ns, lean) for lean in imu.values[:, :2].T]
            off = np.degrees(np.column_stack(told) - truth)
            row.append(float((off - off.mean(axis=0)).std()))
        found.append(row)
    return np.array(found)


def main() -> None:
    """Render, detect, pair, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--every", type=int, default=10)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--worn", action="store_true")
    arguments = parser.parse_args()
    seen: list[View] = []
    for name in FIELDS:
        for seed in range(1, arguments.seeds + 1):
            changes = [f"field={name}", *(AS_HALLS_ARE if arguments.worn else ())]
            seen += views(Simulation(open_scenario("humanoid-walk", seed, 60.0, changes)), arguments.every)
    report(seen)
    at_once, waited = lean_errors(6).mean(axis=0)
    print(f"lean_deg {waited:.2f}; {at_once:.2f} if the IMU's lag is not made good")


if __name__ == "__main__":
    main()
