"""iris-timing: the time of one update of iris-fusion, from line points and both sensors to the pose."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np
from matplotlib.figure import Figure

from touchline.config import PAPER, load_settings
from touchline.experiments.iris_eyes import open_iris
from touchline.experiments.iris_runs import IDEAL
from touchline.experiments.progress import follow
from touchline.experiments.result import ExperimentResult, Headline, percent, spread
from touchline.experiments.scenes import BLUE, RED, new_figure
from touchline.geometry import FloatArray
from touchline.motion import DeadReckoning, Motion, MotionHistory, WheelSettings
from touchline.perception import HsvLineDetector
from touchline.simulation.run import Simulation
from touchline.simulation.scenario import open_scenario
from touchline.systems import RobotSetup, open_system
from touchline.systems.iris_fusion import IrisFusionSettings
from touchline.types import Frame, Status

UPDATES = 1000
IMAGES = 100
PARTICLES = (100, 300, 600, 1000, 3000, 10_000)
SCENARIO = "tour-20"
PAPER_MS = 1.6
Input = TypeVar("Input")
_WARM = 20  # updates that compile and fill caches


def iris_timing(seeds: int) -> ExperimentResult:
    """1000 updates of the tour over the 9 x 6 m field per seed; line points of 100 images; other particle counts."""
    updates_ms, paper_ms, ideal_ms, tracking, odometry_ms, detection_ms = [], [], [], [], [], []
    for seed in follow(range(seeds), "tours"):
        setup, frames = _tour(seed)
        times_ms, followed = _updates(setup, frames, seed)
        updates_ms.append(times_ms)
        tracking.append(followed)
        paper_ms.append(_updates(setup, frames, seed, paper=True)[0])
        odometry_ms.append(_odometry(setup, frames))
        detection_ms.append(_detection(seed))
        ideal_ms.append(_updates(*_tour(seed, ideal=True), seed)[0])
    points = float(np.mean([len(frame.observation.points) for frame in frames if frame.observation is not None]))
    counts = follow(PARTICLES, "numbers of particles")
    curve_ms = [float(np.median(_updates(setup, frames[:200], 0, count)[0])) for count in counts]
    rows = [
        _row("one update: points, wheels and gyro to pose", f"{PAPER_MS} ms", updates_ms, paper_ms, ideal_ms),
        _row("of it: odometry, equations (1) to (6)", "–", odometry_ms),
        _row("line points of an image of 480 x 480", "–", detection_ms),
    ]
    rows += [
        (f"one update with {count} particles", "–", "", f"{ms:.2f} ms", "", "", "")
        for count, ms in zip(PARTICLES, curve_ms, strict=True)
    ]
    return ExperimentResult(
        "iris-timing",
        "Time response of Ismail et al. 2021, section III.C: one update of the localization",
        seeds,
        ("part", "paper", "its form here: median", "median", "99 %", "longest", "ideal robot: median"),
        tuple(rows),
        Headline("one update, from points and sensors to the pose (median)", f"{PAPER_MS} ms",
                 f"{_median(updates_ms)}; its form {_median(paper_ms)}; ideal {_median(ideal_ms)}"),
        (
            f"{len(frames)} updates per seed at 10 Hz on one core, 600 particles, {points:.0f} points per image, five "
            "samples of wheels and gyro each, of robots as built; the search at the start is among them, the robot is "
            f"followed in {percent(tracking)} of them. Processor time. The paper does not say what its time of 1.6 ms "
            "includes, nor on which computer.",
        ),
        (("updates", _updates_figure(updates_ms[0], curve_ms)),),
    )  # fmt: skip


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
    times_ms, followed = np.empty(len(frames)), 0
    for k, frame in enumerate(frames):
        started = time.process_time()
        estimate = system.step(frame)
        times_ms[k] = 1e3 * (time.process_time() - started)
        followed += estimate.status is Status.TRACKING
    return times_ms, followed / len(frames)


def _odometry(setup: RobotSetup, frames: Sequence[Frame]) -> FloatArray:
    """Milliseconds (N,) of the wheels and the gyro alone."""
    history = MotionHistory(wheels=WheelSettings(), wheel_directions_rad=setup.wheel_directions_rad)
    odometry = DeadReckoning(history)

    def motion(frame: Frame) -> Motion:
        history.add(frame)
        return odometry.advance(frame.stamp_ns)

    return _timed(motion, frames)


def _detection(seed: int) -> FloatArray:
    """Milliseconds (IMAGES,) of the line points of images along the tour."""
    simulation = Simulation(open_scenario(SCENARIO, seed + 1))
    detector = HsvLineDetector(simulation.camera, None, simulation.field.line_width)
    images = [simulation.image(int(k)) for k in np.linspace(0, len(simulation) - 1, IMAGES // 5)]
    detector.detect(images[0])
    return _timed(detector.detect, images * 5)


def _timed(work: Callable[[Input], object], inputs: Sequence[Input]) -> FloatArray:
    """Milliseconds (N,) of a call for each input."""
    times_ms = np.empty(len(inputs))
    for k, each in enumerate(inputs):
        started = time.process_time()
        work(each)
        times_ms[k] = 1e3 * (time.process_time() - started)
    return times_ms


def _median(times_ms: Sequence[FloatArray]) -> str:
    return f"{spread([float(np.median(each)) for each in times_ms], 2)} ms"


def _row(
    name: str,
    paper: str,
    times_ms: Sequence[FloatArray],
    paper_ms: Sequence[FloatArray] = (),
    ideal_ms: Sequence[FloatArray] = (),
) -> tuple[str, ...]:
    late = [float(np.quantile(each, 0.99)) for each in times_ms]
    longest = [float(each.max()) for each in times_ms]
    beside = [_median(some) if some else "–" for some in (paper_ms, ideal_ms)]
    return name, paper, beside[0], _median(times_ms), f"{spread(late, 2)} ms", f"{spread(longest, 1)} ms", beside[1]


def _updates_figure(times_ms: FloatArray, curve_ms: Sequence[float]) -> Figure:
    figure, axes = new_figure(1, 2, 9.6, 3.6)
    axes[0].plot(times_ms, color=BLUE, linewidth=0.8)
    axes[0].axhline(PAPER_MS, color=RED, linestyle="--", label="the paper's average")
    axes[0].set(xlabel="update", ylabel="time (ms)", ylim=(0.0, 2.0 * PAPER_MS), title="one update")
    axes[0].legend(fontsize=8)
    axes[1].plot(PARTICLES, curve_ms, "o-", color=BLUE)
    axes[1].set(xscale="log", yscale="log", xlabel="particles", ylabel="median time (ms)", title="other numbers")
    return figure
