"""lu2013-lighting (Table 2, figure 8): one colour table under other light, with exposure control and without."""

import math
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from touchline.camera.exposure import ExposureControl, ExposureSettings, mirror_masks
from touchline.config import PAPER, load_settings
from touchline.errors import TouchlineError
from touchline.evaluation.metrics import ErrorTable
from touchline.geometry import BoolArray, FloatArray
from touchline.perception import LinePointDetector
from touchline.perception.colour_file import load_colours, save_colours
from touchline.systems import SYSTEMS, RobotSetup, open_system
from touchline.types import Frame, ImageArray
from touchline_lab.experiments import harness
from touchline_lab.experiments.drives import Track, drive_of, error_figures, track_of
from touchline_lab.experiments.scenes import BLUE, RED, dots, new_figure, way
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import LightSettings, open_scenario

PaperRow = tuple[float, float, float]
RATE_HZ = 2.5  # images per second: enough to follow a robot at 1.5 m/s, and each has to be rendered
START_MS = 20.4  # exposure times gain before the first search: the simulated camera's own
PLACES = 8  # images that colours are learned from, and at which darkness is tried
LEFT_ON = (0.04, 0.02)  # levels of what stays on without the lamps: 20 and 10 of 500 lx
DARKER = (0.2, 0.1, *LEFT_ON, 0.01)  # levels of light, for how far the first case's settings reach
SWITCH_S = 10.0
SECONDS = 40.0


@dataclass(frozen=True, slots=True)
class Case:
    """A lighting: what Table 2 says of it (mean, deviation, maximum of x, y in cm, heading in rad), and its levels."""

    name: str
    light: LightSettings
    paper: tuple[PaperRow, PaperRow, PaperRow] | None = None


def _light(scenario: str, **changed: object) -> LightSettings:
    return open_scenario(scenario).light.model_copy(update=changed)


def _switching() -> tuple[LightSettings.Change, ...]:
    """Lamps off and on again every ten seconds.

    The paper's hall has no daylight in the first case, and nothing but its lamps are switched in the third; it doesn't
    say what was left. Two standards do, in turn: a sports hall's safety lighting gives 20 lx on the ground (JGJ
    153-2007, of the paper's country), and 10 lx are the least among its spectators (EN 12193).
    """
    on = open_scenario("lighting-1").light
    states = [state for level in LEFT_ON for state in ((0.0, level), (on.lamps, on.ambient))]
    return tuple(
        LightSettings.Change(time_s=SWITCH_S * (k + 1), lamps=lamps, ambient=ambient)
        for k, (lamps, ambient) in enumerate((*states, states[0]))
    )


FIRST = Case(
    "first: lamps", _light("lighting-1"), ((5.907, 5.967, 0.044), (7.334, 7.117, 0.052), (30.724, 35.595, 0.286))
)
SECOND = Case(
    "second: lamps and sun",
    _light("lighting-3"),
    ((6.416, 5.544, 0.067), (12.431, 7.381, 0.093), (95.396, 33.063, 0.580)),
)
THIRD = Case(
    "third: lamps off and on",
    _light("lighting-1", changes=_switching()),
    ((2.751, 5.867, 0.047), (3.593, 7.533, 0.061), (16.834, 35.173, 0.279)),
)
DULL = Case("lamps off, dull day", _light("lighting-2"))
GLASS = Case("lamps and sun, clear glass", _light("lighting-3", sun=76.0, ambient=2.0))
CASES = (FIRST, SECOND, THIRD, DULL, GLASS)


@dataclass(frozen=True, eq=False, slots=True)
class Run:
    """One run of N images. stops (N,): log2 of exposure (ms) times gain. searched (N,): whether it was searched."""

    track: Track
    stops: npt.NDArray[np.float64]
    searched: BoolArray

    @property
    def errors(self) -> ErrorTable | None:
        """Since the first tracked image, None if there is none."""
        return self.track.table()

    @property
    def mean_xy_m(self) -> float:
        """Root of the squared mean errors in x and y, which is all that Table 2 tells; infinite without any."""
        errors = self.errors
        return float("inf") if errors is None else float(np.hypot(errors.x.mean, errors.y.mean))


class ControlledExposure:
    """The closed loop: image after image of a simulation, its exposure kept right. The robot waits for a search.

    It is the camera that its control asks, and gives an image that is already taken before it takes another.
    """

    def __init__(self, simulation: Simulation, paper: bool = False) -> None:
        self._simulation = simulation
        self._taken: ImageArray | None = None
        # at a few images per second each is looked at; the paper looks every few cycles of 25 per second
        settings = load_settings(ExposureSettings, None, ["check_every=1"], preset=PAPER if paper else None)
        self.control = ExposureControl(self, mirror_masks(simulation.camera), settings, START_MS)

    def set(self, exposure_ms: float, gain: float) -> None:
        self._simulation.set(exposure_ms, gain)
        self._taken = None  # with other settings

    def grab(self) -> ImageArray:
        image, self._taken = self._taken, None
        return self._simulation.grab() if image is None else image

    def image(self, taken: ImageArray | None) -> tuple[ImageArray, bool]:
        """The image to work with, where `taken` was taken with the settings of now; whether they were searched."""
        self._taken, searching = taken, self.control.waiting
        image = self.control.step()
        searching |= self.control.waiting
        while self.control.waiting:
            image = self.control.step()
        return (self.control.step() if searching else image), searching


def controlled(run: Simulation, paper: bool = False) -> Iterator[tuple[Frame, bool]]:
    """The frames of a run, the exposure kept right all along, and whether it was searched."""
    loop = ControlledExposure(run, paper)
    for index in range(len(run)):
        frame = run.frame(index)
        image, searched = loop.image(frame.image)
        yield replace(frame, image=image, exposure_ms=run.exposure_ms, gain=run.gain), searched


def simulation(case: Case, seed: int, seconds: float | None = None, ideal: bool = False) -> Simulation:
    """A case's run: straight tracks through a rendered hall, of a robot as built or ideal.

    Motion blur, which the light changes little, would take three quarters of the time.
    """
    changes = ["ideal=true"] if ideal else ["camera.motion_blur=false"]
    scenario = open_scenario("lighting-1", seed, seconds or SECONDS, changes)
    camera = scenario.camera.model_copy(update={"rate_hz": RATE_HZ})
    return Simulation(scenario.model_copy(update={"light": case.light, "camera": camera}))


def _images(run: Simulation) -> list[ImageArray]:
    """Eight images, evenly over the run, with the exposure of now."""
    images = [run.frame(int(k)).image for k in np.linspace(0, len(run) - 1, PLACES)]
    return [image for image in images if image is not None]


def learned_colours(seed: int, file: Path, seconds: float | None = None, ideal: bool = False) -> tuple[float, float]:
    """Write the colour table of the first case; returns exposure (ms) and gain that its light asks for."""
    run = simulation(FIRST, seed, seconds, ideal)
    run.frame(0)
    ControlledExposure(run).image(None)
    detector = LinePointDetector(run.camera, line_width_m=run.field.line_width)
    try:
        detector.learn(_images(run))
    except TouchlineError as error:
        raise type(error)(f"lu2013-lighting, first case: {error}") from None
    assert detector.colours is not None
    save_colours(detector.colours, file)
    return run.exposure_ms, run.gain


@dataclass(frozen=True, slots=True)
class Robot:
    """Who drives: a robot by seed, as built or ideal, ours or by the paper's own form; its colour table's file."""

    seed: int
    colours: Path
    ideal: bool = False
    paper: bool = False


def drive(case: Case, robot: Robot, fixed: tuple[float, float] | None, seconds: float | None = None) -> Run:
    """One run with frozen colours. fixed: exposure (ms) and gain all along; none: the control keeps them right."""
    run = simulation(case, robot.seed, seconds, robot.ideal)
    preset, colours = PAPER if robot.paper else None, f"learning.colour_file={robot.colours}"
    settings = load_settings(SYSTEMS["nubot-mcl"].settings, None, [colours], preset=preset)
    setup = RobotSetup(run.field, run.camera)
    system = open_system("nubot-mcl", setup, settings, np.random.default_rng(robot.seed))
    seen = controlled(run, robot.paper) if fixed is None else ((run.frame(k), False) for k in range(len(run)))
    if fixed is not None:
        run.set(*fixed)
    estimates, stops, searched = [], [], []
    for frame, sought in seen:
        estimates.append(system.step(frame))
        stops.append(np.log2(run.exposure_ms * run.gain))
        searched.append(sought)
    frames = [Frame(int(stamp)) for stamp in run.image_stamps]
    track = track_of(drive_of(run, setup, frames), estimates)
    return Run(track, np.array(stops, dtype=np.float64), np.array(searched))


def points_in_the_dark(
    seed: int, colours: Path, fixed: tuple[float, float], levels: Sequence[float] = DARKER
) -> FloatArray:
    """Line points (L + 1, 2) at eight places under lamps, then under each level (L) of even light instead; ideal robot.

    Columns: exposure and gain as they suit the first case, and as the control finds them at the first place.
    """
    lights = [FIRST.light, *(_light("lighting-2", ambient=level) for level in levels)]
    runs = [simulation(Case("", light), seed, ideal=True) for light in lights]
    detector = LinePointDetector(runs[0].camera, line_width_m=runs[0].field.line_width)
    found = np.empty((len(runs), 2))
    for k, run in enumerate(runs):
        for column in (0, 1):
            run.set(*fixed)
            if column:
                run.frame(0)
                ControlledExposure(run).image(None)
            images = _images(run)
            if detector.colours is None:
                detector.use_colours(load_colours(colours), images)
            found[k, column] = np.mean([len(detector.detect(image)) for image in images])
    return found


COLUMNS = (
    "light", "exposure", "figure",
    "x paper", "x its form here", "x (cm)", "y paper", "y its form here", "y (cm)",
    "θ paper", "θ its form here", "θ (rad)", "position its form here (cm)", "position (cm)",
    "of the first: paper", "its form here", "of the first", "line points", "tracked: its form here", "tracked",
    "ideal: position (cm)", "ideal: tracked",
)  # fmt: skip
BUILT = 3  # robots as built, of whom more would take too long
WITHOUT = (SECOND, THIRD, GLASS)  # cases that are driven without control, too
JOBS = (*((case, True) for case in CASES), *((case, False) for case in WITHOUT))
FORMS = OURS, PAPER_FORM, IDEAL = "ours", "its form", "ideal"

Runs = Mapping[tuple[str, str, bool], Sequence[Run]]  # by form, case and whether the exposure is controlled


def lu2013_lighting(seeds: int) -> harness.ExperimentResult:
    """Table 2: each case with exposure control, some also with the settings that suited the first case."""
    robots = [
        (seed, ideal) for ideal in (False, True) for seed in harness.seed_range(seeds if ideal else min(seeds, BUILT))
    ]
    measured = list(harness.computed(_of_robot, robots, "robots"))
    runs, dark = harness.together(driven for driven, _ in measured), [each for _, each in measured if len(each)]
    return harness.ExperimentResult(
        "Table 2 of Lu et al. 2013: errors under other light, colours learned in the first case only",
        COLUMNS,
        [row for case, control in JOBS for row in _rows(case, control, runs)],
        _headline(runs),
        (*_NOTES, _switched_off(runs[OURS, THIRD.name, False]), _darkness(dark), _exposures(runs)),
        (
            ("tracks", _tracks_figure([(c.name, runs[OURS, c.name, True][0]) for c in (FIRST, SECOND, THIRD)])),
            ("exposure", _exposure_figure(runs)),
        ),
    )


def _of_robot(task: tuple[int, bool]) -> tuple[dict[tuple[str, str, bool], Run], FloatArray]:
    """All drives of a robot, as built or ideal, and of an ideal one its `points_in_the_dark`."""
    seed, ideal = task
    runs: dict[tuple[str, str, bool], Run] = {}
    with tempfile.TemporaryDirectory() as folder:
        robot = Robot(seed, Path(folder, "colours.npz"), ideal)
        best = learned_colours(seed, robot.colours, ideal=ideal)
        for case, control in JOBS:
            if not ideal or case is GLASS or (control and case.paper is not None):
                runs[IDEAL if ideal else OURS, case.name, control] = drive(case, robot, None if control else best)
            if not ideal and control and case.paper is not None:
                runs[PAPER_FORM, case.name, control] = drive(case, replace(robot, paper=True), None)
        return runs, points_in_the_dark(seed, robot.colours, best) if ideal else np.zeros(0)


_NOTES = (
    f"The scenarios lighting-1 to 3 rendered, {SECONDS:g} s at {RATE_HZ:g} images per second; straight tracks. Robots "
    f"as built, {BUILT} of them, camera.yaml from calibrate mirror, eight robots moving about, but without motion "
    "blur; its form here: the same with the system's and the exposure control's preset `paper`. Beside them an ideal "
    "robot for each seed, three robots standing about. Errors are those since the first tracked image; line points are "
    "means over all images. The robot waits while the control searches. Without control exposure and gain stay at what "
    "the control found at the first case's start.",
    "Of the first: errors over those of the first case, each as the root of the squared means in x and in y, the "
    "paper's by the same formula.",
    "Levels of light: 1 is the hall's lamps, 500 lx (EN 12193, class II; JGJ 153-2007, matches of amateurs). Second "
    "case: patches of sun 6 times as bright, as in the recorded linear images (omni_exposure), 0.6 of daylight "
    "everywhere. Third case: lamps go off and on every 10 s. The paper's first case knows no daylight, and its third "
    "switches the lamps; what was left it doesn't say. Here two standards take turns: 20 lx of safety lighting in a "
    "sports hall (0.04; JGJ 153-2007, of the paper's country) and 10 lx, the least among spectators (0.02; EN 12193). "
    "That the first costs nothing and the second does was known when they were taken. Dull "
    "day: 100 lx (0.2), 5000 lx outside at a daylight factor of 2 %. Clear glass: the sun at 35 degrees "
    "brings 50 klx to the ground, 38 klx behind two panes: 76 times the lamps, with 2.0 of daylight from sky and "
    "bounces. The entropy's peak exposes for the shade; patches are white all over, and what lies under them counts "
    "neither as carpet nor as its end.",
    "Without control the paper found no line points in its second case: its look-up table classes absolute colours, "
    "where the detector here compares a line with the "
    "green beside it. The paper's best settings fall from 18 ms, 18 to 12 ms, 12 from the first case to the second, by "
    "a factor of 2.25.",
)


def _rows(case: Case, control: bool, runs: Runs) -> list[harness.Row]:
    """Mean, standard deviation and maximum, as the paper has them."""
    ours, paper, ideal = (runs.get((form, case.name, control), ()) for form in FORMS)
    rows: list[harness.Row] = []
    published = case.paper if control else None
    for k, (title, key) in enumerate((("mean", "mean"), ("std", "std_signed"), ("max", "max"))):
        cells = harness.paper_cells(published and published[k], partial(_figure, key=key), paper, ours)
        head, last = ("", ""), ""
        more: harness.Row = ("",) * 6
        if k == 0:
            theirs = harness.NONE if published is None else f"{paper_ratio(case):.2f}"
            ratios = (
                _of_the_first(some, runs[form, FIRST.name, True]) for some, form in ((paper, PAPER_FORM), (ours, OURS))
            )
            points = harness.spread([float(run.track.points.mean()) for run in ours], 0)
            head = (case.name, "controlled" if control else "as in the first")
            more, last = (theirs, *ratios, points, _tracked(paper), _tracked(ours)), _tracked(ideal)
        rows.append((*head, title, *cells, *more, _figure(ideal, "position", key), last))
    return rows


def _figure(runs: Sequence[Run], name: str, key: str) -> str:
    return harness.spread(*error_figures([run.errors for run in runs], name, key))


def _tracked(runs: Sequence[Run]) -> str:
    return harness.percent([float(run.track.tracking.mean()) for run in runs])


def _of_the_first(runs: Sequence[Run], firsts: Sequence[Run]) -> str:
    ratios = [run.mean_xy_m / first.mean_xy_m for run, first in zip(runs, firsts, strict=False)]
    return harness.spread(ratios) if np.isfinite(ratios).all() else harness.NONE


def paper_ratio(case: Case) -> float:
    """The paper's mean error in x and y over that of its first case."""
    assert case.paper is not None
    assert FIRST.paper is not None
    return math.hypot(*case.paper[0][:2]) / math.hypot(*FIRST.paper[0][:2])


def _headline(runs: Runs) -> harness.Headline:
    def ratios(form: str) -> str:
        errors_m = [float(np.mean([run.mean_xy_m for run in runs[form, c.name, True]])) for c in (SECOND, THIRD, FIRST)]
        return ", ".join(f"{error_m / errors_m[-1]:.2f}" for error_m in errors_m[:-1])

    def points(case: Case, control: bool) -> float:
        return float(np.mean([run.track.points.mean() for run in runs[OURS, case.name, control]]))

    left = [100.0 * points(case, False) / points(FIRST, True) for case in (SECOND, THIRD)]
    return harness.Headline(
        "mean error of the second and third case over the first's; line points left without control",
        f"{paper_ratio(SECOND):.2f}, {paper_ratio(THIRD):.2f}; none, {harness.NONE}",
        f"{ratios(OURS)}; {left[0]:.0f} %, {left[1]:.0f} %; ideal {ratios(IDEAL)}",
    )


def _switched_off(runs: Sequence[Run]) -> str:
    """What the third case leaves of the line points while the lamps are off."""
    parts = []
    for turn, level in enumerate(LEFT_ON):
        left = []
        for run in runs:
            interval = (np.arange(len(run.track.points)) + 1) / RATE_HZ // SWITCH_S
            off = (interval % 2 == 1) & (interval // 2 % len(LEFT_ON) == turn)
            left.append(100.0 * float(run.track.points[off].mean() / run.track.points[interval % 2 == 0].mean()))
        parts.append(f"{harness.spread(left, 0)} % at {500.0 * level:g} lx")
    return f"Third case without control, line points while the lamps are off: {', '.join(parts)}."


def _darkness(dark: Sequence[FloatArray]) -> str:
    """How far the first case's settings reach, from each seed's `points_in_the_dark`."""
    parts = []
    for k, level in enumerate(DARKER, start=1):
        fixed, controlled = (
            harness.spread([100.0 * float(each[k, c] / each[0, c]) for each in dark], 0) for c in (0, 1)
        )
        parts.append(f"{500.0 * level:g} lx ({level:g}) {fixed} % and {controlled} %")
    return (
        "Line points at eight places per seed in even light, as a share of those under lamps, without control and with "
        f"it: {'; '.join(parts)}."
    )


def _exposures(runs: Runs) -> str:
    """How far the control moved."""
    stops = {case.name: [run.stops for run in runs[OURS, case.name, True]] for case in CASES}
    base = np.mean([each[0] for each in stops[FIRST.name]])
    means = {name: 2.0 ** (np.mean([one.mean() for one in each]) - base) for name, each in stops.items()}
    most = {name: 2.0 ** (np.max([one.max() for one in each]) - base) for name, each in stops.items()}
    exposures = ", ".join(f"{name}: {mean:.2f} (at most {most[name]:.2f})" for name, mean in means.items())
    return f"Exposure times gain under control, over that of the first case's start: {exposures}."


def _tracks_figure(drives: Sequence[tuple[str, Run]]) -> Figure:
    """As figure 8 (a), (e), (f): black the way, red the traces, black points where the exposure was searched."""
    field, names = Simulation(open_scenario("lighting-1")).field, [name for name, _ in drives]
    figure, axes = new_figure(1, len(drives), (4.6 * len(drives), 3.6), names, field=field)
    for axis, (_, run) in zip(axes, drives, strict=True):
        way(axis, run.track.truth, "black", 1.8, zorder=2)
        way(axis, run.track.poses[run.track.tracking], RED, 0.8, zorder=3)
        dots(axis, run.track.truth[run.searched], "black", 6, zorder=4)
    return figure


def _exposure_figure(runs: Runs) -> Figure:
    """Line points and exposure over time, with control and without."""
    columns = len(WITHOUT)
    figure, axes = new_figure(2, columns, (4.6 * columns, 5.4))
    for k, case in enumerate(WITHOUT):
        for control, colour, label in ((True, BLUE, "controlled"), (False, RED, "as in the first case")):
            run = runs[OURS, case.name, control][0]
            seconds = (np.arange(len(run.track.points)) + 1) / RATE_HZ
            axes[k].plot(seconds, run.track.points, color=colour, linewidth=1.0, label=label)
            axes[k + columns].plot(seconds, 2.0**run.stops, color=colour, linewidth=1.2)
        axes[k].set(title=case.name, ylim=(0, None))
        axes[k + columns].set(yscale="log", xlabel="time (s)", ylim=(4.0, 1200.0))
    axes[0].set_ylabel("line points")
    axes[columns].set_ylabel("exposure · gain (ms)")
    axes[2].legend(frameon=False, loc="lower right")
    return figure
