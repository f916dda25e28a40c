"""Where an image's time goes, as a flame graph (SVG): widths are shares of the time of `system.step`.

    python lab/benchmarks/flame.py RECORDING OUTPUT.svg [--system NAME] [--passes N]

A signal every millisecond notes which functions are being called; a compiled loop is part of who calls it. The first
pass, in which code is loaded, and the first images, from which colours are learned, are left out.
"""

from __future__ import annotations

import argparse
import signal
from collections import Counter
from html import escape
from pathlib import Path
from types import FrameType
from typing import Any

from touchline.api import prepare

_EVERY_S = 1e-3
_WIDTH, _ROW, _CHARACTER, _MIN_PX = 1200.0, 17, 6.2, 3.0  # px
_LEARNING = 10  # images at the start that are not looked at


def sampled(recording: Path, system: str, passes: int) -> Counter[tuple[str, ...]]:
    """How often each stack of functions below a step was met."""
    stacks: Counter[tuple[str, ...]] = Counter()
    looking = False

    def note(_: int, frame: FrameType | None) -> None:
        names: list[str] = []
        while looking and frame is not None and frame.f_code is not sampled.__code__:
            names.append(f"{Path(frame.f_code.co_filename).stem}.{frame.f_code.co_qualname.rsplit('.', 1)[-1]}")
            frame = frame.f_back
        stacks[tuple(reversed(names))] += 1

    signal.signal(signal.SIGALRM, note)
    signal.setitimer(signal.ITIMER_REAL, _EVERY_S, _EVERY_S)
    for number in range(passes + 1):
        prepared = prepare(recording, system)
        for index, image in enumerate(prepared.source):
            looking = number > 0 and index >= _LEARNING
            prepared.system.step(image)
            looking = False
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    return Counter({stack: count for stack, count in stacks.items() if stack and stack[0].endswith(".step")})


def drawn(stacks: Counter[tuple[str, ...]], title: str) -> str:
    """The picture: the callers at the top, each function below who called it, siblings by their names."""
    total, boxes, depth = stacks.total(), list[str](), 0

    def place(part: dict[tuple[str, ...], int], left: float, level: int) -> None:
        nonlocal depth
        depth = max(depth, level)
        for name in sorted({stack[0] for stack in part if stack}):
            below = {stack[1:]: count for stack, count in part.items() if stack and stack[0] == name}
            count = sum(below.values())
            width = _WIDTH * count / total
            if width >= _MIN_PX:
                boxes.append(_box(name, left, level, width, 100.0 * count / total))
                place(below, left, level + 1)
            left += width

    place(dict(stacks), 0.0, 1)
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH:.0f} {_ROW * (depth + 1)}" '
    text = f'<text x="4" y="{_ROW - 5}">{escape(title)}</text>'
    return f'{head}font-family="sans-serif" font-size="11">\n{text}\n' + "\n".join(boxes) + "\n</svg>\n"


def _box(name: str, left: float, level: int, width: float, percent: float) -> str:
    hue = 10 + sum(map(ord, name.split(".")[0])) * 7 % 45  # a file's functions share a colour
    shown = name if _CHARACTER * len(name) < width else name.rsplit(".", 1)[-1]
    text = f'<text x="{left + 3:.1f}" y="{_ROW * (level + 1) - 5}">{escape(shown)}</text>'
    box = f'<rect x="{left:.1f}" y="{_ROW * level}" width="{max(width - 0.5, 0.5):.1f}" height="{_ROW - 1}" '
    tip = f"<title>{escape(name)}: {percent:.1f} %</title>"
    return f'{box}fill="hsl({hue},80%,68%)">{tip}</rect>{text if _CHARACTER * len(shown) < width else ""}'


def main() -> None:
    """Write one picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    parser.add_argument("output", type=Path)
    parser.add_argument("--system", default="touchline")
    parser.add_argument("--passes", type=int, default=10)
    given: Any = parser.parse_args()
    stacks = sampled(given.recording, given.system, given.passes)
    title = f"{given.recording.name}, {given.system}: {stacks.total()} samples of the step"
    given.output.write_text(drawn(stacks, title), encoding="utf-8")


if __name__ == "__main__":
    main()
