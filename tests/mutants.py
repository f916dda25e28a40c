"""Puts deliberate faults into a copy of the code and prints which of them no test notices: `make mutants`.

Each fault is one text of one file that is replaced. The tests named with it are few and quick; they must fail. A test
of `make test` holds that every text is still found exactly once. `--only WORD`: faults whose file or text has it.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import Queue
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
_SECONDS = 240.0  # a fault may make a loop endless, which is noticed as well as any
_WORKERS = 2


class Fault(NamedTuple):
    """file: below src/touchline. text: what is replaced, there once. tests, words: a file, and `pytest -k` in it."""

    file: str
    text: str
    replacement: str
    tests: str
    words: str = ""


IRIS = "localization/published/iris"
GEOMETRY, MODES, SIDE = "geometry.py", f"{IRIS}/modes.py", f"{IRIS}/field_side.py"
WHEELS, ROLLED, RECKONING = "motion/wheels.py", "motion/wheel_odometry.py", "motion/dead_reckoning.py"
PAIR, GYRO = "motion/wheel_pair.py", "motion/gyro.py"
KERNELS, TILT = "localization/published/nubot/kernels.py", "localization/published/nubot/mirror_tilt.py"
FIT, T_SURE = "localization/published/nubot/mirror_fit.py", "test_camera_uncertainty.py"
FILTER, FAILURE = "localization/published/nubot/pose_filter.py", "localization/published/nubot/failure.py"
MOTION_MODEL, SET = "localization/particles/motion_model.py", "localization/particles/particle_set.py"
RESAMPLING, IRIS = "localization/particles/resampling.py", "localization/published/iris/particles.py"
SENSOR_MODELS, RANDOM = "localization/particles/sensor_models.py", "localization/particles/random_particles.py"
CAMERA_ERRORS, RESTART = "localization/published/nubot/camera_errors.py", "localization/published/iris/restart.py"
ERROR_MAP, DISTANCES, DISTANCE_MAP = "field/error_map.py", "field/distances.py", "field/distance_map.py"
RUNS, HSV, METRICS = "perception/ray_runs.py", "perception/hsv_lines.py", "evaluation/metrics.py"
COMPASS, WEIGHTS = "localization/published/nubot/compass_correction.py", "localization/registration/weights.py"
COVARIANCE = "localization/registration/covariance.py"
STEPS, BOUND = "localization/registration/kernels.py", "localization/registration/bound.py"
JOINT, T_JOINT = "localization/estimator/joint_kernels.py", "test_joint_filter.py"
HYPOTHESES, END = "localization/estimator/pose_hypotheses.py", "localization/estimator/end_odds.py"
COMPASS_WITNESS = "localization/estimator/compass_witness.py"
T_STEPS, T_OWN = "test_registration.py", "test_touchline_system.py"
T_WHEELS, T_FUSION, T_IRIS = "test_wheels.py", "test_sensor_fusion.py", "test_iris_particles.py"
T_MCL, T_TILT, T_MATCHING = "test_nubot_particles.py", "test_mirror_tilt.py", "test_matching.py"
T_HSV, T_FIELD, T_METRICS = "test_hsv_lines.py", "test_field_distances.py", "test_evaluation_metrics.py"
T_CAMERA, T_FAILURE, T_UNSURE = "test_camera_errors.py", "test_tracking_failure.py", "test_matching_uncertainty.py"

FAULTS = (
    Fault(GEOMETRY, "self.x + c * other.x - s * other.y,", "self.x + c * other.x + s * other.y,", "test_geometry.py"),
    Fault(GEOMETRY, "Pose(-c * self.x - s * self.y, s * self.x", "Pose(-c * self.x - s * self.y, -s * self.x",
          "test_geometry.py"),
    Fault(GEOMETRY, "self.y + s * x + c * y", "self.y - s * x + c * y", "test_geometry.py"),
    # motion
    Fault(ROLLED, "s.variance(rolled.b_m, rolled.b_way_m)", "s.variance(rolled.b_m, 0.0)", T_WHEELS, "there_and_back"),
    Fault(ROLLED, "s.variance(rolled.a_m, rolled.a_way_m)", "s.variance(rolled.a_m, 0.0)", T_WHEELS, "there_and_back"),
    Fault(ROLLED, "self.b_way_m + abs(step.b_m)", "self.b_way_m + step.b_m", T_WHEELS, "there_and_back"),
    Fault(ROLLED, "ratio = math.sin(half) / half if", "ratio = 1.0 if", T_WHEELS, "arcs"),
    Fault(ROLLED, "arm_x, arm_y = -0.5 * pose.y, 0.5 * pose.x", "arm_x, arm_y = 0.0, 0.0", T_WHEELS, "many_noisy"),
    Fault(WHEELS, "self.slip_m**2 * way_m", "self.slip_m**2 * abs(travel_m)", T_WHEELS, "there_and_back"),
    Fault(WHEELS, "restarted = zeroed or speed_m_s > MAX_SPEED_M_S", "restarted = False", T_WHEELS, "starts_again"),
    Fault(PAIR, "a_m * math.sin(b) - b_m * math.sin(a)", "a_m * math.sin(b) + b_m * math.sin(a)", T_WHEELS, "printed"),
    Fault(PAIR, "b_m - self.b_lever_m * turn_rad", "b_m", T_WHEELS, "inverse"),
    Fault(GYRO, "0.5 * (last_rad_s + rate_rad_s)", "rate_rad_s", T_WHEELS, "changing_velocity"),
    Fault(GYRO, "s.scale * (reading - s.bias_rad_s)", "reading - s.bias_rad_s", T_WHEELS, "scales_and_bias"),
    Fault(GYRO, " + (self.bias_error_rad_s * duration_s) ** 2", "", T_WHEELS, "many_noisy"),
    Fault(RECKONING, "Pose(0.0, 0.0, -0.5 * turn_rad)", "Pose(0.0, 0.0, 0.0)", T_FUSION, "without_its_bias"),
    Fault(RECKONING, "self.stamp_ns - self._summed_ns > int(", "self.stamp_ns < int(", T_CAMERA, "come_back"),
    # matching
    Fault(KERNELS, "c2 - 3.0 * d * d", "c2 - d * d", T_UNSURE, "curvature"),
    Fault(KERNELS, "slope_heading += slope * (gy * turned_x -", "slope_heading += slope * (gy * turned_x +",
          T_MATCHING, "error_and_gradient"),
    Fault(KERNELS, "min(steps[k] * grow, largest_steps[k])", "steps[k]", T_MATCHING, "steps_grow"),
    Fault(KERNELS, "if error < best_error:", "if error < 9.0:", T_MATCHING, "best_pose_seen"),
    Fault(KERNELS, "slope = weights[i] * k * k * d", "slope = weights[i] * k * d", T_MATCHING, "error_and_gradient"),
    Fault(TILT, "(fit.covariance + drift)", "fit.covariance", T_TILT, "loosens"),
    Fault(TILT, "return 1.0 / (1.0 + math.exp(min(odds, 50.0)))", "return 1.0", T_SURE, "spoilt"),
    Fault(FIT, "(qx + square * errors[0]), nearer * (qy + square * errors[1])", "qx, nearer * qy", T_TILT, "one_focus"),
    Fault(FIT, "row[2] = ry * bx - rx * by", "row[2] = ry * bx + rx * by", T_TILT, "numeric_derivative"),
    Fault(WEIGHTS, "points.confidences / (variance", "1.0 / (variance", T_MATCHING, "weights_fall"),
    Fault(WEIGHTS, "settings.range_noise_relative * ranges_m", "settings.range_noise_relative", T_MATCHING,
          "weights_fall"),
    Fault(COVARIANCE, "np.maximum(values - CLUTTER_RATIO * values.mean(), 0.0)", "values", T_UNSURE, "stray"),
    # registration, and the hypotheses of touchline
    Fault(STEPS, "a12 += weight * oy * turn", "a12 -= weight * oy * turn", T_STEPS, "plain_numpy"),
    Fault(STEPS, "reach * reach / (every * every * spread)", "reach / (every * spread)", T_STEPS, "plain_numpy"),
    Fault(BOUND, "lever[:, 0] - normals[:, 0]", "lever[:, 0] + normals[:, 0]", T_STEPS, "bound_of_a_cross"),
    Fault(JOINT, "gain[a, b] *= moving[a]", "pass", T_JOINT, "stay_as_unknown"),
    Fault(JOINT, " - crossed[a, k] * shared[b, k]", "", T_JOINT, "inverse_information"),
    Fault(HYPOTHESES, "REPEATED - fit.contradiction", "REPEATED", T_JOINT, "lone"),
    Fault(JOINT, "left -= swing[a, b] * by_all[a, 3 + b]", "pass", T_JOINT, "shaking"),
    Fault(HYPOTHESES, "before + CARRIED_AWAY +", "before - 500.0 +", T_OWN, "moved_unfelt"),
    Fault(COMPASS_WITNESS, "-1 if error > FAR_RAD", "0 if error > FAR_RAD", T_OWN, "turns_the_pose"),
    Fault(COMPASS_WITNESS, "_both_ends(self._failed)", "_both_ends(COMPASS_FALSE)", T_OWN, "lost_robot"),
    Fault(COMPASS_WITNESS, "elapsed_s / FAULT_EVERY_S", "elapsed_s / 1e9", T_OWN, "robot_that_is_followed"),
    Fault(COMPASS_WITNESS, "0: ((UNLIKELY, 1.0)", "0: ((UNLIKELY, 0.1)", T_OWN, "stuck_compass"),
    # fusion of nubot-mti
    Fault(FILTER, "max(BETTER_FACTOR * error, error + BETTER_MARGIN)", "BETTER_FACTOR * error", "test_tracking.py",
          "margin"),
    Fault(FILTER, " + gain @ covariance @ gain.T", "", "test_tracking.py", "equal_opinions"),
    Fault(FAILURE, "self.bad_frames >= s.frames", "self.bad_frames > s.frames", T_FAILURE, "five_frames"),
    Fault(FAILURE, "self.blind_frames + 1 if blind else 0", "self.blind_frames + 1", T_FAILURE),
    Fault(COMPASS, "self.offset_rad + self.settings.gain", "self.offset_rad - self.settings.gain",
          T_FAILURE, "settles"),
    Fault(COMPASS, "plausible or not self.settings", "True or not self.settings", T_FAILURE, "wrong_end"),
    # particles
    Fault(MOTION_MODEL, "cosine * ahead - sine * left", "cosine * ahead + sine * left", T_MCL, "composed_with"),
    Fault(MOTION_MODEL, "sine * ahead + cosine * left", "sine * ahead - cosine * left", T_MCL, "composed_with"),
    Fault(MOTION_MODEL, "(s.rotation_from_rotation * motion.pose.heading) ** 2", "0.0", T_MCL, "in_proportion"),
    Fault(RESAMPLING, "tooth = (start + k) / count", "tooth = (0.5 + k) / count", T_MCL, "exactly_the_weight"),
    Fault(RESAMPLING, "math.sqrt(a) * KLD_QUANTILE) ** 3", "math.sqrt(a) * KLD_QUANTILE) ** 2", T_MCL, "kld_numbers"),
    Fault(RESAMPLING, "bins[:, 2] %= turns", "bins[:, 2] %= 2 * turns", T_MCL, "bins"),
    Fault(RESAMPLING, "min(estimate.deviation_m / self.uncertain_m, 1.0)", "estimate.deviation_m / self.uncertain_m",
          "test_particle_filter.py", "certainty"),
    Fault(RESAMPLING, "if total * total >= min_effective * squares:", "if total * total >= squares:", T_IRIS,
          "tempering_leaves"),
    Fault(SET, "squares += weights[j] * weights[j]", "squares += weights[j]", T_MCL, "square_of_the_sum"),
    Fault(SET, "xy += wy * dx", "xy += wx * dx", T_MCL, "agree_with_numpy"),
    Fault(SET, "turned -= 2.0 * math.pi * math.floor", "turned -= 0.0 * math.floor", T_MCL, "circular"),
    Fault(SENSOR_MODELS, "total += weights[i] * squares", "total += squares", T_MCL, "numpy_twin"),
    Fault(SENSOR_MODELS, "fy = shift_y + sine * points[i, 0] +", "fy = shift_y - sine * points[i, 0] +", T_MCL,
          "numpy_twin"),
    Fault(SENSOR_MODELS, "np.minimum(error_map.values.astype(np.float32), np.float32(max_units)) ** 2",
          "error_map.values.astype(np.float32) ** 2", T_IRIS, "equation_9"),
    Fault(RANDOM, "_averaged(self._log_fast, log_mean, self.fast)", "_averaged(self._log_fast, log_mean, self.slow)",
          "test_particle_filter.py", "both_averages"),
    Fault(IRIS, "if 0 < len(kept) < len(inside):", "if len(kept) < 0:", T_IRIS, "outside_of_a_region"),
    Fault(IRIS, "count = int(s.paper.nearby_ratio * len(self.particles))", "count = 0", T_IRIS, "about_the_fused"),
    Fault(IRIS, "poses[:, 2] -= math.pi * np.round", "poses[:, 2] -= 0.0 * np.round", T_IRIS, "hardly_known"),
    # fusion of iris-fusion
    Fault(MODES, "beta * odometry.x + (1.0 - beta) * particles.x", "particles.x", T_FUSION, "weighted_mean"),
    Fault(MODES, "learned = self.bias_rad_s - gain", "learned = self.bias_rad_s + gain", T_FUSION, "bias_is_learned"),
    Fault(MODES, "beta **= max(", "beta *= 1.0 / max(", T_FUSION, "after_a_gap"),
    Fault(MODES, "alone and self.agreeing < FRAMES", "alone and self.agreeing < 0", T_FUSION, "after_three"),
    Fault(MODES, "self.contradicting >= FRAMES", "self.contradicting >= 1", T_FUSION, "elsewhere"),
    Fault(MODES, "_spread_m(self.bound) > self.settings.lost_m", "_spread_m(self.bound) > 1e9", T_FUSION, "is_lost"),
    Fault(RESTART, "enough = 1 if self._blind >= BLIND_FRAMES else FRAMES", "enough = FRAMES", T_FUSION,
          "contradict_them"),
    Fault(RESTART, "WIDENING ** (self._starts - 1)", "WIDENING**self._starts", T_FUSION, "wider_headings"),
    Fault(SIDE, "return self._against > self._agreed + PATIENCE_FRAMES", "return True", T_FUSION, "turns_round"),
    Fault(SIDE, "self.doubted |= self._confirmed", "self.doubted |= False", T_FUSION, "turns_round"),
    Fault(SIDE, "not self._unsettled or self._had_turned or", "True or", T_FUSION, "changes_its_mind"),
    Fault(CAMERA_ERRORS, "self.mean = self.covariance @ (known @ self.mean + share @ said)", "pass", T_CAMERA,
          "learned_within"),
    Fault(CAMERA_ERRORS, "np.zeros((0, 2)) if shown is None else ground_scales(shown)", "np.zeros((0, 2))", T_CAMERA,
          "displaced"),
    Fault(CAMERA_ERRORS, "= loose, np.linalg.inv(self.covariance + self._swing)", "= loose, 1e9 * np.eye(ERRORS)",
          T_CAMERA, "unsure"),
    Fault(CAMERA_ERRORS, "return fit.errors if", "return self.mean if", T_CAMERA, "shakes"),
    Fault(CAMERA_ERRORS, "np.linalg.inv(self.covariance + self._swing)", "np.linalg.inv(self.covariance)", T_CAMERA,
          "shakes"),
    Fault(MODES, "said = image.after(self.covariance, self.bound)", "pass", T_FUSION, "err_as_the_odometry"),
    # field, perception, evaluation
    Fault(ERROR_MAP, "distances.values[:, :, 0] / farthest_m", "distances.values[:, :, 0] / (2.0 * farthest_m)",
          "test_error_map.py"),
    Fault(ERROR_MAP, "(points[i, 0] - origin_x) / resolution_m + 0.5", "(points[i, 0] - origin_x) / resolution_m",
          "test_error_map.py"),
    Fault(DISTANCES, "along = min(max(along, 0.0), 1.0)", "along = max(along, 0.0)", T_FIELD, "known_by_hand"),
    Fault(DISTANCES, "sweep = arc_sweep(start, end)\n", "sweep = 0.5 * arc_sweep(start, end)\n", T_FIELD, "densely"),
    Fault(DISTANCE_MAP, "w01, w10 = fx - w11, fy - w11", "w10, w01 = fx - w11, fy - w11", T_FIELD,
          "bilinear"),
    Fault(RUNS, "half = 0.5 * (levels[peak] + darkest)", "half = 0.25 * (levels[peak] + darkest)", T_HSV, "plain_twin"),
    Fault(RUNS, "if not length_m <= limits.max_run_m:", "if length_m > 1e9:", T_HSV, "plain_twin or wide_white"),
    Fault(HSV, "white, white & field)", "white, white)", T_HSV, "left_out_by_the_hull"),
    Fault(HSV, "radius <= mirror.inner_radius_px)[", "radius <= 0.0)[", T_HSV, "stand_close"),
    Fault("perception/hsv_thresholds.py", "_FAINT_SHARE = 0.2", "_FAINT_SHARE = 2.0", T_HSV, "more_grey"),
    Fault(METRICS, "values[:, 2] = wrap_angles(values[:, 2])", "values[:, 2] = values[:, 2]", T_METRICS,
          "short_way"),
    Fault(METRICS, "stamp_ns - truth_stamp_ns[before] <=", "stamp_ns - truth_stamp_ns[before] >",
          T_METRICS, "nearest_truth or brute"),
)  # fmt: skip


def source(fault: Fault, root: Path = ROOT) -> Path:
    """The file that a fault is put into."""
    return root / "src" / "touchline" / fault.file


def found(fault: Fault) -> int:
    """How often its text stands in its file."""
    return source(fault).read_text(encoding="utf-8").count(fault.text)


def copied_tree(folder: Path) -> Path:
    """A copy of code and tests with their compiled loops; whatever else tests look at is linked to."""
    folder.mkdir()
    for each in ROOT.iterdir():
        if each.name in ("src", "tests"):
            shutil.copytree(each, folder / each.name, symlinks=True)
        elif not each.name.startswith("."):
            (folder / each.name).symlink_to(each)
    return folder


def outcome(fault: Fault, tree: Path) -> str:
    """What became of a fault: "found", "survived", or what went wrong with the tests themselves."""
    file = source(fault, tree)
    whole = file.read_text(encoding="utf-8")
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", f"tests/{fault.tests}"]
    environment = {**os.environ, "PYTHONPATH": str(tree / "src")}
    file.write_text(whole.replace(fault.text, fault.replacement), encoding="utf-8")
    try:
        run = subprocess.run(
            [*command, *(("-k", fault.words) if fault.words else ())],
            cwd=tree, env=environment, capture_output=True, text=True, timeout=_SECONDS, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return "found"
    finally:
        file.write_text(whole, encoding="utf-8")
    if run.returncode in (0, 1):
        return "found" if run.returncode else "survived"
    return f"no test was run (pytest's exit status {run.returncode})"


def outcomes(faults: Sequence[Fault]) -> Iterator[tuple[Fault, str]]:
    """Every fault with what became of it, in order."""
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(_WORKERS) as pool:
        trees: Queue[Path] = Queue()
        for number in range(_WORKERS):
            trees.put(copied_tree(Path(folder) / str(number)))

        def tried(fault: Fault) -> str:
            tree = trees.get()
            try:
                return outcome(fault, tree)
            finally:
                trees.put(tree)

        yield from zip(faults, pool.map(tried, faults), strict=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", metavar="WORD", help="faults whose file or text has this word")
    only = parser.parse_args().only
    faults = [fault for fault in FAULTS if only in fault.file or only in fault.text]
    survived = 0
    for fault, end in outcomes(faults):
        if end != "found":
            survived += 1
            print(
                f"{end}: {fault.file}: {fault.text!r} -> {fault.replacement!r} ({fault.tests}, {fault.words})",
                flush=True,
            )
    print(f"{len(faults) - survived} of {len(faults)} faults are found, {survived} are not")
    return int(survived > 0)


if __name__ == "__main__":
    sys.exit(main())
