"""`touchline check`: everything that is odd about a recording or its calibration, before a match finds out."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from touchline.cli.options import BagBase, BagCamera, BagField, BagLate, FollowLinks, Topics, bag_options

if TYPE_CHECKING:
    from rich.table import Table

    from touchline.checks.findings import Finding
    from touchline.sources import Recording

_STYLES = {"ok": "green", "note": "cyan", "warning": "yellow", "error": "bold red"}
_PIPE_WIDTH = 400


def check(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", help="A recording, or a bag.", show_default=False)],
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
    from touchline.checks.findings import Severity
    from touchline.cli.console import output
    from touchline.messages import counted
    from touchline.sources import open_source

    source = open_source(recording, follow_links, bag_options(topics, field, camera, base, late))
    findings = _check_with_progress(source)
    counts = {severity.value: sum(finding.severity is severity for finding in findings) for severity in Severity}
    worst_first = tuple(reversed(counts.items()))
    console = output()
    if json:
        typer.echo(_as_json(source.name, findings, counts))
    else:
        if not console.is_terminal:
            console.width = _PIPE_WIDTH  # one line for each finding, for grep
        console.print(_table(findings), soft_wrap=False)
        words = ", ".join(f"{count} ok" if name == "ok" else counted(count, name) for name, count in worst_first)
        console.print(f"{source.name}: {counted(len(source), 'image')}, {words}", markup=False)
    if counts["error"]:
        raise typer.Exit(1)


def _check_with_progress(source: Recording) -> list[Finding]:
    from rich.progress import Progress

    from touchline.checks.check import check_recording
    from touchline.cli.console import errors_console

    console = errors_console()
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("reading", total=len(source))
        return check_recording(source, lambda: progress.advance(task))


def _table(findings: list[Finding]) -> Table:
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, header_style="dim", pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column("severity", no_wrap=True)
    table.add_column("where", overflow="fold")
    table.add_column("what", overflow="fold")
    table.add_column("what to do", overflow="fold")
    for finding in findings:
        severity = Text(finding.severity.value, style=_STYLES[finding.severity.value])
        table.add_row(severity, Text(finding.where), Text(finding.what), Text(finding.advice))
    return table


def _as_json(name: str, findings: list[Finding], counts: dict[str, int]) -> str:
    import json
    from dataclasses import asdict

    tree = {"recording": name, "counts": counts, "findings": [asdict(finding) for finding in findings]}
    return json.dumps(tree, indent=2, ensure_ascii=False)
