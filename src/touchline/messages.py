"""Words that messages share: counts, lists of frames, the nearest known name."""

import difflib
import re
import reprlib
from collections.abc import Sequence

_REPR = reprlib.Repr()
_REPR.maxlevel, _REPR.maxstring, _REPR.maxlong, _REPR.maxother = 2, 60, 40, 60


def did_you_mean(word: str, known: Sequence[str], alike: float = 0.5) -> str:
    """A sentence that names the nearest known words, or all of them. alike: share of letters that has to agree."""
    near = difflib.get_close_matches(word[:200], known, n=1, cutoff=alike)
    return f"did you mean '{near[0]}'?" if near else f"known: {', '.join(sorted(known))}"


def shown(value: object) -> str:
    """A value of a file as a message quotes it: of a long one only the beginning."""
    return _REPR.repr(value)


def unexpected(error: BaseException) -> str:
    """An error that no code expects; of a compiled loop's file that was cut off, with what helps."""
    cut = type(error).__name__ in ("UnpicklingError", "EOFError")
    advice = "; if of a compiled loop, delete the files *.nbi and *.nbc beside the package" if cut else ""
    return f"{type(error).__name__}: {error}{advice}"


def listed(words: Sequence[str]) -> str:
    """`a`, `a and b`, `a, b and c`."""
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def without_numbers(text: str) -> str:
    """A message with its numbers left out: that of another frame may differ in them alone."""
    return re.sub(r"\d+(\.\d+)?", "…", text)


def counted(count: int, noun: str) -> str:
    """`1 image`, `2 images`."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def length_unit(number: float, longest_m: float) -> str:
    """The unit in which a number that is too large for metres is a length of up to longest_m."""
    return "centimetres" if number <= 100.0 * longest_m else "millimetres"


def frames_in_words(frames: list[int], shown: int = 6) -> str:
    """`frame 3`, `frames 3, 4, 9 and 12 more`."""
    if len(frames) == 1:
        return f"frame {frames[0]}"
    words = ", ".join(str(frame) for frame in frames[:shown])
    return f"frames {words}" + (f" and {len(frames) - shown} more" if len(frames) > shown else "")
