"""lu2013-exposure: the entropy over exposure and gain, its ridge, the search along the path (figures 6, 10, 11)."""

from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from touchline.camera.exposure import ExposureControl, ExposureSettings, image_entropy, mirror_masks
from touchline.camera.exposure_search import Tried
from touchline.config import PAPER, load_settings
from touchline.errors import TouchlineError
from touchline.geometry import BoolArray, FloatArray
from touchline.perception import LinePointDetector
from touchline.sources import Recording
from touchline.types import ImageArray
from touchline_lab.experiments.harness import NONE, ExperimentResult, Headline, Row, follow, seed_range, spread
from touchline_lab.experiments.scenes import BLUE, MAGENTA, RED, dots, new_figure, public_recording, random_place
from touchline_lab.simulation.cameras.image_sensor import LinearImageCamera
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario
from touchline_lab.simulation.world.world import WorldState

CASES = {"lamps": "lighting-1", "dull day, lamps off": "lighting-2", "lamps and sun": "lighting-3"}
PUBLIC = "omni_exposure"
NEAR = 0.05  # nats below the peak that count as found
_GRID = 22
_STEP_STOPS = 0.1
_TINTS = (BLUE, "#4d5a55", RED)


@dataclass(eq=False, slots=True)
class Case:
    """One lighting at one place: its camera, its masks, and the entropy along the path (N,) at places (N,) stops.

    masks: `mirror_masks`. They are of the camera that took the images: entropy over another's ring is another figure.
    """

    name: str
    camera: LinearImageCamera
    masks: tuple[BoolArray, BoolArray]
    stops: FloatArray
    entropy: FloatArray

    @property
    def peak(self) -> int:
        """Index of the highest entropy."""
        return int(np.argmax(self.entropy))


@dataclass(eq=False, slots=True)
class Change:
    """A search that a change of light to a case started."""

    after: Case
    tried: list[Tried]

    @property
    def loss(self) -> float:
        """How far the best image of the search stays below the peak (nats)."""
        return float(self.after.entropy.max() - max(t.entropy for t in self.tried))


class _Switched:
    """The camera of whichever light is on."""

    def __init__(self, source: LinearImageCamera) -> None:
        self.source = source
        self._set = (12.0, 1.7)

    def set(self, exposure_ms: float, gain: float) -> None:
        self._set = (exposure_ms, gain)

    def grab(self) -> ImageArray:
        self.source.set(*self._set)
        return self.source.grab()


def lu2013_exposure(seeds: int) -> ExperimentResult:
    """Each seed another place in the simulated hall under three lightings; then the recorded linear images."""
    ours = ExposureSettings(check_every=1)
    papers = load_settings(ExposureSettings, None, ["check_every=1"], preset=PAPER)
    simulation = Simulation(open_scenario(CASES["lamps"], 0))
    recording = public_recording(PUBLIC)
    places = [_simulated_cases(seed, ours) for seed in follow(seed_range(seeds), "places")]
    ideal = [_simulated_cases(seed, ours, ideal=True) for seed in follow(seed_range(seeds), "ideal robots")]
    recorded = [] if recording is None else _recorded_cases(recording, ours)
    built_paper, printed = (
        [[_case(case.name, case.camera, case.masks, papers) for case in cases] for cases in some]
        for some in (places, recorded)
    )
    groups = [("robot as built", [*zip(places, built_paper, strict=True)])]
    groups += [("ideal robot", [(cases, []) for cases in ideal])]
    groups += [(f"recorded, place {k}", [pair]) for k, pair in enumerate(zip(recorded, printed, strict=True))]
    rows = [_case_row(source, k, pairs, (ours, papers)) for source, pairs in groups for k in range(len(pairs[0][0]))]
    changes, in_its_form, at_best = (
        [change for cases in follow(some, what) for change in _all_changes(cases, settings)]
        for some, what, settings in (
            ([*places, *recorded], "searches at places", ours),
            ([*built_paper, *printed], "searches in its form", papers),
            (ideal, "searches of ideal robots", ours),
        )
    )
    notes = [
        f"Changes from one lighting to another, robots as built and recorded images: {_searched(changes)}. Its form "
        f"here: {_searched(in_its_form)}. Ideal robots: {_searched(at_best)}. The first image of each is the one that "
        "showed the change.",
        f"Path: exposure = {ours.path.a_ms:g} ms · gain, its form here exposure = {papers.path.a_ms:g} ms · gain; "
        "entropy over the field's ring (its form: the whole image), natural logarithm, three channels added. The "
        "paper's camera counts gain in its own units, so only the shape can be compared.",
    ]
    if recording is None:
        notes.append(
            f"The recorded images ({PUBLIC}) were not found; TOUCHLINE_DATA names the folder of the recordings."
        )
    shown = [*recorded, *places][0]
    pictures = [
        ("surface", _surface_figure([places[0][0], *(cases[1] for cases in recorded[:1])], ours)),
        ("path", _path_figure([places[0], *recorded[:1]], ours)),
        ("images", _images_figure(places[0], simulation, ours)),
    ]
    sun = next(c for c in _all_changes(shown, ours) if "sun" in c.after.name)
    return ExperimentResult(
        "Figures 6, 10 and 11 of Lu et al. 2013: image entropy over exposure and gain, and the search for its peak",
        ("images", "light", "paper: best", "its form here", "exposure (ms)", "gain", "highest entropy"),
        rows,
        Headline(
            "images until the best exposure after a change of light; entropy short of the peak",
            "several; –",
            f"{np.mean([len(c.tried) for c in changes]):.1f}, at most {max(len(c.tried) for c in changes)}; "
            f"{max(c.loss for c in changes):.3f} (sun: {len(sun.tried)})",
        ),
        notes,
        pictures,
    )


def _searched(changes: list[Change]) -> str:
    """How the searches went that changes of light have started."""
    found = sum(change.loss <= NEAR for change in changes)
    grabs = [len(change.tried) for change in changes]
    return (
        f"{found} of {len(changes)} searches end within {NEAR:g} nats of the highest entropy on the path, at worst "
        f"{max(c.loss for c in changes):.3f} below it, after {np.mean(grabs):.1f} images on average and {max(grabs)} "
        "at most"
    )


def _simulated_cases(seed: int, settings: ExposureSettings, ideal: bool = False) -> list[Case]:
    """The three lightings at the seed's place, of a robot as built or ideal."""
    cases = []
    for k, (name, scenario) in enumerate(CASES.items()):
        simulation = Simulation(open_scenario(scenario, seed, changes=["ideal=true"] if ideal else []))
        place = random_place(simulation.field, np.random.default_rng(seed), margin_m=1.0)
        state = WorldState() if ideal else simulation.state(0.0)
        radiance = simulation.camera_model.radiance(simulation.world, state, place).copy()
        camera = LinearImageCamera(radiance, simulation.camera_model.sensor, np.random.default_rng([seed, k]))
        cases.append(_case(name, camera, mirror_masks(simulation.camera), settings))
    return cases


def _recorded_cases(recording: Recording, settings: ExposureSettings) -> list[list[Case]]:
    """Each place of the recording, its lightings as the events of sequence.yaml name them."""
    masks = mirror_masks(recording.camera)
    names = [str(event.get("condition", k)) for k, event in enumerate(recording.events)]
    per_place = len(dict.fromkeys(names))
    cases = [
        _case(name, LinearImageCamera.open(recording, k, np.random.default_rng(k)), masks, settings)
        for k, name in follow(list(enumerate(names[: len(recording)])), "recorded images")
    ]
    return [cases[k : k + per_place] for k in range(0, len(cases), per_place)]


def _case(name: str, camera: LinearImageCamera, masks: tuple[BoolArray, BoolArray], settings: ExposureSettings) -> Case:
    low, high = settings.path.stops_range
    stops = np.arange(low, high + 1e-9, _STEP_STOPS)
    mask = None if settings.whole_image else masks[1]
    entropy = [_entropy(camera, *settings.path.at(float(place)), mask) for place in stops]
    return Case(name, camera, masks, stops, np.array(entropy))


def _entropy(camera: LinearImageCamera, exposure_ms: float, gain: float, mask: BoolArray | None) -> float:
    camera.set(exposure_ms, gain)
    return image_entropy(camera.grab(), mask)


def _all_changes(cases: list[Case], settings: ExposureSettings) -> list[Change]:
    return [_change(a, b, settings) for a in cases for b in cases if a is not b]


def _change(before: Case, after: Case, settings: ExposureSettings) -> Change:
    """From the best settings of one light into another."""
    camera = _Switched(before.camera)
    control = ExposureControl(camera, after.masks, settings, start_ms=2.0 ** float(before.stops[before.peak]))
    control.start_at_rest()
    control.step()
    camera.source = after.camera
    control.step()
    if not control.waiting:  # so little has changed that the control leaves it: searched all the same
        control.start_search(settings.search.step_stops)
    return Change(after, control.optimise())


def _case_row(
    source: str, k: int, pairs: list[tuple[list[Case], list[Case]]], both: tuple[ExposureSettings, ExposureSettings]
) -> Row:
    """pairs: at each place the cases by our settings and by the paper's (both)."""
    cases, papers = [pair[0][k] for pair in pairs], [pair[1][k] for pair in pairs if pair[1]]
    best, printed = (
        [settings.path.at(float(case.stops[case.peak])) for case in some]
        for some, settings in zip((cases, papers), both, strict=True)
    )
    name = cases[0].name
    paper = "12 ms, 12" if "sun" in name else "18 ms, 18" if name == "lamps" else NONE
    its_form = f"{spread([b[0] for b in printed], 1)} ms, {spread([b[1] for b in printed], 1)}" if printed else NONE
    return (
        source, name, paper, its_form, spread([b[0] for b in best], 1), spread([b[1] for b in best]),
        spread([float(case.entropy.max()) for case in cases]),
    )  # fmt: skip


def _surface_figure(cases: list[Case], settings: ExposureSettings) -> Figure:
    """Figure 6 (a), (b): seen from above, with the ridge and the path."""
    figure, axes = new_figure(1, len(cases), (5.2 * len(cases), 4.4))
    exposures, gains = np.geomspace(1.0, 120.0, _GRID), np.geomspace(0.5, 30.0, _GRID)
    for axis, case, title in zip(axes, cases, ("simulated hall", "recorded linear images"), strict=False):
        surface = np.array([[_entropy(case.camera, e, g, case.masks[1]) for e in exposures] for g in gains])
        drawn = axis.contourf(exposures, gains, surface, levels=18, cmap="viridis")
        figure.colorbar(drawn, ax=axis, label="entropy (nats)")
        ridge = exposures[np.argmax(surface, axis=1)]
        inner = (ridge > exposures[0]) & (ridge < exposures[-1])
        axis.plot(ridge[inner], gains[inner], color="#4fa3ff", linewidth=2.2, label="ridge")
        path = np.array([settings.path.at(float(s)) for s in case.stops])
        axis.plot(path[:, 0], path[:, 1], color="black", linewidth=1.8, label="path")
        axis.plot(*path[case.peak], "o", color=MAGENTA, label="best on the path")
        axis.set(xscale="log", yscale="log", xlabel="exposure (ms)", ylabel="gain", title=f"{title}: {case.name}")
        axis.set(xlim=(exposures[0], exposures[-1]), ylim=(gains[0], gains[-1]))
        axis.legend(loc="lower left", fontsize=8)
    return figure


def _path_figure(places: list[list[Case]], settings: ExposureSettings) -> Figure:
    """Figures 6 (c), 11 (c): entropy along the path for each light, and the searches from the light before."""
    figure, axes = new_figure(1, len(places), (5.6 * len(places), 4.2))
    for axis, cases, title in zip(axes, places, ("simulated hall", "recorded linear images"), strict=False):
        for k, (case, tint) in enumerate(zip(cases, _TINTS, strict=False)):
            axis.plot(2.0**case.stops, case.entropy, color=tint, label=case.name)
            tried = _change(cases[k - 1], case, settings).tried
            axis.plot([2.0**t.stops for t in tried], [t.entropy for t in tried], "o", color=tint, markersize=4)
            for number, t in enumerate(tried, start=1):
                axis.annotate(str(number), (2.0**t.stops, t.entropy), (2, 4), textcoords="offset points", fontsize=7)
        axis.set(xscale="log", xlabel="exposure · gain (ms)", ylabel="entropy (nats)", title=title)
        axis.legend(fontsize=8, title="dots: images of the search\nthat the change to it starts", title_fontsize=7)
    return figure


def _images_figure(cases: list[Case], simulation: Simulation, settings: ExposureSettings) -> Figure:
    """Figures 10, 11 (a), (b): the sun with the lamps' settings and with its own; colours learned under the lamps."""
    lamps, sun = cases[0], cases[-1]
    detector = LinePointDetector(simulation.camera, line_width_m=simulation.field.line_width)
    shots = [(lamps, lamps, "lamps, their best settings"), (lamps, sun, "sun, the lamps' settings"),
             (sun, sun, "sun, its own best settings")]  # fmt: skip
    figure, axes = new_figure(2, len(shots), (4.0 * len(shots), 8.2))
    for k, (settings_of, light, title) in enumerate(shots):
        exposure_ms, gain = settings.path.at(float(settings_of.stops[settings_of.peak]))
        light.camera.set(exposure_ms, gain)
        image = light.camera.grab()
        if k == 0:
            try:
                detector.learn([image])
            except TouchlineError as error:
                raise type(error)(f"lu2013-exposure, {title}: {error}") from None
        points = detector.detect(image)
        assert detector.colours is not None
        axes[k].imshow(image[..., ::-1])
        axes[k].set_title(f"{title}\n{exposure_ms:.1f} ms, gain {gain:.2f}", fontsize=9)
        palette = np.array([(60, 60, 60), (60, 160, 70), (245, 245, 245)], dtype=np.uint8)
        axes[k + 3].imshow(palette[detector.colours.classify(image)])
        dots(axes[k + 3], points.pixels, RED, 3, marker=".")
        axes[k + 3].set_title(f"{len(points)} line points, colours of the first", fontsize=9)
    for axis in axes:
        axis.axis("off")
    return figure
