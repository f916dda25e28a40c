"""`touchline check`: everything that is odd about a recording or its calibration, before a match finds out."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table
from rich.text import Text

from touchline.cli.console import plain_table, print_json, say, steps_shown, wide_output
from touchline.cli.options import BagBase, BagCamera, BagField, BagLate, FollowLinks, Topics, bag_options
from touchline.messages import counted

if TYPE_CHECKING:
    from touchline.checks.findings import Finding

_STYLES = {"ok": "green", "note": "cyan", "warning": "yellow", "error": "bold red"}


def check(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", help="A recording, or a bag.")],
    json: Annotated[bool, typer.Option("--json", help="Print the findings as JSON.")] = False,
    follow_links: FollowLinks = False,
    topics: Topics = None,
    field: BagField = None,
    camera: BagCamera = None,
    base: BagBase = None,
    late: BagLate = 0.0,
) -> None:
    """Read a whole recording and say what is odd about it, and what to do.

    Exit status 0: nothing worse than warnings. 1: errors, which will spoil the localization. 2: it can't be read.
    """
    from touchline.checks.check import check_recording, steps
    from touchline.checks.findings import Severity
    from touchline.sources import open_source

    source = open_source(recording, follow_links, bag_options(topics, field, camera, base, late))
    with steps_shown("reading", steps(source)) as advance:
        findings = check_recording(source, advance)
    counts = {severity.value: sum(finding.severity is severity for finding in findings) for severity in Severity}
    worst_first = tuple(reversed(counts.items()))
    if json:
        print_json({"recording": source.name, "counts": counts, "findings": [asdict(one) for one in findings]})
    else:
        wide_output().print(_table(findings), soft_wrap=False)
        words = ", ".join(f"{count} ok" if name == "ok" else counted(count, name) for name, count in worst_first)
        say(f"{source.name}: {counted(len(source), 'image')}, {words}")
    if counts["error"]:
        raise typer.Exit(1)


def _table(findings: list[Finding]) -> Table:
    rows = []
    for finding in findings:
        severity = Text(finding.severity.value, style=_STYLES[finding.severity.value])
        rows.append((severity, Text(finding.where), Text(finding.what), Text(finding.advice)))
    titles = "severity", "where", "what", "what to do"
    table = plain_table(*titles, rows=rows, numbers_from=None, overflow="fold")
    table.columns[0].no_wrap = True
    return table
