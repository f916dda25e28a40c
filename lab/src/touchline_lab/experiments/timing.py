"""lu2013-timing (figure 12), xiong-timing (figure 11) and iris-timing (section III.C): the time of the parts."""

import time
from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import TypeVar

import numpy as np
from matplotlib.figure import Figure

from touchline.config import PAPER, Settings, load_settings
from touchline.field import open_field
from touchline.geometry import FloatArray, Pose
from touchline.motion import DeadReckoning, MotionHistory, WheelSettings
from touchline.motion.odometry import Motion
from touchline.published.iris_fusion.hsv_lines import HsvLineDetector
from touchline.published.iris_fusion.system import IrisFusionSettings
from touchline.published.nubot.matcher import Matcher
from touchline.published.nubot_mcl.particles import NubotParticlePaper, NubotParticles, NubotParticleSettings
from touchline.published.nubot_mcl.system import NubotMclSettings
from touchline.published.nubot_mti.system import NubotMti, NubotMtiSettings
from touchline.systems import RobotSetup, open_system, paper_settings
from touchline.types import Frame, Status
from touchline_lab.experiments import harness
from touchline_lab.experiments.iris_runs import IDEAL, open_iris
from touchline_lab.experiments.scenes import BLUE, FIELD, RED, new_figure, points_from, random_place
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

CYCLES, FRAMES, UPDATES, IMAGES = 1000, 20, 1000, 100
COUNTS = (100, 300, 600, 1000, 3000, 10_000, 30_000, 100_000)
MOTION = Motion(Pose(0.1, 0.0, 0.02), np.diag([1e-4, 1e-4, 1e-5]), 0.0)
POINTS = 100
POINT_COUNTS = (10, 30, 300, 1000)
PARTICLES = (100, 300, 600, 1000, 3000, 10_000)  # of iris-fusion
SCENARIO, PAPER_MS = "tour-20", 1.6
COLUMNS = ("part", "paper", "its form here: median", "median", "99 %", "longest", "ideal robot: median")
_WARM = 20  # updates that compile and fill caches
Input = TypeVar("Input")
Times = Sequence[FloatArray]  # ms, of each seed


def timed_ms(work: Callable[[Input], object], inputs: Sequence[Input]) -> FloatArray:
    """Processor time (ms) (N,) of a call for each input."""
    times = np.empty(len(inputs))
    for k, each in enumerate(inputs):
        start = time.thread_time()  # a process's clock may go on in steps of 4 ms
        work(each)
        times[k] = time.thread_time() - start
    return 1e3 * times


def _cycles(work: Callable[[], object], cycles: int) -> FloatArray:
    """Processor time (ms) (cycles,) of each call; a few calls before compile and warm."""
    for _ in range(5):
        work()
    return timed_ms(lambda _: work(), range(cycles))


def _median(times_ms: Times, unit: str = "µs") -> str:
    return _said([float(np.median(each)) for each in times_ms], unit) if len(times_ms) else harness.NONE


def _said(values_ms: Sequence[float], unit: str) -> str:
    return f"{harness.spread(1e3 * np.array(values_ms), 0)} µs" if unit == "µs" else f"{harness.spread(values_ms)} ms"


def _row(
    name: str, paper: str, ours: Times, paper_ms: Times = (), ideal_ms: Times = (), unit: str = "µs"
) -> harness.Row:
    """paper_ms: its form here."""
    late = _said([float(np.quantile(each, 0.99)) for each in ours], unit)
    longest = f"{harness.spread([float(each.max()) for each in ours], 1)} ms"
    return name, paper, _median(paper_ms, unit), _median(ours, unit), late, longest, _median(ideal_ms, unit)


def _lone(name: str, value: str, more: str = "") -> harness.Row:
    """A row of a single figure."""
    return name, harness.NONE, "", value, more, "", ""


def _curve(title: str, lines: Sequence[tuple[FloatArray, str, float, str]], xlabel: str) -> Figure:
    """Times (ms) over frames or cycles, each with its colour, width and label."""
    figure, (axes,) = new_figure(labels=(xlabel, title))
    for times_ms, color, width, label in lines:
        axes.plot(times_ms, color=color, linewidth=width, label=label)
    axes.legend(frameon=False)
    return figure


def lu2013_timing(seeds: int) -> harness.ExperimentResult:
    """1000 cycles of the particle part and of the matching part, each seed from another place; then the curve."""
    ours, ideal, paper = (
        harness.together(parts(seed) for seed in harness.follow(harness.seed_range(seeds), name))
        for parts, name in (
            (_lu_parts, "robots as built"), (partial(_lu_parts, ideal=True), "ideal robots"),
            (_paper_parts, "in the paper's form"),
        )
    )  # fmt: skip
    matcher, counts = Matcher(open_field(FIELD).distance_map()), harness.follow(COUNTS, "numbers of particles")
    curve_us = [1e3 * float(_particle_cycles(matcher, 0, max(20, 20_000 // n), _particles(n)).min()) for n in counts]
    by_points_us = [1e3 * float(_particle_cycles(matcher, 0, 200, points=n).min()) for n in POINT_COUNTS]
    weights_us, plain_us = _weights_and_twin(matcher)
    rows = [
        _row(name, published, ours[part], paper.get(part, ()), ideal[part])
        for name, published, part in (
            ("particles: one cycle, 600 x 100", "15-25 ms", "particles"),
            ("particles: the same with five refined clusters", harness.NONE, "refined"),
            ("matching: one cycle, 100 points", "1-3 ms", "matching"),
        )
    ]
    rows += [
        _lone("particles: weights alone, 600 x 100", f"{weights_us:.0f} µs"),
        _lone("particles: weights alone, plain NumPy", f"{plain_us:.0f} µs", f"{plain_us / weights_us:.0f} times"),
    ]
    slope = np.polyfit(np.log(COUNTS[2:]), np.log(curve_us[2:]), 1)[0]
    curves = [(f"{n} x 100", n * POINTS, us) for n, us in zip(COUNTS, curve_us, strict=True)]
    curves += [(f"600 x {n}", n * 600, us) for n, us in zip(POINT_COUNTS, by_points_us, strict=True)]
    rows += [
        _lone(f"particles: {name}", f"{us:.0f} µs", f"{1e3 * us / pairs:.1f} ns per particle and point")
        for name, pairs, us in curves
    ]
    shown = [(ours["particles"][0], RED, 0.8, "particles, 600 x 100 points"),
             (ours["matching"][0], BLUE, 0.8, "matching, 100 points")]  # fmt: skip
    cycles = _curve("time (ms)", shown, "cycle")
    cycles.axes[0].set_ylim(0.0, 4.0 * float(np.median(ours["particles"][0])))  # beyond other programs interrupted
    return harness.ExperimentResult(
        "Figure 12 of Lu et al. 2013: time of one cycle of the particle part and of the matching part",
        COLUMNS,
        rows,
        harness.Headline("one cycle of 600 particles; of matching (median)", "15-25 ms; 1-3 ms",
                 f"{_median(ours['particles'])}; {_median(ours['matching'])}; its form {_median(paper['particles'])}; "
                 f"{_median(paper['matching'])}"),
        (
            f"{CYCLES} cycles per seed on one core: motion, weights, resampling in every cycle, estimate, {POINTS} "
            "points at the observation level; processor time, so that other work on the machine doesn't count. The "
            "paper's computer had a 1.66 GHz processor. Robots as built; its form here: with the system's preset "
            "`paper`.",
            f"From 600 to 100 000 particles the time grows with the power {slope:.2f} of their number (fastest of 20 "
            "cycles or more).",
        ),
        (("cycles", cycles), ("particles", _counts_figure(curve_us))),
    )  # fmt: skip


def _lu_parts(seed: int, ideal: bool = False) -> dict[str, FloatArray]:
    """Milliseconds (CYCLES,) of particles, of the same with refined clusters, and of matching."""
    matcher = Matcher(open_field(FIELD).distance_map())
    return {
        "particles": _particle_cycles(matcher, seed, CYCLES, ideal=ideal),
        "refined": _particle_cycles(matcher, seed, CYCLES, _particles(refined=5), ideal=ideal),
        "matching": _matching_cycles(matcher, seed, ideal),
    }


def _paper_parts(seed: int) -> dict[str, FloatArray]:
    """Milliseconds (CYCLES,) of particles and of matching by the paper's own form."""
    settings = paper_settings("nubot-mcl")
    assert isinstance(settings, NubotMclSettings)
    matcher = Matcher(open_field(FIELD).distance_map(), settings.matching)
    particles = _particle_cycles(matcher, seed, CYCLES, settings.particles)
    return {"particles": particles, "matching": _matching_cycles(matcher, seed)}


@cache
def _seen(seed: int, ideal: bool) -> tuple[Pose, FloatArray]:
    """A place from which at least so many points are seen, and that many of them."""
    rng = np.random.default_rng([seed, 12])
    while True:
        pose = random_place(open_field(FIELD), rng, margin_m=1.0)
        points = points_from(pose, seed, ideal).positions_m
        if len(points) >= POINTS:
            return pose, np.ascontiguousarray(points[rng.permutation(len(points))[:POINTS]])


def _particles(count: int = 600, refined: int = 0) -> NubotParticleSettings:
    """Those that are resampled in every cycle."""
    paper = NubotParticlePaper(refined_clusters=refined, resampling_threshold=1.0)
    return NubotParticleSettings(particles=count, paper=paper)


def _particle_cycles(
    matcher: Matcher, seed: int, cycles: int, settings: NubotParticleSettings | None = None, points: int = POINTS,
    ideal: bool = False,
) -> FloatArray:  # fmt: skip
    pose, seen = _seen(seed, ideal)
    chosen = np.resize(seen, (points, 2))  # more than are seen: again from the first on
    mcl = NubotParticles(matcher, 18.0, 12.0, np.random.default_rng(seed), settings or _particles())
    mcl.restart(pose.heading)

    def cycle() -> None:
        mcl.predict(MOTION)
        mcl.update(chosen, None)

    return _cycles(cycle, cycles)


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

    compiled = _cycles(lambda: mcl.log_likelihoods(points, None, particles), 200)
    return 1e3 * float(compiled.min()), 1e3 * float(_cycles(plain, 50).min())


def _matching_cycles(matcher: Matcher, seed: int, ideal: bool = False) -> FloatArray:
    """Matching from a prediction 5 cm and 1 degree off, with the covariance of the match."""
    pose, points = _seen(seed, ideal)
    start = Pose(pose.x + 0.05, pose.y - 0.05, pose.heading + 0.02)
    weights = np.full(len(points), 1.0 / len(points))
    return _cycles(lambda: matcher.match(points, weights, start), CYCLES)


def _counts_figure(curve_us: list[float]) -> Figure:
    figure, (axes,) = new_figure(labels=("particles", "time of one cycle with 100 points (µs)"))
    axes.loglog(COUNTS, curve_us, "o-", color=RED)
    axes.axhspan(15e3, 25e3, xmin=0.0, color=BLUE, alpha=0.15, label="the paper's 600 particles")
    axes.legend(frameon=False)
    return figure


def xiong_timing(seeds: int) -> harness.ExperimentResult:
    """Whole frames, image to pose, on rendered images: once searching in every frame, once tracking."""
    built, ideal = (
        harness.together(_whole_frames(seed, best) for seed in harness.follow(harness.seed_range(seeds), name))
        for best, name in ((False, "drives"), (True, "ideal robots"))
    )
    searching, tracking = ((built[s, "ours"], built[s, "paper"], ideal[s, "ours"]) for s in (True, False))
    shown = [
        (built[True, "ours"][0], RED, 1.0, "global localization"),
        (built[False, "ours"][0], BLUE, 1.0, "tracking"),
    ]
    frames = _curve("time (ms)", shown, "frame")
    frames.axes[0].set_ylim(bottom=0.0)
    return harness.ExperimentResult(
        "Figure 11 of Xiong et al.: time of a whole frame in global localization and in tracking",
        COLUMNS,
        (
            _row("whole frame, global localization", "35-45 ms", *searching),
            _row("whole frame, tracking", "18-24 ms", *tracking),
        ),
        harness.Headline("whole frame searching; tracking (median)", "35-45 ms; 18-24 ms",
                 f"{_median(searching[0])}; {_median(tracking[0])}; its form {_median(searching[1])}; "
                 f"{_median(tracking[1])}"),
        (
            "Rendered images of 480 x 480 pixels on one core, from the image array to the pose, processor time; the "
            f"paper's times include grabbing the image, on a 1.66 GHz processor. Robots as built, {FRAMES} frames "
            "each; its form here: with the system's preset `paper`.",
        ),
        (("frames", frames),),
    )  # fmt: skip


def _whole_frames(seed: int, ideal: bool) -> dict[tuple[bool, str], FloatArray]:
    """Milliseconds (FRAMES,) per frame of a drive, by whether it is searched in each and by form."""
    scenario = open_scenario("straight-tracks", seed, (FRAMES + 10) / 10.0, ["ideal=true"] if ideal else [])
    simulation = Simulation(scenario)
    frames = list(simulation)
    forms = {"ours": NubotMtiSettings()} | ({} if ideal else {"paper": paper_settings("nubot-mti")})
    return {
        (search, form): _frame_times(simulation, frames, settings, search)
        for form, settings in forms.items()
        for search in (True, False)
    }


def _frame_times(simulation: Simulation, frames: list[Frame], settings: Settings, search: bool) -> FloatArray:
    """Milliseconds (FRAMES,) per frame; search: the pose is forgotten before each."""
    assert isinstance(settings, NubotMtiSettings)
    system = NubotMti(RobotSetup(simulation.field, simulation.camera), settings, np.random.default_rng(0))
    times = []
    for frame in frames:
        if search:
            system.following.belief.lose()
        times.append(timed_ms(system.step, [frame])[0])
    return np.array(times[-FRAMES:])


def iris_timing(seeds: int) -> harness.ExperimentResult:
    """1000 updates of the tour over the 9 x 6 m field per seed; line points of 100 images; other particle counts."""
    found = harness.together(_iris_parts(seed) for seed in harness.follow(harness.seed_range(seeds), "tours"))
    setup, frames = _tour(harness.seed_range(seeds)[-1])
    points = float(np.mean([len(frame.observation.points) for frame in frames if frame.observation is not None]))
    counts = harness.follow(PARTICLES, "numbers of particles")
    curve_ms = [float(np.median(_updates(setup, frames[:200], 0, count)[0])) for count in counts]
    rows = [
        _row("one update: points, wheels and gyro to pose", f"{PAPER_MS} ms", found["updates"], found["paper"],
             found["ideal"], "ms"),
        _row("of it: odometry, equations (1) to (6)", harness.NONE, found["odometry"], unit="ms"),
        _row("line points of an image of 480 x 480", harness.NONE, found["detection"], unit="ms"),
        *(_lone(f"one update with {count} particles", f"{ms:.2f} ms")
          for count, ms in zip(PARTICLES, curve_ms, strict=True)),
    ]  # fmt: skip
    return harness.ExperimentResult(
        "Time response of Ismail et al. 2021, section III.C: one update of the localization",
        COLUMNS,
        rows,
        harness.Headline("one update, from points and sensors to the pose (median)", f"{PAPER_MS} ms",
                 f"{_median(found['updates'], 'ms')}; its form {_median(found['paper'], 'ms')}; ideal "
                 f"{_median(found['ideal'], 'ms')}"),
        (
            f"{len(frames)} updates per seed at 10 Hz on one core, 600 particles, {points:.0f} points per image, five "
            "samples of wheels and gyro each, of robots as built; the search at the start is among them, the robot is "
            f"followed in {harness.percent(np.array(found['tracking']).ravel())} of them. Processor time. The paper "
            "does not say what its time of 1.6 ms includes, nor on which computer.",
        ),
        (("updates", _updates_figure(found["updates"][0], curve_ms)),),
    )  # fmt: skip


def _iris_parts(seed: int) -> dict[str, FloatArray]:
    """Milliseconds of each update, its odometry alone and an image's line points; `tracking`: share of them, (1,)."""
    setup, frames = _tour(seed)
    updates, tracking = _updates(setup, frames, seed)
    return {
        "updates": updates,
        "tracking": np.array([tracking]),
        "paper": _updates(setup, frames, seed, paper=True)[0],
        "odometry": _odometry(setup, frames),
        "detection": _detection(seed),
        "ideal": _updates(*_tour(seed, ideal=True), seed)[0],
    }


def _tour(seed: int, ideal: bool = False) -> tuple[RobotSetup, list[Frame]]:
    """The robot of a tour and its frames, which bring their line points."""
    scenario = open_scenario(SCENARIO, seed + 1, changes=IDEAL if ideal else [])
    simulation, setup = open_iris(scenario, "points", seed)
    return setup, [frame for frame, _ in zip(simulation, range(UPDATES), strict=False)]


def _updates(
    setup: RobotSetup, frames: Sequence[Frame], seed: int, particles: int = 600, paper: bool = False
) -> tuple[FloatArray, float]:
    """Milliseconds (N,) of every step on frames that bring their line points, and the share of tracking."""
    changes = [f"particles.particles={particles}"]
    settings = load_settings(IrisFusionSettings, None, changes, preset=PAPER if paper else None)
    system = open_system("iris-fusion", setup, settings, np.random.default_rng(seed))
    for frame in frames[:_WARM]:
        system.step(frame)
    system.reset()
    followed: list[bool] = []
    times_ms = timed_ms(lambda frame: followed.append(system.step(frame).status is Status.TRACKING), frames)
    return times_ms, sum(followed) / len(frames)


def _odometry(setup: RobotSetup, frames: Sequence[Frame]) -> FloatArray:
    """Milliseconds (N,) of the wheels and the gyro alone."""
    history = MotionHistory(wheels=WheelSettings(), wheel_directions_rad=setup.wheel_directions_rad)
    odometry = DeadReckoning(history)

    def motion(frame: Frame) -> Motion:
        history.add(frame)
        return odometry.advance(frame.stamp_ns)

    return timed_ms(motion, frames)


def _detection(seed: int) -> FloatArray:
    """Milliseconds (IMAGES,) of the line points of images along the tour."""
    simulation = Simulation(open_scenario(SCENARIO, seed + 1))
    detector = HsvLineDetector(simulation.camera, None, simulation.field.line_width)
    images = [simulation.image(int(k)) for k in np.linspace(0, len(simulation) - 1, IMAGES // 5)]
    detector.detect(images[0])
    return timed_ms(detector.detect, images * 5)


def _updates_figure(times_ms: FloatArray, curve_ms: Sequence[float]) -> Figure:
    figure, axes = new_figure(1, 2, (9.6, 3.6), labels=("", "time (ms)"))
    axes[0].plot(times_ms, color=BLUE, linewidth=0.8)
    axes[0].axhline(PAPER_MS, color=RED, linestyle="--", label="the paper's average")
    axes[0].set(xlabel="update", ylim=(0.0, 2.0 * PAPER_MS), title="one update")
    axes[0].legend(fontsize=8)
    axes[1].plot(PARTICLES, curve_ms, "o-", color=BLUE)
    axes[1].set(xscale="log", yscale="log", xlabel="particles", ylabel="median time (ms)", title="other numbers")
    return figure
