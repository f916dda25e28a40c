"""schulz-timing (Table 1): the time of each part, from an image to the pose."""

import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from touchline.evaluation.runner import robot_setup
from touchline.geometry import FloatArray, Pose
from touchline.perception.line_graph import detector, structure
from touchline.published.nimbro_lines import system as nimbro_lines
from touchline.published.nimbro_lines.system import NimbroLines
from touchline.systems import RobotSetup
from touchline.types import Frame, Prior
from touchline_lab.experiments.harness import NONE, ExperimentResult, Headline, follow, seed_range, spread, together
from touchline_lab.experiments.scenes import BLUE, RED, new_figure, public_recording
from touchline_lab.experiments.schulz_runs import OURS, PAPER, SCENARIO, settings, start_about
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

RECORDING, RENDERED = "humanoid_9x6_walk", 12
PARTICLES = 500
_WARM = 4  # images that compile, learn colours and fill caches
COLOUR, BEFORE, OBJECTS, LINES, NODES, SPLIT, VERIFY, FILTER, REST, ALL, SEEING = (
    "Color classification",
    "Pre-processing",
    "Object detection",
    "Lines preprocessing",
    "Connect nodes",
    "Split/merge lines",
    "Verify crossings",
    "Particle filter",
    "everything else",
    "image to pose",
    "all of perception",
)
PAPER_US = {COLOUR: 1578.5, BEFORE: 421.6, OBJECTS: 661.2, LINES: 128.3, NODES: 107.0, SPLIT: 101.5, VERIFY: 35.0}
PAPER_US[FILTER] = 3068.3
PARTS = {
    COLOUR: ((structure, "_counted"),),
    BEFORE: ((structure, "_boundary"),),
    OBJECTS: ((detector, "find_landmarks"),),
    LINES: ((structure, "white_inside"), (structure, "low_pass"), (structure, "rank_cells")),
    NODES: ((structure, "line_graph"), (structure, "find_chains")),
    SPLIT: ((detector, "find_lines"), (detector, "lines_on_ground")),
    VERIFY: ((detector, "find_crossings"),),
    SEEING: ((nimbro_lines, "observe"),),
}
_NOTES = (
    f"Processor time of one core, median over the images; ± over the seeds. {PARTICLES} particles; the paper's filter "
    "had 250 to 1000, on a processor of 1.3 GHz, and its sum of 6.1 ms leaves out camera and motion.",
    "Pre-processing: the boundary of the field. Split/merge lines: with their places to a part of a pixel. Everything "
    "else: the table of ground places for the frame's lean, the centre circle, the observation.",
)


class Images(NamedTuple):
    """What a robot saw from its start on, and in words what that is."""

    setup: RobotSetup
    frames: list[Frame]
    start: Pose
    what: str


def schulz_timing(seeds: int) -> ExperimentResult:
    """The images of a walk, once per seed."""
    images: Images | None = None
    passes: list[dict[tuple[str, str], FloatArray]] = []
    for seed in follow(seed_range(seeds), "passes"):
        images = images or _images()
        passes.append(times_us(images, seed))
    found = together(passes)
    paper_us = {
        **{part: f"{us:.0f}" for part, us in PAPER_US.items()},
        REST: NONE,
        ALL: f"{sum(PAPER_US.values()):.0f}",
    }
    rows = [
        (
            part,
            paper_us.get(part, NONE),
            spread([float(np.median(times)) for times in found[OURS, part]], 0),
            f"{np.mean([np.quantile(times, 0.99) for times in found[OURS, part]]):.0f}",
            spread([float(np.median(times)) for times in found[PAPER, part]], 0),
        )
        for part in (*PAPER_US, REST, ALL)
    ]
    total_ms = [float(np.median(times)) / 1e3 for times in found[OURS, ALL]]
    return ExperimentResult(
        "Table 1 of Schulz and Behnke 2012: time from an image to the pose",
        ("part", "paper (µs)", "nimbro-lines (µs)", "99 %", "the paper's own form (µs)"),
        rows,
        Headline(f"image to pose with {PARTICLES} particles (median)", "6.1 ms", f"{spread(total_ms)} ms"),
        (images.what if images else "", *_NOTES),
        (("parts", _figure(found)),),
    )


def times_us(images: Images, seed: int) -> dict[tuple[str, str], FloatArray]:
    """Processor time (N,) in µs of each part, by both forms, of one pass over the images without the first few."""
    number = (f"particles.min_particles={PARTICLES}", f"particles.max_particles={PARTICLES}")
    found: defaultdict[tuple[str, str], list[float]] = defaultdict(list)
    for form in (OURS, PAPER):
        system = NimbroLines(images.setup, settings(form, *number), np.random.default_rng(0))
        system.reset(Prior(start_about(images.start, seed)))
        spent: defaultdict[str, float] = defaultdict(float)
        with _watched(spent):
            for frame in images.frames:
                spent.clear()
                began = time.thread_time_ns()
                system.step(frame)
                spent[ALL] = (time.thread_time_ns() - began) / 1e3
                spent[FILTER] = spent[ALL] - spent[SEEING]
                spent[REST] = spent[SEEING] - sum(spent[part] for part in PARTS if part != SEEING)
                for part in (*PAPER_US, REST, ALL):
                    found[form, part].append(spent[part])
    return {key: np.array(values[_WARM:]) for key, values in found.items()}


@contextmanager
def _watched(spent: defaultdict[str, float]) -> Iterator[None]:
    """Within it, the parts of the detector add to `spent` (µs) what they take."""
    places = [(module, name, part) for part, names in PARTS.items() for module, name in names]
    before = [getattr(module, name) for module, name, _ in places]

    # the thread's clock, for nothing here runs in another: a process's may go on in steps of 4 ms
    def watched(function: Callable[..., Any], part: str, *given: Any, **named: Any) -> Any:
        began = time.thread_time_ns()
        result = function(*given, **named)
        spent[part] += (time.thread_time_ns() - began) / 1e3
        return result

    for (module, name, part), function in zip(places, before, strict=True):
        setattr(module, name, partial(watched, function, part))
    try:
        yield
    finally:
        for (module, name, _), function in zip(places, before, strict=True):
            setattr(module, name, function)


def _images() -> Images:
    """Recorded ones, or rendered where there are none."""
    recording = public_recording(RECORDING)
    if recording is not None:
        truth = recording.truth
        assert truth is not None, f"{RECORDING} holds its truth"
        frames = list(recording)
        return Images(robot_setup(recording), frames, truth[0], f"The {len(frames)} images of {RECORDING}, 752 x 480.")
    simulation = Simulation(open_scenario(SCENARIO, 0, 60.0))
    frames = list(islice(simulation, RENDERED))
    where = f"{RENDERED} rendered images of {SCENARIO}, 752 x 480; the recording {RECORDING} was not found."
    return Images(RobotSetup(simulation.field, simulation.camera), frames, simulation.truth[0], where)


def _figure(found: Mapping[tuple[str, str], Sequence[FloatArray]]) -> Figure:
    """The parts beside the paper's."""
    figure, (axes,) = new_figure(size_in=(7.6, 3.8), labels=("time (µs)", ""))
    ours = [float(np.mean([np.median(times) for times in found[OURS, part]])) for part in PAPER_US]
    rows = np.arange(len(PAPER_US))
    axes.barh(rows - 0.2, list(PAPER_US.values()), 0.38, color=RED, label="paper, 1.3 GHz")
    axes.barh(rows + 0.2, ours, 0.38, color=BLUE, label=OURS)
    axes.set_yticks(rows, list(PAPER_US))
    axes.invert_yaxis()
    axes.legend(frameon=False)
    return figure
