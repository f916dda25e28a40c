"""lu2013-timing (figure 12) and xiong-timing (figure 11)."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from matplotlib.figure import Figure

from touchline.experiments.progress import follow
from touchline.experiments.result import ExperimentResult, Headline, spread
from touchline.experiments.scenes import BLUE, FIELD, RED, new_figure, random_place, the_views
from touchline.field import open_field
from touchline.geometry import FloatArray, Pose
from touchline.localization.matching.matcher import Matcher
from touchline.localization.particles.nubot_particles import NubotParticlePaper, NubotParticles, NubotParticleSettings
from touchline.motion.odometry import Motion
from touchline.simulation.run import Simulation
from touchline.simulation.scenario import open_scenario
from touchline.systems import RobotSetup
from touchline.systems.nubot_mti import NubotMti, NubotMtiSettings
from touchline.types import Frame

CYCLES = 1000
COUNTS = (100, 300, 600, 1000, 3000, 10_000, 30_000, 100_000)
MOTION = Motion(Pose(0.1, 0.0, 0.02), np.diag([1e-4, 1e-4, 1e-5]), 0.0)
POINTS = 100
POINT_COUNTS = (10, 30, 300, 1000)


def lu2013_timing(seeds: int) -> ExperimentResult:
    """1000 cycles of the particle part and of the matching part, each seed from another place; then the curve."""
    matcher = Matcher(open_field(FIELD).distance_map())
    particle_ms = np.array([_particle_cycles(matcher, seed, CYCLES) for seed in follow(range(seeds), "particles")])
    refined = follow(range(seeds), "refined clusters")
    refined_ms = np.array([_particle_cycles(matcher, seed, CYCLES, refined=5) for seed in refined])
    matching_ms = np.array([_matching_cycles(matcher, seed) for seed in follow(range(seeds), "matching")])
    counts = follow(COUNTS, "numbers of particles")
    curve_us = [1e3 * float(np.min(_particle_cycles(matcher, 0, max(20, 20_000 // n), n))) for n in counts]
    by_points_us = [1e3 * float(np.min(_particle_cycles(matcher, 0, 200, points=n))) for n in POINT_COUNTS]
    weights_us, plain_us = _weights_and_twin(matcher)
    rows = [
        _row("particles: one cycle, 600 x 100", "15-25 ms", particle_ms),
        _row("particles: the same with five refined clusters", "–", refined_ms),
        _row("matching: one cycle, 100 points", "1-3 ms", matching_ms),
    ]
    rows += [
        ("particles: weights alone, 600 x 100", "–", f"{weights_us:.0f} µs", "", ""),
        ("particles: weights alone, plain NumPy", "–", f"{plain_us:.0f} µs", f"{plain_us / weights_us:.0f} times", ""),
    ]
    slope = np.polyfit(np.log(COUNTS[2:]), np.log(curve_us[2:]), 1)[0]
    rows += [
        (f"particles: {n} x 100", "–", f"{us:.0f} µs", f"{1e3 * us / (n * POINTS):.1f} ns per particle and point", "")
        for n, us in zip(COUNTS, curve_us, strict=True)
    ]
    rows += [
        (f"particles: 600 x {n}", "–", f"{us:.0f} µs", f"{1e3 * us / (600 * n):.1f} ns per particle and point", "")
        for n, us in zip(POINT_COUNTS, by_points_us, strict=True)
    ]
    return ExperimentResult(
        "lu2013-timing",
        "Figure 12 of Lu et al. 2013: time of one cycle of the particle part and of the matching part",
        seeds,
        ("part", "paper", "median", "99 %", "longest"),
        tuple(rows),
        Headline("one cycle of 600 particles; of matching (median)", "15-25 ms; 1-3 ms",
                 f"{_median_us(particle_ms)}; {_median_us(matching_ms)}"),
        (
            f"{CYCLES} cycles per seed on one core: motion, weights, resampling in every cycle, estimate, {POINTS} "
            "points at the observation level; processor time, so that other work on the machine doesn't count. The "
            "paper's computer had a 1.66 GHz processor.",
            f"From 600 to 100 000 particles the time grows with the power {slope:.2f} of their number (fastest of 20 "
            "cycles or more).",
        ),
        (("cycles", _cycles_figure(particle_ms[0], matching_ms[0])), ("particles", _curve_figure(curve_us))),
    )  # fmt: skip


def _median_us(times_ms: FloatArray) -> str:
    return f"{spread(1e3 * np.median(times_ms, axis=1), 0)} µs"


def _row(name: str, paper: str, times_ms: FloatArray) -> tuple[str, ...]:
    """times_ms: (seeds, cycles)."""
    late = np.quantile(times_ms, 0.99, axis=1)
    return name, paper, _median_us(times_ms), f"{spread(1e3 * late, 0)} µs", f"{spread(times_ms.max(axis=1), 1)} ms"


def _seen(seed: int) -> tuple[Pose, FloatArray]:
    """A place from which at least so many points are seen, and that many of them."""
    rng = np.random.default_rng([seed, 12])
    while True:
        pose = random_place(open_field(FIELD), rng, margin_m=1.0)
        points = the_views().observe(pose, rng).positions_m
        if len(points) >= POINTS:
            return pose, np.ascontiguousarray(points[rng.permutation(len(points))[:POINTS]])


def _timed(work: Callable[[], object], cycles: int) -> FloatArray:
    """Processor time (ms) (cycles,) of each call; a few calls before compile and warm."""
    for _ in range(5):
        work()
    times = np.empty(cycles)
    for k in range(cycles):
        start = time.process_time()
        work()
        times[k] = time.process_time() - start
    return 1e3 * times


def _particle_cycles(
    matcher: Matcher, seed: int, cycles: int, particles: int = 600, refined: int = 0, points: int = POINTS
) -> FloatArray:
    settings = NubotParticleSettings(
        particles=particles, paper=NubotParticlePaper(refined_clusters=refined, resampling_threshold=1.0)
    )
    pose, seen = _seen(seed)
    chosen = np.resize(seen, (points, 2))  # more than are seen: again from the first on
    mcl = NubotParticles(matcher, 18.0, 12.0, np.random.default_rng(seed), settings)
    mcl.restart(pose.heading)

    def cycle() -> None:
        mcl.predict(MOTION)
        mcl.update(chosen, None)

    return _timed(cycle, cycles)


def _weights_and_twin(matcher: Matcher) -> tuple[float, float]:
    """Fastest time (µs) of the weights of 600 particles and 100 points: compiled, and in plain NumPy."""
    pose, points = _seen(0)
    settings = NubotParticleSettings(paper=NubotParticlePaper(farthest_sigmas=None))
    mcl = NubotParticles(matcher, 18.0, 12.0, np.random.default_rng(0), settings)
    mcl.restart(pose.heading)
    particles, table = mcl.particles.poses, matcher.distance_map
    squares = table.values[::2, ::2, 0] ** 2
    step_m = 2.0 * table.resolution_m

    def plain() -> FloatArray:
        c, s = np.cos(particles[:, 2:]), np.sin(particles[:, 2:])
        x = particles[:, :1] + c * points[:, 0] - s * points[:, 1]
        y = particles[:, 1:2] + s * points[:, 0] + c * points[:, 1]
        ix = np.clip((x - table.origin_m[0]) / step_m + 0.5, 0, squares.shape[1] - 1).astype(int)
        iy = np.clip((y - table.origin_m[1]) / step_m + 0.5, 0, squares.shape[0] - 1).astype(int)
        return np.asarray(-squares[iy, ix].sum(axis=1))

    compiled = _timed(lambda: mcl.log_likelihoods(points, None, particles), 200)
    return 1e3 * float(compiled.min()), 1e3 * float(_timed(plain, 50).min())


def _matching_cycles(matcher: Matcher, seed: int) -> FloatArray:
    """Matching from a prediction 5 cm and 1 degree off, with the covariance of the match."""
    pose, points = _seen(seed)
    start = Pose(pose.x + 0.05, pose.y - 0.05, pose.heading + 0.02)
    weights = np.full(len(points), 1.0 / len(points))
    return _timed(lambda: matcher.match(points, weights, start), CYCLES)


def _cycles_figure(particle_ms: FloatArray, matching_ms: FloatArray) -> Figure:
    """As figure 12: red the particles, blue the matching, over the cycles."""
    figure, (axes,) = new_figure()
    axes.plot(particle_ms, color=RED, linewidth=0.8, label="particles, 600 x 100 points")
    axes.plot(matching_ms, color=BLUE, linewidth=0.8, label="matching, 100 points")
    axes.set_ylim(0.0, 4.0 * float(np.median(particle_ms)))  # beyond are cycles that other programs interrupted
    axes.set_xlabel("cycle")
    axes.set_ylabel("time (ms)")
    axes.legend(frameon=False)
    return figure


def _curve_figure(curve_us: list[float]) -> Figure:
    figure, (axes,) = new_figure()
    axes.loglog(COUNTS, curve_us, "o-", color=RED)
    axes.axhspan(15e3, 25e3, xmin=0.0, color=BLUE, alpha=0.15, label="the paper's 600 particles")
    axes.set_xlabel("particles")
    axes.set_ylabel("time of one cycle with 100 points (µs)")
    axes.legend(frameon=False)
    return figure


def xiong_timing(seeds: int) -> ExperimentResult:
    """Whole frames, image to pose, on rendered images: once searching in every frame, once tracking."""
    found = [_whole_frames(seed) for seed in follow(range(seeds), "drives")]
    searching, tracking = (np.array([times[k] for times in found]) for k in (0, 1))
    rows = (
        _row("whole frame, global localization", "35-45 ms", searching),
        _row("whole frame, tracking", "18-24 ms", tracking),
    )
    return ExperimentResult(
        "xiong-timing",
        "Figure 11 of Xiong et al.: time of a whole frame in global localization and in tracking",
        seeds,
        ("part", "paper", "median", "99 %", "longest"),
        rows,
        Headline("whole frame searching; tracking (median)", "35-45 ms; 18-24 ms",
                 f"{_median_us(searching)}; {_median_us(tracking)}"),
        (
            "Rendered images of 480 x 480 pixels on one core, from the image array to the pose, processor time; the "
            "paper's times include grabbing the image, on a 1.66 GHz processor.",
        ),
        (("frames", _frames_figure(searching[0], tracking[0])),),
    )  # fmt: skip


def _whole_frames(seed: int, count: int = 40) -> tuple[FloatArray, FloatArray]:
    simulation = Simulation(open_scenario("straight-tracks", seed, (count + 10) / 10.0, ["ideal=true"]))
    frames = list(simulation)
    return _frame_times(simulation, frames, count, search=True), _frame_times(simulation, frames, count, search=False)


def _frame_times(simulation: Simulation, frames: list[Frame], count: int, search: bool) -> FloatArray:
    """Milliseconds (count,) per frame; search: the pose is forgotten before each."""
    setup = RobotSetup(simulation.field, simulation.camera)
    system = NubotMti(setup, NubotMtiSettings(), np.random.default_rng(0))
    times = []
    for frame in frames:
        if search:
            system.belief.lose()
        start = time.process_time()
        system.step(frame)
        times.append(1e3 * (time.process_time() - start))
    return np.array(times[-count:])


def _frames_figure(searching_ms: FloatArray, tracking_ms: FloatArray) -> Figure:
    """As figure 11: red the global localization, blue the tracking."""
    figure, (axes,) = new_figure()
    axes.plot(searching_ms, color=RED, linewidth=1.0, label="global localization")
    axes.plot(tracking_ms, color=BLUE, linewidth=1.0, label="tracking")
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("frame")
    axes.set_ylabel("time (ms)")
    axes.legend(frameon=False)
    return figure
