"""nees: how honest the stated covariance is, with robots drawn anew from what their camera.yaml states.

No figure of a paper. NEES is the squared error of x, y and heading in the measure of the stated covariance.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from touchline.camera import OmniCamera
from touchline.camera.uncertainty import CameraUncertainty
from touchline_lab.experiments.clutter import one_line
from touchline_lab.experiments.drives import Track, driven, followed
from touchline_lab.experiments.harness import NONE, ExperimentResult, Headline, Row, gathered, interval, seed_range
from touchline_lab.experiments.injections import Fault
from touchline_lab.experiments.scenes import BLUE, new_figure

SYSTEMS = ("nubot-mti", "nubot-mcl", "iris-fusion", "touchline")
ROBOTS = 10  # per seed
SECONDS, FROM_S = 20.0, 5.0  # of a drive; errors count from here on
LINE_S, LINE_END_S = 8.0, 18.0
DEGREES_OF_FREEDOM = 3
LARGER = 3.0
_FOUR = "camera.black_sectors_deg=[[22.5,67.5],[112.5,157.5],[202.5,247.5],[292.5,337.5]]"


class Condition(NamedTuple):
    """changes: of the scenario. line: one line in view from LINE_S on. larger: errors by so much larger than stated."""

    name: str
    changes: tuple[str, ...] = ()
    line: bool = False
    larger: float = 1.0

    @property
    def counted_s(self) -> tuple[float, float]:
        """The time that counts."""
        return (LINE_S, LINE_END_S) if self.line else (FROM_S, SECONDS)


CONDITIONS = (
    Condition("free"),
    Condition("50 % hidden", (_FOUR,)),
    Condition("one line for 10 s", line=True),
    Condition(f"errors {LARGER:g} times as large as stated", larger=LARGER),
    Condition("free, of the design, ranges 1 %", ("camera.known_from=design", "camera.mirror.range_spread=0.01")),
    Condition("100 ms late", ("camera.delay_s=0.1",)),
)
TICKS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)  # of the picture
COLUMNS = ("condition", "system", "NEES / 3", "95 % ellipse covers (%)", "error (cm)", "stated (cm)", "tracked (%)")


class Honesty(NamedTuple):
    """Of one robot, over its tracked frames: mean NEES per degree of freedom, share of frames within the 95 % ellipse,
    mean error and root mean square stated deviation of the position (m). tracked: share of all frames that count.
    """

    nees: float
    covered: float
    error_m: float
    stated_m: float
    tracked: float


Found = Mapping[tuple[str, str], Sequence[Honesty]]  # by condition and system


def nees(seeds: int) -> ExperimentResult:
    """Every condition for every system, ten robots per seed."""
    return page(gathered(_robot, seed_range(seeds, ROBOTS), "robots"))


def _robot(seed: int) -> dict[tuple[str, str], Honesty]:
    """One robot under every condition, with every system."""
    return {(c.name, system): honesty(c, system, seed) for c in CONDITIONS for system in SYSTEMS}


def page(found: Found) -> ExperimentResult:
    """The table, headline and picture."""
    asked = [_tracked(found[c.name, system]) for c in CONDITIONS[:3] for system in SYSTEMS]
    means = [float(np.mean([one.nees for one in each])) for each in asked]
    covers = [100.0 * float(np.mean([one.covered for one in each])) for each in asked]
    return ExperimentResult(
        "How honest the stated covariance is: NEES per degree of freedom, and how much of the time the truth lies "
        "within the 95 % ellipse of x, y and heading",
        COLUMNS,
        [(*key, *_cells(each)) for key, each in found.items()],
        Headline(
            "NEES per degree of freedom; 95 % ellipse covers: free, 50 % hidden, one line, four systems",
            NONE,
            f"{min(means):.2f}-{max(means):.2f}; {min(covers):.0f}-{max(covers):.0f} %",
        ),
        (
            f"Robots as built, observation level, {ROBOTS} robots per seed, each drawn anew; {SECONDS:g} s of "
            f"straight-tracks, shoves included; tracked frames from {FROM_S:g} s on. Brackets: where the mean over "
            "robots lies with 95 %, by bootstrap. camera.yaml from calibrate mirror where nothing else is said.",
            f"One line: from {LINE_S:g} s for 10 s the points of one line alone, and no others count. 50 %: four black "
            f"sectors of 45 degrees. Errors {LARGER:g} times as large as stated: camera.yaml states a third. 100 ms "
            "late: each image comes so long after its stamp, which is right.",
        ),
        (("robots", _figure(found)),),
    )


def honesty(condition: Condition, system: str, seed: int) -> Honesty:
    """One robot under one condition."""
    drive = driven("straight-tracks", seed, SECONDS, *condition.changes)
    if condition.line:
        fault = Fault("", LINE_S, LINE_END_S, one_line)
        drive = fault.laid_into(drive, np.random.default_rng([seed, 14]))
    camera = drive.setup.camera
    if condition.larger != 1.0 and isinstance(camera, OmniCamera):
        stated = CameraUncertainty(*(value / condition.larger for value in camera.uncertainty))
        drive = replace(drive, setup=replace(drive.setup, camera=replace(camera, stated_uncertainty=stated)))
    return honesty_of(followed(system, drive, seed), condition.counted_s)


def honesty_of(track: Track, counted_s: tuple[float, float]) -> Honesty:
    """What a system's covariances are worth, in the time that counts."""
    from scipy.stats import chi2

    kept, share = track.tracked_from(*counted_s)
    if not share:
        return Honesty(*4 * (float("nan"),), 0.0)
    squares = kept.squares
    return Honesty(
        float(squares.mean()) / DEGREES_OF_FREEDOM,
        float(np.mean(chi2.cdf(squares, DEGREES_OF_FREEDOM) < 0.95)),
        float(kept.distances_m.mean()),
        float(np.sqrt(np.mean(kept.deviations_m**2))),
        share,
    )


def _tracked(robots: Sequence[Honesty]) -> list[Honesty]:
    return [one for one in robots if one.tracked]


def _cells(robots: Sequence[Honesty]) -> Row:
    seen = _tracked(robots)
    return (
        interval([one.nees for one in seen]),
        interval([100.0 * one.covered for one in seen], 1),
        interval([100.0 * one.error_m for one in seen]),
        interval([100.0 * one.stated_m for one in seen]),
        f"{100.0 * np.mean([one.tracked for one in robots]):.1f}",
    )


def _figure(found: Found) -> Figure:
    """NEES per degree of freedom of each robot, by condition; the grey band is what is asked."""
    figure, axes = new_figure(1, len(SYSTEMS), (14.0, 3.6), SYSTEMS, ("NEES / 3", ""))
    for each, system in zip(axes, SYSTEMS, strict=True):
        each.axvspan(0.5, 2.0, color="0.9")
        for row, c in enumerate(CONDITIONS):
            values = [one.nees for one in _tracked(found[c.name, system])]
            each.semilogx(values, np.linspace(row - 0.3, row + 0.3, len(values)), ".", color=BLUE, markersize=3)
        each.set_yticks(range(len(CONDITIONS)), [c.name if system == SYSTEMS[0] else "" for c in CONDITIONS])
        each.invert_yaxis()
        each.set_xticks(TICKS, [f"{tick:g}" for tick in TICKS])
        each.set_xticks([], minor=True)
    return figure
