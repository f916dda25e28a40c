"""schulz-games (section 6.3): two against two, unfavourable poses, a fall and re-entry at the side line."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from touchline.field import FieldModel, open_field
from touchline.geometry import FloatArray
from touchline_lab.experiments import schulz_runs as humanoids
from touchline_lab.experiments.drives import Drive, Track
from touchline_lab.experiments.harness import ExperimentResult, Headline, Row, gathered, percent, seed_range
from touchline_lab.experiments.scenes import BLUE, MAGENTA, dots, field_axes, new_figure, way
from touchline_lab.experiments.schulz_runs import OURS, PAPER, right_of, tracked, walk

FIELD, SECONDS = "indoor-9x6", 60.0
GAMES = 10  # per seed: 50 of five seeds
FALL_S, DOWN_S = 31.0, 5.0
_RATE_HZ = 8.0  # of the scenario's images
_INSIDE_M = 0.2  # of the side lines and corners that the robot visits
_TWO_AGAINST_TWO = ("others.robots=3", "others.moving=true", "others.near_m=1.2", "others.speed_m_s=0.5")


_BUILT = humanoids.AS_BUILT._replace(changes=_TWO_AGAINST_TWO)
_SIMULATED = humanoids.AS_SIMULATED._replace(changes=_TWO_AGAINST_TWO)
_TOLD = "as built, told of the fall"  # the system is
CASES = {
    ("as built", OURS): _BUILT,
    ("as built", PAPER): _BUILT,
    (_TOLD, OURS): _BUILT,
    ("as simulated", OURS): _SIMULATED,
    ("as simulated", PAPER): _SIMULATED,
    ("ideal, nobody else", OURS): humanoids.IDEAL,
}
COLUMNS = (
    "robot", "system", "right until the fall", "right again: median (s)", "90 % (s)", "longest (s)", "never",
    "believed while wrong", "at the other end",
)  # fmt: skip
_NOTES = (
    f"Games of {SECONDS:g} s on {FIELD} at the observation level, {GAMES} per seed: a robot walks between places at "
    "the side lines, in the corners and on the field, three others walk about close by. The robots are those of "
    "schulz-accuracy.",
    f"At {FALL_S - DOWN_S:g} s it falls and sees nothing for {DOWN_S:g} s; it enters again anywhere at a side line, "
    "facing the field. Its odometry does not know of it, and the system is told nothing, but in the rows so named: "
    "there it starts from nowhere. Times count from the first image, until the pose is right (0.5 m, 20°), believed, "
    f"and stays so for two seconds. Never: not within the {SECONDS - FALL_S:g} s that are left.",
    "At the other end: believed while wrong, at the place that looks the same but for the colours of goals and poles.",
    "The paper tells no numbers: it could still localize the robot reliably, and won.",
)


Games = Mapping[tuple[str, str], Sequence[Track]]  # by robot and system


def schulz_games(seeds: int) -> ExperimentResult:
    """Fifty games of five seeds, each case plays the same ones."""
    games = gathered(_played, seed_range(seeds, GAMES), "games")
    waited = _waited_s(games["as built", OURS])
    return ExperimentResult(
        "Section 6.3 of Schulz and Behnke 2012: games of two against two, with a fall",
        COLUMNS,
        [(*name, *_cells(each)) for name, each in games.items()],
        Headline(
            "robot as built: right again after a fall, median; 90 %; within the game",
            "reliably",
            f"{np.median(waited):.1f} s; {_quantile(waited)} s; {np.isfinite(waited).sum()} of {len(waited)}",
        ),
        _NOTES,
        (("waits", _figure(open_field(FIELD), games)),),
    )


def _played(number: int) -> dict[tuple[str, str], Track]:
    """One game of every case."""
    walks = {robot: game(robot, number) for robot in dict.fromkeys(CASES.values())}
    games = {}
    for (name, system), robot in CASES.items():
        forget_s = FALL_S if name == _TOLD else math.inf
        games[name, system] = tracked(walks[robot], number, humanoids.settings(system), forget_s=forget_s)
    return games


def game(robot: humanoids.Robot, number: int) -> Drive:
    """One game; the number is its seed."""
    field, rng = open_field(FIELD), np.random.default_rng([number, 26])
    places = [_unfavourable(field, rng) for _ in range(5)]
    side = float(rng.choice((-1.0, 1.0)))
    entry = (round(float(rng.uniform(-0.45, 0.45)) * field.length, 2), round(side * 0.5 * field.width, 2), -90.0 * side)
    changes = (
        f"motion.waypoints={[list(place) for place in places]}",
        f"disturbances.kidnap_every_s={FALL_S:g}",
        f"disturbances.covered_images={round(DOWN_S * _RATE_HZ)}",
        f"disturbances.kidnap_to={[list(entry)]}",
    )
    return walk(FIELD, robot, number, SECONDS, changes)


def _unfavourable(field: FieldModel, rng: np.random.Generator) -> tuple[float, float, float]:
    """A place at a side line, in a corner, or anywhere."""
    half_x, half_y = 0.5 * field.length - _INSIDE_M, 0.5 * field.width - _INSIDE_M
    x, y = float(rng.uniform(-half_x, half_x)), float(rng.uniform(-half_y, half_y))
    kind = int(rng.integers(3))
    if kind < 2:
        y = math.copysign(half_y, y)
    if kind == 1:
        x = math.copysign(half_x, x)
    return round(x, 2), round(y, 2), 0.0


def _waited_s(games: Sequence[Track]) -> FloatArray:
    """(G,) seconds until the pose was right again after the fall; inf: never."""
    return np.array([humanoids.time_until_right(track, FALL_S) for track in games])


def _cells(tracks: Sequence[Track]) -> Row:
    waited = _waited_s(tracks)
    wrong = [t.tracking & ~right_of(t) for t in tracks]
    twins = [float(np.mean(w & right_of(humanoids.either_end(t)))) for w, t in zip(wrong, tracks, strict=True)]
    return (
        percent([humanoids.believed(t.part(t.times_s < FALL_S - DOWN_S)) for t in tracks]),
        f"{np.median(waited):.1f}",
        _quantile(waited),
        f"{np.max(waited[np.isfinite(waited)], initial=0.0):.1f}",
        f"{np.isinf(waited).sum()} of {len(waited)}",
        percent([float(np.mean(w)) for w in wrong]),
        percent(twins),
    )


def _quantile(waited_s: FloatArray) -> str:
    value = float(np.quantile(waited_s, 0.9, method="higher"))
    return f"{value:.1f}" if math.isfinite(value) else "–"


def _figure(field: FieldModel, games: Games) -> Figure:
    """One game from above; beside it which share of the robots is right again after so long."""
    figure, (above, curve) = new_figure(1, 2, (10.0, 3.8))
    track = games["as built", OURS][0]
    field_axes(above, field, beyond_m=0.6)
    before, after = track.part(track.times_s < FALL_S), track.part(track.times_s >= FALL_S)
    way(above, before.truth, "black")
    way(above, after.truth, "black", label="truth")
    for part, tint, label in ((before, BLUE, "until the fall"), (after, MAGENTA, "after it")):
        dots(above, part.poses, tint, 3, marker=".", label=label)
    above.legend(frameon=False, fontsize=8, loc="upper left")
    for name, each in games.items():
        waited = np.sort(_waited_s(each))
        shares = 100.0 * np.arange(1, len(waited) + 1) / len(waited)
        kept = np.isfinite(waited)
        curve.step(waited[kept], shares[kept], where="post", label=", ".join(name))
    curve.set(xlabel="time since the first image (s)", ylabel="right again (%)", ylim=(0.0, 101.0))
    curve.legend(frameon=False, fontsize=7, loc="lower right")
    return figure
