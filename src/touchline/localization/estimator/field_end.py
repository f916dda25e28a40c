"""At which end of a symmetric field the robot is, as log-odds of the pose against its twin.

One belief with four sources: the prior that was given, the compass, the colours of goals and poles, and the evidence
of others.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from touchline.geometry import Pose, wrap_angle
from touchline.localization.estimator.compass_fault import CompassFaultFilter, CompassStates, supports
from touchline.localization.registration.feature_model import FeatureModel, FeatureView
from touchline.types import Evidence, Problem, ProblemCode

# log-odds of an end that the operator gave: one start in 150 is given wrongly. A smaller prior costs where nothing else
# distinguishes the ends, a larger one where it is wrong: colours and compass need an image or a second more against it
PRIOR_LOG_ODDS = 5.0
MIDDLE_M = 0.5  # within it of the middle line the half says less: a pose has errors, and the referee is late
MAX_COLOUR_GAIN = 4.0  # of one image: what is taken for a post may be somebody in its colour
MAX_COLOUR_LOG_ODDS = 12.0  # so that a belief of minutes is given up within four images against it
MEMORY_S = 2.0  # time over which others have to repeat their evidence, so that a moment's fault counts little
FORGET_S = 10.0  # after which evidence that is not repeated has lost most of its weight
MAX_OF_SOURCE = 7.0  # log-odds of one of the others, however sure it says it is: more than an operator's, so that two
MAX_OF_UNKNOWN = 3.0  # known ones correct a wrong start; of all who are unknown together: less than any start
MAX_SOURCES = 50
FIRST_SHARE = 0.25  # of a source's first evidence that counts at once
REFUTED = -2.0  # log-odds from which the twin is taken
CLEAR = 3.0  # log-odds, without the prior, from which the end is confirmed
JUMP_IMAGES = 2  # after a jump, in which a compass that turns round has turned with it
COMPASS, COLOURS = "the compass", "the colours of goals and poles"
_REFUTED_BY = {COMPASS: ProblemCode.END_BY_COMPASS, COLOURS: ProblemCode.END_BY_COLOURS}
UNDECIDED_S = 10.0  # after which it is reported, and reported again, that nothing distinguishes the ends


class OwnHalf:
    """That the robot was in its own half at some time; whoever has crossed the middle line since was in it, too."""

    def __init__(self) -> None:
        self._moved = Pose(0.0, 0.0, 0.0)

    def predict(self, moved: Pose) -> None:
        """Move by the odometry, robot frame before it."""
        self._moved = self._moved.compose(moved)

    def log_odds(self, pose: Pose) -> float:
        """Of a pose now, against its twin."""
        x = pose.compose(self._moved.inverse()).x
        return PRIOR_LOG_ODDS * min(max(-x / MIDDLE_M, -1.0), 1.0)


class EndMemory(NamedTuple):
    """What was known of the end of the field at some time."""

    prior_log_odds: float
    colours: float
    compass: CompassStates
    undecided: bool


class FieldEnd:
    """Whether the pose is at its end or its twin is. symmetric: whether the field's lines leave that open.

    `undecided`: a jump has left it open, and neither end is clearly likelier yet. `colours_tell`: whether those of
    goals and poles differ.
    """

    def __init__(self, symmetric: bool, model: FeatureModel, colours_tell: bool) -> None:
        self.symmetric, self._model = symmetric, model
        self.colours_tell = symmetric and colours_tell
        self.compass = CompassFaultFilter()
        self.reset()

    def reset(self, known: bool = False) -> None:
        """Nothing is known, or the operator has given the end."""
        self._forget(known)
        self.compass.reset()
        self._open_s, self._reported = 0.0, False
        self._heading_rad = 0.0  # of the pose, when the compass was last compared

    def _forget(self, known: bool) -> None:
        self.prior_log_odds = PRIOR_LOG_ODDS if known else 0.0
        self.colours = 0.0
        self._said: dict[str, float] = {}
        self._silent_s: dict[str, float] = {}
        self._known: set[str] = set()
        self._jumping = 0
        self._support: int | None = None
        self.undecided = False

    def begin(self, known: bool, compass_error_rad: float | None) -> None:
        """A pose was found anew: the prior and the compass reading at that image."""
        self._forget(known)
        self.compass.begin(compass_error_rad)
        self._support = supports(compass_error_rad)

    @property
    def is_open(self) -> bool:
        """Whether neither end is clearly likelier."""
        return self.symmetric and abs(self.log_odds) < -REFUTED

    def take_prior(self, log_odds: float, was_open: bool = False) -> None:
        """Take the log-odds of the pose against its twin by what happened to the robot. Undecided where none is likely
        enough, unless the end was open before: who was tracked so, its twin named, is so again.
        """
        self.prior_log_odds = log_odds
        self.undecided = self.is_open and not was_open

    def add_half(self, pose: Pose, own_half: bool) -> None:
        """A robot that is tracked stays where it is, in its own half where that is likelier."""
        half = OwnHalf().log_odds(pose) if own_half else 0.0
        self.take_prior(min(max(self.prior_log_odds + half, -PRIOR_LOG_ODDS), PRIOR_LOG_ODDS))

    @property
    def memory(self) -> EndMemory:
        """What is known now."""
        return EndMemory(self.prior_log_odds, self.colours, self.compass.states, self.undecided)

    def recall(self, memory: EndMemory) -> None:
        """Know what was known then."""
        self.prior_log_odds, self.colours, self.compass.states, self.undecided = memory
        self._jumping = 0

    def leave_open(self) -> None:
        """Nothing is known of the end until something tells; a compass that is known to have failed does not."""
        self._forget(False)
        self.compass.forget_end()
        self.undecided = True

    def jumped(self) -> None:
        """The pose has just jumped, as by a shove. One that was carried to near its twin's place looks just so; but its
        compass, which agreed until then, turns round.
        """
        self._jumping = JUMP_IMAGES if self._support == 1 else 0

    def update_from_compass(self, compass_error_rad: float | None, seconds: float, heading_rad: float = 0.0) -> None:
        """Take the compass's difference from the pose's heading (rad); None: no reading."""
        knows = self.log_odds - self.compass.log_odds > -REFUTED  # without the compass
        turned_rad = abs(wrap_angle(heading_rad - self._heading_rad)) if knows else 0.0
        self._heading_rad = heading_rad
        self._support = supports(compass_error_rad)
        if self._jumping and self._support == -1 and self.log_odds > -REFUTED:
            self._forget(False)
            self.compass.doubt()
            self._support, self.undecided = -1, True
        else:
            self.compass.update(compass_error_rad, seconds, turned_rad)
        self._jumping = max(self._jumping - 1, 0)
        self.undecided = self.undecided and abs(self.log_odds) < -REFUTED

    def update_from_colours(self, view: FeatureView, pose: Pose) -> None:
        """Compare a pose and its twin by the features of an image; lines and crossings are alike for both."""
        if not self.colours_tell or view.size == 0:
            return
        here, there = self._model.log_likelihoods(view, np.array([pose, pose.mirrored()]))
        gain = min(max(float(here - there), -MAX_COLOUR_GAIN), MAX_COLOUR_GAIN)
        self.colours = min(max(self.colours + gain, -MAX_COLOUR_LOG_ODDS), MAX_COLOUR_LOG_ODDS)

    def update_from_team(self, evidence: Sequence[Evidence], pose: Pose, seconds: float) -> None:
        """Take the evidence of others. Each source counts once, however often it repeats itself: it errs as one."""
        self._silent_s = {source: silent_s + seconds for source, silent_s in self._silent_s.items()}
        for one in evidence:
            gain = one.log_likelihood(pose) - one.log_likelihood(pose.mirrored())
            gain = min(max(gain, -MAX_OF_SOURCE), MAX_OF_SOURCE)
            if one.source not in self._said and len(self._said) >= MAX_SOURCES:
                self._forget_source(one.known)
            if one.source not in self._said and len(self._said) >= MAX_SOURCES:
                continue
            if one.known:
                self._known.add(one.source)
            before, silent_s = self._said.get(one.source, 0.0), self._silent_s.get(one.source, FIRST_SHARE * MEMORY_S)
            self._said[one.source] = before + (gain - before) * min(silent_s / MEMORY_S, 1.0)
            self._silent_s[one.source] = 0.0

    def _forget_source(self, known: bool) -> None:
        """Make room: of who is unknown, the one that has been silent for longest; of who is known only for another."""
        unknown = [source for source in self._said if source not in self._known]
        silent = max(unknown, key=lambda source: self._silent_s[source], default=None)
        if silent is not None and (known or self._silent_s[silent] > FORGET_S):
            del self._said[silent], self._silent_s[silent]

    def swap_ends(self) -> None:
        """The twin is the pose from now on; the prior was wrong."""
        self.prior_log_odds, self.colours = 0.0, -self.colours
        self._support = None if self._support is None else -self._support
        self.compass.swap_ends()
        self._said = {source: -gain for source, gain in self._said.items()}

    @property
    def others(self) -> dict[str, float]:
        """Of the pose, against its twin, by what each of the others says; what is not repeated is forgotten."""
        return {source: gain * math.exp(-self._silent_s[source] / FORGET_S) for source, gain in self._said.items()}

    @property
    def evidence_log_odds(self) -> float:
        """Of the pose, against its twin, by all but the prior."""
        if not self._said:
            return self.colours + self.compass.log_odds
        others = self.others
        known = sum(gain for source, gain in others.items() if source in self._known)
        unknown = sum(gain for source, gain in others.items() if source not in self._known)
        return self.colours + self.compass.log_odds + known + min(max(unknown, -MAX_OF_UNKNOWN), MAX_OF_UNKNOWN)

    @property
    def log_odds(self) -> float:
        """Of the pose, against its twin."""
        return self.prior_log_odds + self.evidence_log_odds

    @property
    def probability(self) -> float:
        """Of the pose, against its twin."""
        return 1.0 / (1.0 + math.exp(-self.log_odds)) if self.symmetric else 1.0

    @property
    def is_refuted(self) -> bool:
        """Whether the twin is the pose."""
        return self.symmetric and self.log_odds <= REFUTED

    def is_decided(self, min_probability: float) -> bool:
        """Whether a pose may be tracked: no jump has left its end open, and colours, if they differ, decide it."""
        if not self.symmetric:
            return True
        return not self.undecided and (not self.colours_tell or self.probability >= min_probability)

    @property
    def refutation(self) -> Problem:
        """The sources against the pose, the one that weighs most first; the code identifies that one."""
        sources = {COMPASS: self.compass.log_odds, COLOURS: self.colours, **self.others}
        against = [source for source in sorted(sources, key=lambda one: sources[one]) if sources[source] < 0.0]
        code = _REFUTED_BY.get(next(iter(against), ""), ProblemCode.END_BY_OTHERS)
        return Problem(code, f"{' and '.join(against)}: the robot is at the other end of the field")

    def report_undecided(self, seconds: float) -> tuple[Problem, ...]:
        """Report the twin now and then while nothing seen or heard distinguishes it from a tracked pose."""
        if not self.symmetric or self.evidence_log_odds >= CLEAR:
            return ()
        self._open_s += seconds
        if self._open_s < UNDECIDED_S and (self._reported or self.colours_tell):
            return ()
        self._open_s, self._reported = 0.0, True
        twin = 100.0 * (1.0 - self.probability)
        why = "as starts are given wrongly; nothing seen or heard tells" if self.prior_log_odds else "as nothing tells"
        sentence = f"undecided which end of the field it is: the other end has {twin:.1f} %, {why}"
        return (Problem(ProblemCode.END_UNDECIDED, sentence),)
