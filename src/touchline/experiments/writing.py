"""Results in files: a page and pictures per experiment, and one page with a row for each."""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from pathlib import Path

from touchline.errors import InputError
from touchline.experiments.harness import ExperimentResult
from touchline.files.new import replace_file
from touchline.files.opened import read_text

PAGE = "results.md"
_MAX_BYTES = 10_000_000
_HEAD = (
    "# Results of the experiments",
    "",
    "Written by `touchline experiment`; every run replaces its row.",
    "",
    "| experiment | what | the paper | ours | seeds |",
    "|---|---|---|---|---:|",
)


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
    page = folder / f"{result.name}.md"
    replace_file(page, result_page(result, [path.name for path in pictures]).encode())
    replace_file(summary, with_row(before, result, order).encode())
    return [page, *pictures, summary]


def result_page(result: ExperimentResult, pictures: Iterable[str]) -> str:
    """The experiment's own page, Markdown."""
    lines = [f"# {result.name}", "", f"{result.title}. {result.seeds} seeds; ± is their standard deviation.", ""]
    lines += [_row(result.columns), "|---" * len(result.columns) + "|", *(_row(row) for row in result.rows), ""]
    lines += [line for note in result.notes for line in (note, "")]
    lines += [line for name in pictures for line in (f"![{result.name}]({name})", "")]
    return "\n".join(lines)


def with_row(page: str, result: ExperimentResult, order: Sequence[str] = ()) -> str:
    """The results page with this experiment's row added, or replaced if it has one."""
    rows = {_name(line): line for line in page.splitlines() if line.startswith("| [")}
    h = result.headline
    rows[result.name] = _row((f"[{result.name}]({result.name}.md)", h.what, h.paper, h.ours, str(result.seeds)))
    known = [name for name in order if name in rows]
    names = known + [name for name in rows if name not in known]
    return "\n".join((*_HEAD, *(rows[name] for name in names), ""))


def _row(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _name(line: str) -> str:
    return line[len("| [") :].partition("]")[0]
