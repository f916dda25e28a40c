"""Hypotheses of where a robot is, weighed by log-odds: those that are worth being followed."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Protocol, TypeVar


class Weighed(Protocol):
    """A hypothesis. log_odds: against the likeliest."""

    log_odds: float


Hypothesis = TypeVar("Hypothesis", bound=Weighed)


def settled(
    hypotheses: Iterable[Hypothesis], most: int, unlikely: float, are_same: Callable[[Hypothesis, Hypothesis], bool]
) -> list[Hypothesis]:
    """The likeliest ones, at most so many: without those less likely than the first by log-odds of `unlikely`, and one
    of those that have come together. The log-odds of the first are 0 then: only differences count.
    """
    kept: list[Hypothesis] = []
    for one in sorted(hypotheses, key=lambda each: -each.log_odds):
        hopeless = bool(kept) and one.log_odds < kept[0].log_odds - unlikely
        if len(kept) < most and not hopeless and not any(are_same(one, other) for other in kept):
            kept.append(one)
    top = kept[0].log_odds if kept else 0.0
    for one in kept:
        one.log_odds -= top
    return kept
