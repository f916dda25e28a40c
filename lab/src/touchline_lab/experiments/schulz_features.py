"""schulz-features (figures 1 and 2): lines, crossings and boundary of the line graph against the projected truth."""

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from matplotlib.figure import Figure

from touchline.camera import GroundView, ground_view
from touchline.geometry import FloatArray, Pose
from touchline.motion import LeanFilter
from touchline.perception.line_graph import LineGraphDetector, LineGraphSettings
from touchline.published.nimbro_lines.system import NimbroLines
from touchline.sources import Recording
from touchline.systems import RobotSetup
from touchline.types import Estimate, Frame, ImageArray, Prior
from touchline_lab.experiments import scenes
from touchline_lab.experiments.harness import (
    NONE,
    ExperimentResult,
    Headline,
    Row,
    follow,
    seed_range,
    share_text,
    together,
)
from touchline_lab.experiments.schulz_runs import PAPER, RECORDINGS, random_areas, start_about
from touchline_lab.experiments.schulz_runs import settings as system_settings
from touchline_lab.feature_truth import Tally, TrueFeatures
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

FIELDS = ("indoor-9x6", "humanoid-kid-9x6")
CROSSINGS_M, LINES_M, LANDMARKS_M = 3.0, 5.0, 5.0
_PLACES, _SECONDS = 2, 2.0  # per seed, and of each walk there
VARIANTS = {"ours": system_settings().line_graph, "paper": system_settings(PAPER).line_graph}
LANDMARKS = {"post": "posts", "pole": "poles", "penalty_mark": "penalty marks"}
_FIGURE_1 = ("colour classes", "skeleton", "line structure graph", "key nodes")


@dataclass(eq=False)
class FeatureScores:
    """Sums over all frames of one source. tallies: by the feature's name in the table. landmarks_m: errors of the right
    ones. boundary_px: of all columns.

    time_ms: of each frame but those that teach the colours, processor time.
    """

    tallies: dict[str, Tally] = field(default_factory=dict)
    landmarks_m: list[float] = field(default_factory=list)
    boundary_px: list[float] = field(default_factory=list)
    time_ms: list[float] = field(default_factory=list)


def measure(source: Recording | Simulation, settings: LineGraphSettings | None = None) -> FeatureScores:
    """What a detector finds in the images of a source, against its truth."""
    detector = LineGraphDetector(source.camera, settings or LineGraphSettings(), source.field)
    scores, leaning, tallies = FeatureScores(), LeanFilter(), list[dict[str, Tally]]()
    for index, late, truth in _frames(source):
        frame = leaning.at_image(late)
        learning, start = detector.colours.is_learning, time.thread_time()
        seen = detector.observe(frame)
        if not learning:
            scores.time_ms.append(1e3 * (time.thread_time() - start))
        image, classes = frame.image, detector.classes
        if image is None or classes is None:
            continue
        colours = (image - classes.model.green) @ classes.model.signal
        whiteness = _paint(source, index) if isinstance(source, Simulation) else colours
        true = TrueFeatures(source.field, truth, _view(frame, source), whiteness)
        crossings = true.tally_crossings(seen.crossings, CROSSINGS_M)
        landmarks = true.tally_landmarks(seen.landmarks, LANDMARKS_M)
        tallies.append(
            {f"{kind} crossings": crossings[kind] for kind in ("L", "T", "X", "all")}
            | {"lines": true.tally_lines(seen.lines, LINES_M)}
            | {name: landmarks[kind] for kind, name in LANDMARKS.items()}
        )
        scores.landmarks_m += true.landmark_errors_m(seen.landmarks)
        errors = true.boundary_error_px(seen.boundary.pixels)
        scores.boundary_px += errors[np.isfinite(errors)].tolist()
    scores.tallies = {name: Tally.total(each) for name, each in together(tallies).items()}
    return scores


def table(name: str, scores: FeatureScores) -> list[Row]:
    """Rows of a source: what, precision, recall, how many there are and were found."""
    rows: list[Row] = [
        (name, label, share_text(tally.precision), share_text(tally.recall), str(tally.there), str(tally.found))
        for label, tally in scores.tallies.items()
        if tally.there or tally.found
    ]
    if scores.landmarks_m:
        error = f"median {np.median(scores.landmarks_m):.2f} m"
        rows.append((name, "posts, poles, marks, error", error, "", "", str(len(scores.landmarks_m))))
    boundary = np.abs(scores.boundary_px)
    mean, median = NONE, NONE
    if len(boundary):
        mean, median = f"{boundary.mean():.1f} px", f"median {np.median(boundary):.1f} px"
    rows.append((name, "boundary, column error", mean, median, "", str(len(boundary))))
    rows.append((name, "time of a frame", f"{np.median(scores.time_ms):.1f} ms", "", "", str(len(scores.time_ms))))
    return rows


def schulz_features(seeds: int) -> ExperimentResult:
    """Walks in the simulator, and both recordings where they are found."""
    walks = [(name, number) for number in seed_range(seeds, _PLACES) for name in FIELDS]
    runs: list[tuple[str, str, int | None]] = [(field_name, "ours", seed) for field_name, seed in walks]
    runs += [(name, variant, None) for name in RECORDINGS if scenes.public_recording(name) for variant in VARIANTS]
    measured = together(
        {f"{name}, {variant if seed is None else 'rendered'}": measure(_source(name, seed), VARIANTS[variant])}
        for name, variant, seed in follow(runs, "runs of images")
    )
    scores = {name: _sum(each) for name, each in measured.items()}
    rows = [row for name, each in scores.items() for row in table(name, each)]
    total = Tally.total(each.tallies["all crossings"] for name, each in scores.items() if not name.endswith("paper"))
    return ExperimentResult(
        "Features of the line graph (Schulz and Behnke 2012, sections 3 and 4) against the projected truth",
        ("images of", "feature", "precision", "recall", "there", "found"),
        rows,
        Headline(
            f"crossings within {CROSSINGS_M:g} m: precision, recall",
            "not given",
            f"{share_text(total.precision)}, {share_text(total.recall)}",
        ),
        (
            f"Crossings within {CROSSINGS_M:g} m, matched within 0.25 m and by kind; one counts as there where the "
            "image shows paint in all of its arms and carpet between them: of rendered images where the renderer has "
            "paint, of recordings by the detector's own colours. Lines up to "
            f"{LINES_M:g} m; there where half a metre of one is in view; right within 10 cm and what 0.7° of lean do.",
            f"Posts, poles and penalty marks within {LANDMARKS_M:g} m, matched within 0.25 m, farther off a tenth of "
            "the range more; there where their foot lies in the image, hidden or not.",
            f"Rendered: {_PLACES} walks of {_SECONDS:g} s per seed, each from another place of the field to another. "
            "The camera's pose is that of the IMU or the kinematics, with their errors: these move the boundary, "
            "too. What stands on the field hides its boundary; that counts as error here.",
            "The pictures are of the first image that shows two crossings, by the paper's own form: the steps of "
            "figure 1; what is seen, where it lies in the robot frame, and the particles (black the truth, red the "
            "pose).",
        ),
        figures_1_and_2(scenes.public_recording(RECORDINGS[0]) or _source(FIELDS[0], 0)),
    )


def figures_1_and_2(source: Recording | Simulation) -> list[tuple[str, Figure]]:
    """Figure 1, the steps from an image to the key nodes; figure 2, what is seen, egocentric, and localized by it.

    Of the first image with two crossings, by the paper's own form; none where no image shows them.
    """
    system = NimbroLines(RobotSetup(source.field, source.camera), system_settings(PAPER), np.random.default_rng(0))
    detector = system.detector
    assert detector is not None
    for index, frame, truth in _frames(source):
        if not index:
            system.reset(Prior(start_about(truth, 0)))
        found = system.step(frame)
        if frame.image is not None and found.observation is not None and len(found.observation.crossings) > 1:
            stages = detector.stages(frame.image)
            steps = scenes.image_figure([stages[name] for name in _FIGURE_1], (13.0, 2.4))[0]
            return [("figure1", steps), ("figure2", _figure_2(stages["lines and crossings"], system, found, truth))]
    return []


def _figure_2(image: ImageArray, system: NimbroLines, found: Estimate, truth: Pose) -> Figure:
    figure, (seen, egocentric, field_axis) = scenes.new_figure(
        1, 3, (13.0, 3.6), ("seen", "robot frame (m)", "particles")
    )
    seen.imshow(image[..., ::-1])
    seen.axis("off")
    assert found.observation is not None
    for one, other in found.observation.lines.ends_m:
        egocentric.plot([one[0], other[0]], [one[1], other[1]], color=scenes.RED)
    for kind, place in zip(found.observation.crossings.kinds, found.observation.crossings.positions_m, strict=True):
        egocentric.annotate(str(kind), place, color=scenes.MAGENTA, weight="bold")
    scenes.dots(egocentric, found.observation.landmarks.positions_m, scenes.BLUE)
    scenes.dots(egocentric, np.zeros((1, 2)), scenes.INK, 7.0, marker=">")
    egocentric.set_aspect("equal")
    scenes.field_axes(field_axis, system.setup.field)
    scenes.dots(field_axis, system.particles.particles.poses, scenes.BLUE, 1.5, zorder=2)
    for pose, tint in ((truth, scenes.INK), (found.pose, scenes.RED)):
        field_axis.quiver(*pose[:2], math.cos(pose.heading), math.sin(pose.heading), color=tint, scale=15.0, zorder=3)
    return figure


def _source(name: str, seed: int | None) -> Recording | Simulation:
    """A recording, or with a seed a walk on a field."""
    if seed is not None:
        return Simulation(open_scenario("humanoid-walk", seed, _SECONDS, (f"field={name}", *random_areas(name, seed))))
    recording = scenes.public_recording(name)
    assert recording is not None
    return recording


def _sum(runs: Sequence[FeatureScores]) -> FeatureScores:
    tallies = {name: Tally.total(each) for name, each in together(run.tallies for run in runs).items()}
    lists = ([x for run in runs for x in getattr(run, part)] for part in ("landmarks_m", "boundary_px", "time_ms"))
    return FeatureScores(tallies, *lists)


def _frames(source: Recording | Simulation) -> Iterator[tuple[int, Frame, Pose]]:
    assert source.truth is not None
    for index, frame in enumerate(source):
        if frame.image is not None:
            yield index, frame, source.truth[index]


def _paint(run: Simulation, index: int) -> FloatArray:
    """(H, W) where the renderer has paint: twice its share of a pixel's light, which is 1 or more on lines."""
    time_s = float(run.image_times_s[index])
    pose, attitude = run.track.pose_at(time_s), run.track.attitude_at(time_s)
    return 2.0 * run.camera_model.paint_ratio(run.world, run.state(time_s), pose, attitude)[1]


def _view(frame: Frame, source: Recording | Simulation) -> GroundView:
    if frame.base_from_camera is not None or frame.tilt is None or not len(frame.tilt):
        return GroundView(source.camera, frame.base_from_camera)
    return ground_view(source.camera, None, *map(float, frame.tilt.values[-1]))
