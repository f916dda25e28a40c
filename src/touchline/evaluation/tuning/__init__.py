"""Searching settings over recordings or scenarios."""

from touchline.evaluation.tuning.search import Search, tune
from touchline.evaluation.tuning.space import Dimension, dimension_from_text
from touchline.evaluation.tuning.trial import Score, Task, Trial, score_of, tasks_on

__all__ = [
    "Dimension",
    "Score",
    "Search",
    "Task",
    "Trial",
    "dimension_from_text",
    "score_of",
    "tasks_on",
    "tune",
]
