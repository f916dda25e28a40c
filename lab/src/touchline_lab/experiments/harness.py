"""One harness under all experiments: runs by whatever workers there are, the figures' spread, table, pictures, page.

An experiment measures (conditions x systems x robots, `gathered`), writes a table of it (`spread`, `interval`, `rate`)
and draws it (scenes.py); what it hands back is an `ExperimentResult`, of which `write_result` makes a page.
"""

import io
import json
import os
import platform
import re
import subprocess
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar, Token
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import cv2
import numpy as np
from matplotlib.figure import Figure

import touchline
from touchline.errors import InputError
from touchline.evaluation.latency import cpu_name
from touchline.evaluation.workers import Workers
from touchline.files.new import replace_file
from touchline.files.opened import read_text
from touchline.geometry import FloatArray
from touchline.types import ImageArray
from touchline_lab.statistics import over_robots

Item = TypeVar("Item")
Key = TypeVar("Key")
Result = TypeVar("Result")
Listener = Callable[[str], None]
Row = tuple[str, ...]
NONE = "–"
_LISTENER: ContextVar[Listener | None] = ContextVar("listener", default=None)
NOTHING = "(?!)"  # a regular expression that matches nothing


class Kept(NamedTuple):
    """A file of results as they come; part: which tasks are run, by a regular expression for what begins them."""

    path: Path
    part: str = ""


_KEPT: ContextVar[Kept | None] = ContextVar("kept", default=None)
_FIRST_SEED: ContextVar[int] = ContextVar("first seed", default=0)
_WORKERS: ContextVar[Workers] = ContextVar("workers", default=Workers())  # noqa: B039  # frozen
PAGE = "results.md"
_MAX_BYTES = 10_000_000
_MAX_KEPT = 500_000_000
_HEAD = (
    "# Results of the experiments",
    "",
    "Written by `touchline experiment`; every run replaces its row.",
    "",
    "| experiment | what | the paper | ours | seeds |",
    "|---|---|---|---|---:|",
)


@contextmanager
def progress_to(
    listener: Listener | None, workers: Workers | None = None, kept: Kept | None = None, first_seed: int = 0
) -> Iterator[None]:
    """Within it, `listener` is told of every step of `follow` and `computed`, as a short line of text.

    workers: who computes what is `computed`; None: this process. kept: where results that are `resumed` stand.
    first_seed: where `seed_range` begins.
    """
    before: list[tuple[ContextVar[Any], Token[Any]]] = [
        (_LISTENER, _LISTENER.set(listener)),
        (_WORKERS, _WORKERS.set(workers or Workers())),
        (_KEPT, _KEPT.set(kept)),
        (_FIRST_SEED, _FIRST_SEED.set(first_seed)),
    ]
    try:
        yield
    finally:
        for variable, token in before:
            variable.reset(token)


def about() -> dict[str, Any]:
    """By what results are measured: commit, versions, machine."""
    import scipy

    versions = {"touchline": touchline.__version__, "python": platform.python_version()}
    versions |= {"numpy": np.__version__, "scipy": scipy.__version__}
    return {"commit": commit(), "versions": versions, "machine": f"{cpu_name()}, {os.cpu_count()} cores"}


def commit() -> str:
    """Of the source tree that this runs from; empty for an installed package."""
    root = Path(__file__).parents[4]
    if not (root / ".git").exists():
        return ""
    try:
        command = ["git", "rev-parse", "--short=12", "HEAD"]
        return subprocess.run(command, cwd=root, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return ""


def seed_range(seeds: int, each: int = 1) -> range:
    """Seeds of so many runs, or of so many for each, from the first one on that was asked for."""
    first = _FIRST_SEED.get()
    return range(each * first, each * (first + seeds))


def follow(items: Sequence[Item], what: str) -> Iterator[Item]:
    """The items one by one; before each the listener is told which of how many it is."""
    for number, item in enumerate(items, start=1):
        tell(f"{what}, {number} of {len(items)}")
        yield item


def computed(function: Callable[[Item], Result], items: Sequence[Item], what: str) -> Iterator[Result]:
    """What a function of a module makes of each item, in their order, by whatever workers there are.

    Each result depends on its item alone. The listener is told which of how many is waited for.
    """
    results = _WORKERS.get().map(function, items)
    for number in range(1, len(items) + 1):
        tell(f"{what}, {number} of {len(items)}")
        yield next(results)


def resumed(function: Callable[[Item], Result], items: Sequence[Item], what: str) -> list[Any]:
    """`computed` of items and results that JSON knows. Where a file is kept each result is written to it at once, and
    what it holds by this commit is not computed again; of a part, and with NOTHING, all that it holds comes back, by
    any commit with NOTHING. Raises InputError for a file that is none.
    """
    kept = _KEPT.get()
    if kept is None:
        return list(computed(function, items, what))
    whole = _whole_lines(kept.path, _MAX_KEPT)
    try:
        lines = [json.loads(line) for line in whole.splitlines()]
        by = commit()
        held = {
            json.dumps(line["of"]): line["found"] for line in lines
            if kept.part == NOTHING or line.get("commit", "") == by
        }  # fmt: skip
    except (ValueError, TypeError, KeyError):
        raise InputError(f"{kept.path}: is no file of results; choose another folder") from None
    left = [item for item in items if json.dumps(item) not in held and re.search(kept.part, str(item))]
    tell(f"{what}: {len(held)} were done before, {len(left)} are left")
    replace_file(kept.path, whole.encode())
    with kept.path.open("a", encoding="utf-8") as file:
        for item, found in zip(left, computed(function, left, what), strict=True):
            file.write(json.dumps({"of": item, "found": found, "commit": by}) + "\n")
            file.flush()
            held[json.dumps(item)] = found
    if not held:
        raise InputError(f"{kept.path}: holds no results; run the experiment without --draw, or another --part")
    asked = [held.pop(json.dumps(item)) for item in items if json.dumps(item) in held]
    return [*asked, *held.values()] if kept.part else asked


RUNS = "runs.jsonl"  # in a folder of results: which experiments are done, by what, and how long each took


class Done(NamedTuple):
    """An experiment that is done: its seeds, how long they took, and of how many minutes they were all that fit."""

    seeds: range
    minutes: float
    budget: float | None = None

    def is_enough(self, seeds: range, budget: float | None) -> bool:
        """For these seeds, or as many of them as fit so many minutes."""
        fits = budget is not None and self.budget is not None and self.budget >= budget
        return self.seeds == seeds or (fits and self.seeds.start == seeds.start)


def newest_done(folder: Path, name: str) -> Done | None:
    """What a folder's page of an experiment is of, if by this commit; else None. Raises InputError for other files."""
    path, by = folder / RUNS, about()
    try:
        lines = [json.loads(line) for line in _whole_lines(path).splitlines()]
        newest = {one["name"]: one for one in lines}.get(name)
        if newest is None or not by["commit"] or not (folder / f"{name}.md").is_file():
            return None
        if (newest["commit"], newest["versions"]) != (by["commit"], by["versions"]):
            return None
        return Done(range(*newest["seeds"]), float(newest["minutes"]), newest.get("budget"))
    except (ValueError, TypeError, KeyError):
        raise InputError(f"{path}: is no list of runs; choose another folder") from None


def note_done(folder: Path, name: str, done: Done) -> None:
    """Add an experiment that is done."""
    of = {"minutes": round(done.minutes, 3), "budget": done.budget}
    row = {"name": name, "seeds": [done.seeds.start, done.seeds.stop], **of, **about()}
    replace_file(folder / RUNS, f"{_whole_lines(folder / RUNS)}{json.dumps(row)}\n".encode())


def _whole_lines(path: Path, max_bytes: int = _MAX_BYTES) -> str:
    """What a file holds, "" where there is none; a last line that was cut off is left out."""
    text = read_text(path, max_bytes) if path.exists() else ""
    return text[: text.rfind("\n") + 1]


def together(results: Iterable[Mapping[Key, Result]]) -> dict[Key, list[Result]]:
    """Results by their keys (a condition, a system): of every key those of all robots."""
    found: dict[Key, list[Result]] = {}
    for each in results:
        for key, result in each.items():
            found.setdefault(key, []).append(result)
    return found


def gathered(one: Callable[[Item], Mapping[Key, Result]], items: Sequence[Item], what: str) -> dict[Key, list[Result]]:
    """`computed`, and `together`."""
    return together(computed(one, items, what))


def tell(progress: str) -> None:
    """Say how far it has come, if anybody listens."""
    listener = _LISTENER.get()
    if listener is not None:
        listener(progress)


@dataclass(frozen=True, slots=True)
class Headline:
    """The one row of the results page: what was measured, the paper's figure, ours."""

    what: str
    paper: str
    ours: str


@dataclass(frozen=True, eq=False, slots=True)
class ExperimentResult:
    """Result of an experiment over `seeds` seeds; `Experiment.run` tells its name, and which they are.

    columns, rows: the table, as text; numbers are means over the seeds, ± is their standard deviation. notes: whole
    sentences on what was simulated and counted. pictures: by name, without ending. overlays: images (H, W, 3), B, G,
    R, by name, for the run's folder alone.
    """

    title: str
    columns: Row
    rows: Sequence[Row]
    headline: Headline
    notes: Sequence[str] = ()
    pictures: Sequence[tuple[str, Figure]] = ()
    name: str = ""
    seeds: int = 0
    first_seed: int = 0
    overlays: Sequence[tuple[str, ImageArray]] = ()


def spread(values: Sequence[float] | FloatArray, decimals: int = 2) -> str:
    """Mean ± standard deviation over the seeds (of N - 1); a lone value stands alone, a dash for none."""
    numbers = np.asarray(values, dtype=np.float64)
    if len(numbers) == 0:
        return NONE
    if len(numbers) == 1:
        return f"{numbers[0]:.{decimals}f}"
    return f"{numbers.mean():.{decimals}f} ± {numbers.std(ddof=1):.{decimals}f}"


def percent(values: Sequence[float] | FloatArray) -> str:
    """`spread` of shares, in per cent."""
    shares = np.asarray(values, dtype=np.float64)
    return f"{spread(100.0 * shares, 1)} %" if len(shares) else NONE


def share_text(share: float) -> str:
    """One share in per cent; a dash for NaN."""
    return NONE if np.isnan(share) else f"{100.0 * share:.1f} %"


def interval(values: Sequence[float] | FloatArray, decimals: int = 2) -> str:
    """Mean over robots and, in brackets, where it lies with 95 %: by bootstrap, robots drawn anew with replacement."""
    if len(values) < 2:
        return spread(values, decimals)
    mean, low, high = over_robots(values, np.mean)
    return f"{mean:.{decimals}f} [{low:.{decimals}f}, {high:.{decimals}f}]"


def rate(successes: int, tries: int) -> str:
    """A share in per cent with Wilson's 95 % interval of a binomial one; a dash for no tries."""
    if tries == 0:
        return NONE
    low, high = wilson(successes, tries)
    return f"{100.0 * successes / tries:.1f} % [{100.0 * low:.1f}, {100.0 * high:.1f}]"


def paper_cells(published: Sequence[float] | None, cell: Callable[[Result, str], str], *forms: Result) -> list[str]:
    """Of x, y and heading what a paper says, and the figure of each form (cell(form, name)); of the position theirs."""
    known = [NONE] * 3 if published is None else [f"{value:g}" for value in published]
    papers = {"x": [known[0]], "y": [known[1]], "heading": [known[2]], "position": []}
    return [text for name, paper in papers.items() for text in (*paper, *(cell(form, name) for form in forms))]


def wilson(successes: int, tries: int) -> tuple[float, float]:
    """Bounds of a binomial share with 95 % (Wilson, 1927)."""
    from scipy.stats import binomtest

    found = binomtest(successes, tries).proportion_ci(method="wilson")
    return float(found.low), float(found.high)


def check_writable(folder: Path) -> None:
    """Make the folder, before an experiment takes its time. Raises InputError if it can't be made."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror}); choose another with --output") from None


def write_result(result: ExperimentResult, folder: Path, order: Sequence[str] = ()) -> list[Path]:
    """Write NAME.md, its pictures (PNG) and the experiment's row of results.md into a folder; returns the files.

    order: names in the order that the rows of the page shall have. Raises TouchlineError for what can't be written.
    """
    check_writable(folder)
    summary = folder / PAGE
    before = read_text(summary, _MAX_BYTES) if summary.exists() else ""
    pictures = [folder / f"{result.name}-{name}.png" for name, _ in result.pictures]
    for path, (_, figure) in zip(pictures, result.pictures, strict=True):
        drawn = io.BytesIO()
        figure.savefig(drawn, dpi=130, format="png", metadata={"Software": None})
        replace_file(path, drawn.getvalue())
    for name, image in result.overlays:
        check_writable(folder / result.name)
        replace_file(folder / result.name / f"{name}.png", cv2.imencode(".png", image)[1].tobytes())
    page = folder / f"{result.name}.md"
    replace_file(page, result_page(result, [path.name for path in pictures]).encode())
    replace_file(summary, with_row(before, result, order).encode())
    return [page, *pictures, summary]


def result_page(result: ExperimentResult, pictures: Iterable[str]) -> str:
    """The experiment's own page, Markdown."""
    spread = f" {result.seeds} seeds; ± is their standard deviation." if result.seeds > 1 else ""
    lines = [f"# {result.name}", "", f"{result.title}.{spread}", ""]
    lines += [_row(result.columns), "|---" * len(result.columns) + "|", *(_row(row) for row in result.rows), ""]
    lines += [line for note in result.notes for line in (note, "")]
    lines += [line for name in pictures for line in (f"![{result.name}]({name})", "")]
    return "\n".join(lines)


def with_row(page: str, result: ExperimentResult, order: Sequence[str] = ()) -> str:
    """The results page with this experiment's row added, or replaced if it has one."""
    rows = {line[len("| [") :].partition("]")[0]: line for line in page.splitlines() if line.startswith("| [")}
    h, seeds = result.headline, f"{result.seeds}" + (f" from {result.first_seed}" if result.first_seed else "")
    rows[result.name] = _row((f"[{result.name}]({result.name}.md)", h.what, h.paper, h.ours, seeds))
    known = [name for name in order if name in rows]
    names = known + [name for name in rows if name not in known]
    return "\n".join((*_HEAD, *(rows[name] for name in names), ""))


def _row(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
