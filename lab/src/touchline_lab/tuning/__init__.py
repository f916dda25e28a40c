"""Searching settings over recordings or scenarios."""

from touchline_lab.tuning.search import Search, tune
from touchline_lab.tuning.trial import Dimension, Score, Task, Trial, dimension_from_text, score_of, tasks_on

__all__ = ["Dimension", "Score", "Search", "Task", "Trial", "dimension_from_text", "score_of", "tasks_on", "tune"]
