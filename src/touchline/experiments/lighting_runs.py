"""What lu2013-lighting drives: its cases of light, the loop of camera and exposure control, one run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from touchline.camera.exposure import ExposureControl, ExposureSettings, mirror_masks
from touchline.config import PAPER, load_settings
from touchline.errors import TouchlineError
from touchline.evaluation.metrics import ErrorTable
from touchline.experiments.drives import Drive, Track, track_of
from touchline.geometry import FloatArray
from touchline.perception import LinePointDetector
from touchline.perception.colour_file import load_colours, save_colours
from touchline.simulation.run import Simulation
from touchline.simulation.scenario import LightSettings, open_scenario
from touchline.systems import SYSTEMS, RobotSetup, open_system
from touchline.types import Frame, ImageArray

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
    "first: lamps",
    _light("lighting-1"),
    ((5.907, 5.967, 0.044), (7.334, 7.117, 0.052), (30.724, 35.595, 0.286)),
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
    searched: npt.NDArray[np.bool_]

    @property
    def errors(self) -> ErrorTable | None:
        """Since the first tracked image, None if there is none."""
        return self.track.table()

    @property
    def mean_xy_m(self) -> float:
        """Root of the squared mean errors in x and y, which is all that Table 2 tells; infinite without any."""
        errors = self.errors
        return float("inf") if errors is None else float(np.hypot(errors.x.mean, errors.y.mean))


class _Camera:
    """The simulated camera as the control wants it. `show`: the image that the next grab gives."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._ready: ImageArray | None = None

    def show(self, image: ImageArray | None) -> None:
        self._ready = image

    def set(self, exposure_ms: float, gain: float) -> None:
        self._simulation.set(exposure_ms, gain)
        self._ready = None  # it was taken with other settings

    def grab(self) -> ImageArray:
        image, self._ready = self._ready, None
        return self._simulation.grab() if image is None else image


class ControlledExposure:
    """The closed loop: image after image of a simulation, its exposure kept right. The robot waits for a search."""

    def __init__(self, simulation: Simulation, paper: bool = False) -> None:
        self.camera = _Camera(simulation)
        # at a few images per second each is looked at; the paper looks every few cycles of 25 per second
        settings = load_settings(ExposureSettings, None, ["check_every=1"], preset=PAPER if paper else None)
        self.control = ExposureControl(self.camera, mirror_masks(simulation.camera), settings, START_MS)

    def image(self, taken: ImageArray | None) -> tuple[ImageArray, bool]:
        """The image to work with, where `taken` was taken with the settings of now; whether they were searched."""
        self.camera.show(taken)
        searching = self.control.waiting
        image = self.control.step()
        searching |= self.control.waiting
        while self.control.waiting:
            image = self.control.step()
        return (self.control.step() if searching else image), searching


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
    loop = ControlledExposure(run, robot.paper) if fixed is None else None
    if fixed is not None:
        run.set(*fixed)
    estimates, stops, searched = [], [], []
    for index in range(len(run)):
        frame, sought = run.frame(index), False
        if loop is not None:
            image, sought = loop.image(frame.image)
            frame = replace(frame, image=image, exposure_ms=run.exposure_ms, gain=run.gain)
        estimates.append(system.step(frame))
        stops.append(np.log2(run.exposure_ms * run.gain))
        searched.append(sought)
    frames = [Frame(int(stamp)) for stamp in run.image_stamps]
    track = track_of(Drive(setup, frames, np.asarray(run.truth.poses, dtype=np.float64)), estimates)
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
