"""Draws leaderboard and plots of docs/benchmark.md from the files of results in docs/benchmark, and nothing else.

python docs/images/benchmark.py
"""

from __future__ import annotations

from pathlib import Path

from touchline_lab.bench.leaderboard import (
    cm,
    number,
    percent,
    place_cells,
    places,
    rows_of,
    systems_of,
)
from touchline_lab.bench.runs import Scored, by_row, read_results
from touchline_lab.bench.scoring import row_figures
from touchline_lab.bench.suite import TRACKS, open_suite
from touchline_lab.experiments.scenes import new_figure, robot_dots

DOCS = Path(__file__).parents[1]
BEGIN, END = "<!-- drawn from the files of results -->", "<!-- end of what is drawn -->"


def main() -> None:
    """Replace what stands between the marks."""
    heads, found, suite = [], list[Scored](), open_suite("touchline-bench-1")
    for path in sorted((DOCS / "benchmark").glob("*.jsonl")):
        head, scored = read_results(path)
        heads.append((path.name, head))
        found += scored
    table = by_row(found, suite)
    lines = []
    for track in TRACKS:
        lines += [f"### {track}", "", "| system | cost (cm) | update (loops) |", "|---|---|---|"]
        listed = places(suite, table, track)
        lines += [f"| {p.system} | {cells[0]} | {cells[1]} |" for p in listed for cells in [place_cells(p)]]
        missing = [name for name in systems_of(table) if name not in {place.system for place in listed}]
        lines += [f"| {name} | n/a | – |" for name in missing]
        names = [place.system for place in listed]
        lines += ["", f"![{track}](images/benchmark-{track}.png)", "", "First in each row, and touchline:", ""]
        lines += ["| row | robots | first: cost (cm) | touchline: cost | median, 95 % | tracked (%) | wrong/h |",
                  "|---|---|---|---|---|---|---|"]  # fmt: skip
        for row in rows_of(suite, track):
            figures = {name: row_figures(table[row.name, name]) for name in names if (row.name, name) in table}
            if "touchline" not in figures:
                continue
            first = min(figures, key=lambda name: figures[name]["cost_m"].value)
            own = figures["touchline"]
            errors = f"{number(100.0 * own['median_m'].value, 1)}, {number(100.0 * own['p95_m'].value, 1)}"
            wrong = f"{own['wrong_per_hour'].value:.1f} (< {own['wrong_per_hour'].high:.0f})"
            cells = (f"{row.condition}, {row.field}", str(len(table[row.name, "touchline"])),
                     f"{first}: {cm(figures[first]['cost_m'])}", cm(own["cost_m"]), errors,
                     percent(own["available"].value), wrong)  # fmt: skip
            lines.append("| " + " | ".join(cells) + " |")
        lines.append("")
        draw(track, names, table, suite)
    lines += [f"{name}: commit {head['commit']}, {head['machine']}, {head['versions']}." for name, head in heads]
    page = DOCS / "benchmark.md"
    before, _, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    page.write_text("\n".join([before + BEGIN, "", *lines, "", END + rest.partition(END)[2]]), encoding="utf-8")


def draw(track: str, names: list[str], table: dict, suite: object) -> None:  # type: ignore[type-arg]
    """Every drive's cost, a dot for each robot, by row and system."""
    rows = rows_of(suite, track)  # type: ignore[arg-type]
    figure, (axis,) = new_figure(1, 1, (7.2, 0.5 + 0.42 * len(rows)), (f"{track}: cost of an image (cm)",))
    for n, name in enumerate(names):
        for k, row in enumerate(rows):
            costs = [100.0 * one.cost_m for one in table.get((row.name, name), ())]
            robot_dots(axis, costs, k + 0.07 * (n - 0.5 * len(names)), f"C{n}", name if k == 0 else None)
    axis.set(xscale="log", ylim=(len(rows) - 0.5, -0.5))
    axis.set_yticks(range(len(rows)), [f"{row.condition} ({row.field})" for row in rows], fontsize=7)
    axis.legend(frameon=False, fontsize=6, ncols=3, loc="upper center", bbox_to_anchor=(0.4, -0.08))
    figure.savefig(DOCS / "images" / f"benchmark-{track}.png", dpi=110)


if __name__ == "__main__":
    main()
