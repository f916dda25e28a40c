"""The time that a step takes, perception and localization apart."""

import time
from collections.abc import Callable
from typing import ParamSpec, TypeVar

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


class Stopwatch:
    """Runs from the beginning of a step; what perception takes is counted by itself."""

    def __init__(self) -> None:
        self._started_s = time.perf_counter()
        self.perception_ms = 0.0

    def perception(self, see: Callable[Arguments, Result], *args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        """The result of a call that belongs to perception."""
        before_s = time.perf_counter()
        result = see(*args, **kwargs)
        self.perception_ms += 1e3 * (time.perf_counter() - before_s)
        return result

    @property
    def localization_ms(self) -> float:
        """Everything so far but perception."""
        return 1e3 * (time.perf_counter() - self._started_s) - self.perception_ms
