"""iris-lines (figures 13 and 14): line detection and range regression under three lightings at the same place."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from touchline.config import PAPER, load_settings
from touchline.errors import TouchlineError
from touchline.field import FieldModel, open_field
from touchline.geometry import FloatArray, Pose
from touchline.published.iris_fusion.hsv_lines import HsvLineDetector, HsvLinePaper, HsvLineSettings
from touchline.published.iris_fusion.range_picture import range_picture
from touchline.published.iris_fusion.range_regression import RangeRegression
from touchline.types import ImageArray, LinePoints
from touchline_lab.experiments import harness
from touchline_lab.experiments.iris_runs import DIRECTIONS, MARK_NOISE_PX, range_regression
from touchline_lab.experiments.scenes import BLUE, PAINT, RED, dots, image_figure, new_figure, random_place
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import MotionSettings, OthersSettings, open_scenario
from touchline_lab.simulation.world.calibration_layout import STRIP_EDGES_M

FIELD = "indoor-9x6"
CONDITIONS = {
    "1: lamps and daylight": "lighting-1",
    "2: sun through windows": "lighting-3",
    "3: dim, no lamps": "lighting-2",
}
THRESHOLDS = {
    "automatic": HsvLineSettings(),
    "set by hand under 1": HsvLineSettings(paper=HsvLinePaper(thresholds="fixed")),
    "automatic, no green wanted beside": HsvLineSettings(paper=HsvLinePaper(min_green=0)),
    "its form here": load_settings(HsvLineSettings, preset=PAPER),
}
TRUE_M, FALSE_M = 0.1, 0.3
COLUMNS = (
    "lighting", "thresholds", "paper", "points", "on a line", "false", "median (cm)", "90 % (cm)", "ideal: points",
    "ideal: false", "ideal: median (cm)",
)  # fmt: skip


@dataclass(frozen=True, eq=False, slots=True)
class Detection:
    """Line points of one image. distances_m (N,): to the nearest line of the field at the true pose."""

    image: ImageArray
    pose: Pose
    points: LinePoints
    distances_m: FloatArray


def iris_lines(seeds: int) -> harness.ExperimentResult:
    """One place per seed on the 9 x 6 m field, each under the three lightings."""
    field = open_field(FIELD)
    places = [_one_place(field, seed) for seed in harness.follow(harness.seed_range(seeds), "places")]
    found = harness.together(by_case for _, by_case in places)
    ideal = harness.together(
        _one_place(field, seed, ideal=True)[1] for seed in harness.follow(harness.seed_range(seeds), "ideal robots")
    )
    residuals_cm = [100.0 * float(np.sqrt(np.mean(regression.residuals_m**2))) for regression, _ in places]
    medians_cm = 100.0 * np.array(_over_lightings(found, np.median))
    shown = {condition: found[condition, "automatic"][0] for condition in CONDITIONS}
    return harness.ExperimentResult(
        "Figures 13 and 14 of Ismail et al. 2021: line detection and range regression under three lightings",
        COLUMNS,
        [(*case, "shown", *_cells(found[case], ideal[case])) for case in found],
        harness.Headline(
            "false points; median distance from the line, three lightings, the same settings",
            "pictures; thresholds set by hand for each",
            f"{harness.percent(_over_lightings(found, _false_ratio))}; {harness.spread(medians_cm, 1)} cm; "
            f"ideal {harness.percent(_over_lightings(ideal, _false_ratio))}",
        ),
        (
            f"On a line: within {100 * TRUE_M:.0f} cm of one at the true pose; false: farther than {100 * FALSE_M:.0f} "
            "cm from any (penalty marks count as false). Three robots and a ball stand on the field; exposure and gain "
            "stay as they are under condition 1.",
            f"Ranges by a polynomial of degree {places[0][0].degree}, fitted to {len(STRIP_EDGES_M)} distances in "
            f"{DIRECTIONS} directions, each read to {MARK_NOISE_PX} px: residuals {harness.spread(residuals_cm, 1)} cm "
            f"(root mean square). Points beyond {STRIP_EDGES_M[-1]:g} m, the last of them, are dropped.",
            "Robots as built; its form here: with the preset `paper`, thresholds set by hand under condition 1, and "
            "every run of white in the hull. The paper found condition 3, the dim one, smoothest, and set its "
            "thresholds by hand for each condition; it tells no figures.",
        ),
        (
            ("detection", _detection_figure(shown)),
            ("points", _points_figure(field, shown)),
            ("regression", image_figure([range_picture(places[0][0])], (7.2, 7.6))[0]),
        ),
    )


def _one_place(
    field: FieldModel, seed: int, ideal: bool = False
) -> tuple[RangeRegression, dict[tuple[str, str], Detection]]:
    """The seed's regression, and what each kind of thresholds finds under each lighting at the seed's place."""
    place = random_place(field, np.random.default_rng([seed, 13]), margin_m=0.5)
    regression: RangeRegression | None = None
    found = {}
    for condition, scenario in CONDITIONS.items():
        simulation = _standing(scenario, place, seed, ideal)
        if regression is None:
            regression = range_regression(simulation, np.random.default_rng([seed, 14]))
        image, pose = simulation.image(0), simulation.truth[0]
        for thresholds, settings in THRESHOLDS.items():
            detector = HsvLineDetector(regression.camera(), settings, field.line_width)
            try:
                points = detector.detect(image)
            except TouchlineError as error:
                raise type(error)(f"iris-lines, {condition}, seed {seed}: {error}") from None
            distances_m = field.line_distances(pose.transform(points.positions_m))
            found[condition, thresholds] = Detection(image, pose, points, distances_m)
    assert regression is not None
    return regression, found


def _standing(scenario_name: str, place: Pose, seed: int, ideal: bool) -> Simulation:
    """A robot, as built or ideal, that stands at a place of the 9 x 6 m field in the light of a scenario."""
    scenario = open_scenario(scenario_name, seed, 0.2, ["ideal=true"] if ideal else [])
    mirror = scenario.camera.mirror.model_copy(update={"profile": "recorded"})
    changes = {
        "field": FIELD,
        "motion": MotionSettings(kind="stand", pose=(place.x, place.y, float(np.degrees(place.heading)))),
        "others": OthersSettings(robots=3, balls=1),
        "camera": scenario.camera.model_copy(update={"mirror": mirror}),
    }
    return Simulation(scenario.model_copy(update=changes))


def _cells(detections: Sequence[Detection], ideal: Sequence[Detection]) -> harness.Row:
    on_line = harness.spread([float(np.count_nonzero(each.distances_m <= TRUE_M)) for each in detections], 0)
    far = _quantile_cm(detections, 0.9)
    counts, false, median = zip(
        *(
            (harness.spread([float(len(each.points)) for each in some], 0), _false(some), _quantile_cm(some, 0.5))
            for some in (detections, ideal)
        ),
        strict=True,
    )
    return counts[0], on_line, false[0], median[0], far, counts[1], false[1], median[1]


def _false(detections: Sequence[Detection]) -> str:
    false = [float(np.count_nonzero(each.distances_m > FALSE_M)) for each in detections]
    return (
        f"{harness.spread(false, 1)} ({100 * _false_ratio(np.concatenate([d.distances_m for d in detections])):.1f} %)"
    )


def _quantile_cm(detections: Sequence[Detection], quantile: float) -> str:
    seen = [each.distances_m for each in detections if len(each.points)]
    return harness.spread([100.0 * float(np.quantile(d, quantile)) for d in seen], 1)


def _over_lightings(
    found: Mapping[tuple[str, str], Sequence[Detection]], figure: Callable[[FloatArray], float]
) -> list[float]:
    """Of each place a figure of the distances (m) of all points under the three lightings, thresholds automatic."""
    places = zip(*(found[condition, "automatic"] for condition in CONDITIONS), strict=True)
    return [figure(np.concatenate([each.distances_m for each in place])) for place in places]


def _false_ratio(distances_m: FloatArray) -> float:
    return float(np.mean(distances_m > FALSE_M)) if len(distances_m) else 0.0


def _detection_figure(shown: dict[str, Detection]) -> Figure:
    """Figure 13: the images with the points that were found."""
    figure, axes = image_figure([each.image for each in shown.values()], (4.0 * len(shown), 4.7))
    for axis, (condition, each) in zip(axes, shown.items(), strict=True):
        on_line = each.distances_m <= FALSE_M
        for chosen, tint in ((on_line, BLUE), (~on_line, RED)):
            dots(axis, each.points.pixels[chosen], tint, 3, fillstyle="none")
        axis.set_title(f"condition {condition}\n{len(each.points)} points, {np.sum(~on_line)} false", fontsize=9)
    return figure


def _points_figure(field: FieldModel, shown: dict[str, Detection]) -> Figure:
    """Figure 14: the points after the regression, laid on the field at the true pose."""
    figure, axes = new_figure(1, len(shown), (4.6 * len(shown), 3.6), field=field, beyond_m=1.0)
    for axis, (condition, each) in zip(axes, shown.items(), strict=True):
        dots(axis, each.pose.transform(each.points.positions_m), RED, 3, marker=".")
        axis.plot(each.pose.x, each.pose.y, "o", color=PAINT, markeredgecolor=BLUE)
        axis.set_title(f"condition {condition}", fontsize=9)
    return figure
