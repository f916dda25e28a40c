"""lu2013-timing (figure 12) and xiong-timing (figure 11)."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import cache

import numpy as np
from matplotlib.figure import Figure

from touchline.config import Settings
from touchline.experiments.progress import follow
from touchline.experiments.result import ExperimentResult, Headline, spread
from touchline.experiments.scenes import BLUE, FIELD, RED, new_figure, points_from, random_place
from touchline.field import open_field
from touchline.geometry import FloatArray, Pose
from touchline.localization.published.nubot.matcher import Matcher
from touchline.localization.published.nubot.particles import NubotParticlePaper, NubotParticles, NubotParticleSettings
from touchline.motion.odometry import Motion
from touchline.simulation.run import Simulation
from touchline.simulation.scenario import open_scenario
from touchline.systems import RobotSetup, paper_settings
from touchline.systems.nubot_mcl import NubotMclSettings
from touchline.systems.nubot_mti import NubotMti, NubotMtiSettings
from touchline.types import Frame

CYCLES = 1000
COUNTS = (100, 300, 600, 1000, 3000, 10_000, 30_000, 100_000)
MOTION = Motion(Pose(0.1, 0.0, 0.02), np.diag([1e-4, 1e-4, 1e-5]), 0.0)
POINTS = 100
POINT_COUNTS = (10, 30, 300, 1000)
FRAMES = 20
COLUMNS = ("part", "paper", "its form here: median", "median", "99 %", "longest", "ideal robot: median")


def lu2013_timing(seeds: int) -> ExperimentResult:
    """1000 cycles of the particle part and of the matching part, each seed from another place; then the curve."""
    matcher = Matcher(open_field(FIELD).distance_map())
    ours, ideal = (
        [_parts(matcher, seed, CYCLES, best) for seed in follow(range(seeds), name)]
        for best, name in ((False, "robots as built"), (True, "ideal robots"))
    )
    paper = [_paper_parts(seed, CYCLES) for seed in follow(range(seeds), "in the paper's form")]
    particle_ms, refined_ms, matching_ms = (np.array([part[k] for part in ours]) for k in range(3))
    best_ms = [np.array([part[k] for part in ideal]) for k in range(3)]
    paper_ms = [np.array([part[k] for part in paper]) for k in range(2)]
    counts = follow(COUNTS, "numbers of particles")
    curve_us = [1e3 * float(np.min(_particle_cycles(matcher, 0, max(20, 20_000 // n), n))) for n in counts]
    by_points_us = [1e3 * float(np.min(_particle_cycles(matcher, 0, 200, points=n))) for n in POINT_COUNTS]
    weights_us, plain_us = _weights_and_twin(matcher)
    rows = [
        _row("particles: one cycle, 600 x 100", "15-25 ms", particle_ms, paper_ms[0], best_ms[0]),
        _row("particles: the same with five refined clusters", "–", refined_ms, None, best_ms[1]),
        _row("matching: one cycle, 100 points", "1-3 ms", matching_ms, paper_ms[1], best_ms[2]),
    ]
    rows += [
        _lone("particles: weights alone, 600 x 100", weights_us),
        _lone("particles: weights alone, plain NumPy", plain_us, f"{plain_us / weights_us:.0f} times"),
    ]
    slope = np.polyfit(np.log(COUNTS[2:]), np.log(curve_us[2:]), 1)[0]
    for prefix, each, many in (("{} x 100", COUNTS, curve_us), ("600 x {}", POINT_COUNTS, by_points_us)):
        for n, us in zip(each, many, strict=True):
            pairs = n * (POINTS if each is COUNTS else 600)
            rows.append(
                _lone(f"particles: {prefix.format(n)}", us, f"{1e3 * us / pairs:.1f} ns per particle and point")
            )
    return ExperimentResult(
        "lu2013-timing",
        "Figure 12 of Lu et al. 2013: time of one cycle of the particle part and of the matching part",
        seeds,
        COLUMNS,
        tuple(rows),
        Headline("one cycle of 600 particles; of matching (median)", "15-25 ms; 1-3 ms",
                 f"{_median_us(particle_ms)}; {_median_us(matching_ms)}; its form {_median_us(paper_ms[0])}; "
                 f"{_median_us(paper_ms[1])}"),
        (
            f"{CYCLES} cycles per seed on one core: motion, weights, resampling in every cycle, estimate, {POINTS} "
            "points at the observation level; processor time, so that other work on the machine doesn't count. The "
            "paper's computer had a 1.66 GHz processor. Robots as built; its form here: with the system's preset "
            "`paper`.",
            f"From 600 to 100 000 particles the time grows with the power {slope:.2f} of their number (fastest of 20 "
            "cycles or more).",
        ),
        (("cycles", _cycles_figure(particle_ms[0], matching_ms[0])), ("particles", _curve_figure(curve_us))),
    )  # fmt: skip


def _parts(matcher: Matcher, seed: int, cycles: int, ideal: bool) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Milliseconds (cycles,) of particles, of the same with refined clusters, and of matching."""
    return (
        _particle_cycles(matcher, seed, cycles, ideal=ideal),
        _particle_cycles(matcher, seed, cycles, refined=5, ideal=ideal),
        _matching_cycles(matcher, seed, ideal),
    )


def _paper_parts(seed: int, cycles: int) -> tuple[FloatArray, FloatArray]:
    """Milliseconds (cycles,) of particles and of matching by the paper's own form."""
    settings = paper_settings("nubot-mcl")
    assert isinstance(settings, NubotMclSettings)
    matcher = Matcher(open_field(FIELD).distance_map(), settings.matching)
    return _cycles_of(matcher, seed, cycles, settings.particles), _matching_cycles(matcher, seed)


def _median_us(times_ms: FloatArray) -> str:
    return f"{spread(1e3 * np.median(times_ms, axis=1), 0)} µs"


def _row(
    name: str, paper: str, times_ms: FloatArray, paper_ms: FloatArray | None, ideal_ms: FloatArray
) -> tuple[str, ...]:
    """times_ms, paper_ms (its form here), ideal_ms: (seeds, cycles)."""
    late = np.quantile(times_ms, 0.99, axis=1)
    return (
        name, paper, "–" if paper_ms is None else _median_us(paper_ms), _median_us(times_ms),
        f"{spread(1e3 * late, 0)} µs", f"{spread(times_ms.max(axis=1), 1)} ms", _median_us(ideal_ms),
    )  # fmt: skip


def _lone(name: str, us: float, more: str = "") -> tuple[str, ...]:
    """A row of a single figure."""
    return name, "–", "", f"{us:.0f} µs", more, "", ""


@cache
def _seen(seed: int, ideal: bool) -> tuple[Pose, FloatArray]:
    """A place from which at least so many points are seen, and that many of them."""
    rng = np.random.default_rng([seed, 12])
    while True:
        pose = random_place(open_field(FIELD), rng, margin_m=1.0)
        points = points_from(pose, seed, ideal).positions_m
        if len(points) >= POINTS:
            return pose, np.ascontiguousarray(points[rng.permutation(len(points))[:POINTS]])


def _timed(work: Callable[[], object], cycles: int) -> FloatArray:
    """Processor time (ms) (cycles,) of each call; a few calls before compile and warm."""
    for _ in range(5):
        work()
    times = np.empty(cycles)
    for k in range(cycles):
        start = time.thread_time()  # a process's clock may go on in steps of 4 ms
        work()
        times[k] = time.thread_time() - start
    return 1e3 * times


def _particle_cycles(
    matcher: Matcher, seed: int, cycles: int, particles: int = 600, refined: int = 0, points: int = POINTS,
    ideal: bool = False,
) -> FloatArray:  # fmt: skip
    settings = NubotParticleSettings(
        particles=particles, paper=NubotParticlePaper(refined_clusters=refined, resampling_threshold=1.0)
    )
    return _cycles_of(matcher, seed, cycles, settings, points, ideal)


def _cycles_of(
    matcher: Matcher, seed: int, cycles: int, settings: NubotParticleSettings, points: int = POINTS,
    ideal: bool = False,
) -> FloatArray:  # fmt: skip
    pose, seen = _seen(seed, ideal)
    chosen = np.resize(seen, (points, 2))  # more than are seen: again from the first on
    mcl = NubotParticles(matcher, 18.0, 12.0, np.random.default_rng(seed), settings)
    mcl.restart(pose.heading)

    def cycle() -> None:
        mcl.predict(MOTION)
        mcl.update(chosen, None)

    return _timed(cycle, cycles)


def _weights_and_twin(matcher: Matcher) -> tuple[float, float]:
    """Fastest time (µs) of the weights of 600 particles and 100 points: compiled, and in plain NumPy."""
    pose, points = _seen(0, False)
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


def _matching_cycles(matcher: Matcher, seed: int, ideal: bool = False) -> FloatArray:
    """Matching from a prediction 5 cm and 1 degree off, with the covariance of the match."""
    pose, points = _seen(seed, ideal)
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
    ours, paper = [], []
    for seed in follow(range(seeds), "drives"):
        simulation, frames = _rendered(seed)
        ours.append(_whole_frames(simulation, frames, NubotMtiSettings()))
        paper.append(_whole_frames(simulation, frames, paper_settings("nubot-mti")))
    ideal = [_whole_frames(*_rendered(seed, True), NubotMtiSettings()) for seed in follow(range(seeds), "ideal robots")]
    parts = [[np.array([times[k] for times in some]) for some in (ours, paper, ideal)] for k in (0, 1)]
    (searching, *_), (tracking, *_) = parts
    rows = (
        _row("whole frame, global localization", "35-45 ms", *parts[0]),
        _row("whole frame, tracking", "18-24 ms", *parts[1]),
    )
    return ExperimentResult(
        "xiong-timing",
        "Figure 11 of Xiong et al.: time of a whole frame in global localization and in tracking",
        seeds,
        COLUMNS,
        rows,
        Headline("whole frame searching; tracking (median)", "35-45 ms; 18-24 ms",
                 f"{_median_us(searching)}; {_median_us(tracking)}; its form {_median_us(parts[0][1])}; "
                 f"{_median_us(parts[1][1])}"),
        (
            "Rendered images of 480 x 480 pixels on one core, from the image array to the pose, processor time; the "
            f"paper's times include grabbing the image, on a 1.66 GHz processor. Robots as built, {FRAMES} frames "
            "each; its form here: with the system's preset `paper`.",
        ),
        (("frames", _frames_figure(searching[0], tracking[0])),),
    )  # fmt: skip


def _rendered(seed: int, ideal: bool = False) -> tuple[Simulation, list[Frame]]:
    """A drive and its images."""
    scenario = open_scenario("straight-tracks", seed, (FRAMES + 10) / 10.0, ["ideal=true"] if ideal else [])
    simulation = Simulation(scenario)
    return simulation, list(simulation)


def _whole_frames(simulation: Simulation, frames: list[Frame], settings: Settings) -> tuple[FloatArray, FloatArray]:
    """Milliseconds (FRAMES,) per frame, searching and tracking."""
    assert isinstance(settings, NubotMtiSettings)
    return _frame_times(simulation, frames, settings, True), _frame_times(simulation, frames, settings, False)


def _frame_times(simulation: Simulation, frames: list[Frame], settings: NubotMtiSettings, search: bool) -> FloatArray:
    """Milliseconds (FRAMES,) per frame; search: the pose is forgotten before each."""
    setup = RobotSetup(simulation.field, simulation.camera)
    system = NubotMti(setup, settings, np.random.default_rng(0))
    times = []
    for frame in frames:
        if search:
            system.belief.lose()
        start = time.process_time()
        system.step(frame)
        times.append(1e3 * (time.process_time() - start))
    return np.array(times[-FRAMES:])


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
