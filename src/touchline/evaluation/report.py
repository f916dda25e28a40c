"""report.html: one self-contained page about a run, readable on a phone, by day and by night."""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2

from touchline.evaluation.figures import RunData, error_figure, field_figure, latency_figure, path_key, status_figure
from touchline.evaluation.latency import milliseconds
from touchline.evaluation.metrics import COLUMNS, ErrorTable
from touchline.evaluation.run_folder import REPORT
from touchline.evaluation.tum import pose_text
from touchline.geometry import Pose
from touchline.messages import counted
from touchline.new_files import replace_file
from touchline.types import ImageArray

_JPEG_QUALITY = 82


@dataclass(frozen=True, eq=False, slots=True)
class Picture:
    """An image (H, W, 3) BGR of the report with what it shows."""

    title: str
    caption: str
    image: ImageArray


def write_report(
    folder: Path,
    summary: dict[str, Any],
    data: RunData,
    errors: ErrorTable | None,
    pictures: Sequence[Picture] = (),
) -> Path:
    """Write report.html into the folder of a run; summary is what summary.json holds. Returns its path.

    Raises TouchlineError if it cannot be written.
    """
    sections = [
        _header(summary),
        _key_figures(summary, errors),
        _error_table(errors, summary),
        *_path_figures(data),
        *_time_figures(data, summary),
        _gallery(pictures),
        _problems(summary),
        _settings(summary),
        _footer(summary),
    ]
    title = html.escape(f"{summary['recording']['name']} · {summary['system']} · Touchline")
    page = (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{title}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n<main>\n"
        + "\n".join(section for section in sections if section)
        + "\n</main>\n</body>\n</html>\n"
    )
    path = folder / REPORT
    replace_file(path, page.encode(errors="replace"))  # a name may be no UTF-8
    return path


def _header(summary: dict[str, Any]) -> str:
    recording, name = summary["recording"], html.escape(summary["recording"]["name"])
    told = {
        "complete": "",
        "interrupted": "The run was interrupted; this is what was done until then.",
        "failed": f"The run failed: {summary.get('failure')}. This is what was done until then.",
    }[summary["ended"]]
    notes = "".join(f'<p class="warning">{html.escape(text)}</p>' for text in (told, other_side_text(summary)) if text)
    facts = [
        f"system <strong>{html.escape(summary['system'])}</strong>",
        f"field {html.escape(str(recording['field']))}",
        f"{counted(summary['frames'], 'image')} in {summary['duration_s']:.1f} s",
        html.escape(str(summary["started"])[:16].replace("T", " ")),
    ]
    description = html.escape(str(recording.get("description") or ""))
    return (
        f"<header><p class='brand'>Touchline</p><h1>{name}</h1><p class='facts'>{' · '.join(facts)}</p>"
        f"<p class='description'>{description}</p>{notes}</header>"
    )


def other_side_text(summary: dict[str, Any]) -> str:
    """That the side of the field is unknown, and what to do; empty if it is known."""
    told = summary["either_side"]
    if not told["count"]:
        return ""
    pose = pose_text(Pose(*told["other_pose"]))
    return (
        f"no compass: in {told['count']} of {counted(summary['frames'], 'image')} the pose at the other end "
        f"fits as well (at last {pose}); use --own-half or --start"
    )


def _key_figures(summary: dict[str, Any], errors: ErrorTable | None) -> str:
    tiles: list[tuple[str, str, str]] = []
    if errors is not None:
        tiles += [
            ("mean |x|", f"{100 * errors.x.mean:.2f}", "cm"),
            ("mean |y|", f"{100 * errors.y.mean:.2f}", "cm"),
            ("mean |heading|", f"{math.degrees(errors.heading.mean):.2f}", "°"),
            ("largest position error", f"{100 * errors.position.max:.1f}", "cm"),
        ]
    frames = summary["frames"]
    if frames:
        tiles.append(("images tracked", f"{100 * summary['status']['tracking'] / frames:.1f}", "%"))
    latency, left_out = summary["latency_ms"]["total"], summary["latency_ms"]["first_left_out"]
    if latency["median"] is not None:
        which = f", first {left_out} left out" if left_out else ""
        tiles.append((f"time per image, median{which}", milliseconds(latency["median"]), "ms"))
        tiles.append((f"time per image, p99{which}", milliseconds(latency["p99"]), "ms"))
    if summary["rate_fps"] is not None:
        tiles.append(("rate, reading included", f"{summary['rate_fps']:.0f}", "images/s"))
    cells = "".join(
        f"<div class='tile'><dt>{label}</dt><dd>{value}<span>{'' if unit == '°' else ' '}{unit}</span></dd></div>"
        for label, value, unit in tiles
    )
    return f"<dl class='tiles'>{cells}</dl>"


def _error_table(errors: ErrorTable | None, summary: dict[str, Any]) -> str:
    if errors is None:
        why = summary["why_no_errors"]
        return f"<section><h2>Errors</h2><p>{html.escape(why[:1].upper() + why[1:])}.</p></section>"
    head = "".join(f"<th>{title}</th>" for title in COLUMNS)
    rows = "".join(
        f"<tr><th>{name}</th>{''.join(f'<td>{value}</td>' for value in values)}</tr>" for name, values in errors.rows()
    )
    note = "std e is of the signed error, std |e| of its size."
    return (
        f"<section><h2>Errors</h2><div class='scroll'><table class='errors'><thead><tr><th></th>{head}</tr></thead>"
        f"<tbody>{rows}</tbody></table></div><p class='note'>{errors.left_out()}. {note}</p></section>"
    )


def _figure(title: str, svg: str, caption: str) -> str:
    drawing = f"<div class='scroll'>{svg}</div><figcaption>{caption}</figcaption>"
    return f"<section><h2>{title}</h2><figure>{drawing}</figure></section>"


def _path_figures(data: RunData) -> list[str]:
    """The path and the errors, from the first located estimate on."""
    located = data.first_located < len(data.table)
    figures = []
    if located:
        by = "mode: which sensors it comes from" if data.table.has_modes else "status of its estimate"
        caption = f"Each dot is one image since the robot was first located, coloured by the {by}."
        figures.append(_figure("Path", field_figure(data), _key(data) + caption))
    elif data.truth is not None and len(data.table):
        caption = "The truth alone: the robot was never located."
        figures.append(_figure("Path", field_figure(data), _key(data) + caption))
    if data.errors_since_located() is not None:
        caption = "Estimate minus truth, in the field frame, since the robot was first located."
        caption += " Shaded: black images." if data.black_ns else ""
        figures.append(_figure("Error over time", error_figure(data), caption))
    return figures


def _key(data: RunData) -> str:
    """The legend of the path, as text of the page: it breaks into lines where a narrow screen needs it."""
    names = (f"<span><i class='key {color}'></i>{html.escape(label)}</span>" for label, color in path_key(data))
    return f"<span class='keys'>{' '.join(names)}</span>"


def _time_figures(data: RunData, summary: dict[str, Any]) -> list[str]:
    if not len(data.table):
        return []
    return [
        _figure(
            "Status over time",
            status_figure(data),
            "<span class='key tracking'></span>tracking <span class='key searching'></span>searching "
            "<span class='key lost'></span>lost. Residual: mean distance of points or features from the field's.",
        ),
        _figure(
            "Latency",
            latency_figure(data, summary["latency_ms"]),
            "Perception and localization together, without reading and decoding. "
            + _of_the_start(summary["latency_ms"]["first_left_out"], summary["learns_colours"]),
        ),
    ]


def _of_the_start(left_out: int, learns_colours: bool) -> str:
    why = f"compiled code is loaded{' and the colours are learned' if learns_colours else ''}"
    if left_out:
        return f"Median and p99 leave out the first {left_out} images (grey), in which {why}."
    return f"The first images take longest: {why}."


def _gallery(pictures: Sequence[Picture]) -> str:
    if not pictures:
        return ""
    items = []
    for picture in pictures:
        done, code = cv2.imencode(".jpg", picture.image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
        if not done:
            continue
        source = "data:image/jpeg;base64," + base64.b64encode(code.tobytes()).decode("ascii")
        items.append(
            f"<figure><img alt='{html.escape(picture.title)}' loading='lazy' src='{source}'>"
            f"<figcaption><strong>{html.escape(picture.title)}</strong> {html.escape(picture.caption)}</figcaption>"
            "</figure>"
        )
    return f"<section><h2>Images</h2><div class='gallery'>{''.join(items)}</div></section>"


def _problems(summary: dict[str, Any]) -> str:
    problems = summary["problems"]
    if not problems["counts"]:
        return "<section><h2>Problems of the recording</h2><p>None were found while reading it.</p></section>"
    counts = "".join(f"<li>{count} × {html.escape(kind)}</li>" for kind, count in problems["counts"].items())
    lines = "".join(f"<li>{html.escape(message)}</li>" for message in problems["messages"])
    return (
        f"<section><h2>Problems of the recording</h2><ul>{counts}</ul>"
        f"<details><summary>The first {len(problems['messages'])}</summary><ol class='small'>{lines}</ol></details>"
        "</section>"
    )


def _settings(summary: dict[str, Any]) -> str:
    rows = "".join(
        f"<tr><th>{html.escape(key)}</th><td>{html.escape(str(value))}</td></tr>"
        for key, value in _leaves(summary["settings"])
    )
    table = f"<div class='scroll'><table>{rows}</table></div>"
    return f"<section><h2>Settings</h2><details><summary>All of this run</summary>{table}</details></section>"


def _leaves(tree: dict[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    leaves: list[tuple[str, Any]] = []
    for key, value in tree.items():
        if isinstance(value, dict):
            leaves += _leaves(value, f"{prefix}{key}.")
        else:
            leaves.append((f"{prefix}{key}", value))
    return leaves


def _footer(summary: dict[str, Any]) -> str:
    versions = " · ".join(f"{html.escape(name)} {html.escape(str(v))}" for name, v in summary["versions"].items())
    return f"<footer>seed {summary['seed']} · {html.escape(str(summary['cpu']))} · {versions}</footer>"


_STYLE = """
:root { color-scheme: light dark;
  --page:#fbfbf9; --card:#ffffff; --ink:#1d2320; --soft:#66706b; --grid:#e3e6e2; --line:#e3e6e2;
  --carpet:#e4efe2; --paint:#ffffff; --truth:#8f9a92; --tracking:#0b6e99; --searching:#5b2e91; --lost:#c8324a;
  --bar:#4f7d6b; --series-x:#0b6e99; --series-y:#9a5b00; --series-heading:#00796b; --warn:#fff2d6;
  --omnivision:#0b6e99; --both:#00a39b; --odometry:#c2269b; }
@media (prefers-color-scheme: dark) { :root {
  --page:#141816; --card:#1b201e; --ink:#e8ece9; --soft:#98a39d; --grid:#2c3330; --line:#2c3330;
  --carpet:#1f3a2a; --paint:#c9d8cc; --truth:#7d8a82; --tracking:#4fb6e3; --searching:#d0b3f7; --lost:#f2697d;
  --bar:#6fae96; --series-x:#4fb6e3; --series-y:#e0a04a; --series-heading:#4fc9b5; --warn:#3a2f14;
  --omnivision:#4fb6e3; --both:#3fd0c4; --odometry:#f07fd0; } }
* { box-sizing:border-box; }
body { margin:0; background:var(--page); color:var(--ink);
  font:16px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,"Helvetica Neue",Arial,sans-serif; }
main { max-width:60rem; margin:0 auto; padding:2rem 1rem 3rem; }
.brand { margin:0; color:var(--soft); font-size:.8rem; letter-spacing:.12em; text-transform:uppercase; }
h1 { margin:.1rem 0 .2rem; font-size:1.9rem; line-height:1.2; font-weight:650; overflow-wrap:anywhere; }
h2 { margin:0 0 .6rem; font-size:1.05rem; font-weight:600; }
.facts { margin:0; color:var(--soft); } .facts strong { color:var(--ink); font-weight:600; }
.description { margin:.5rem 0 0; max-width:46rem; }
.warning { background:var(--warn); padding:.6rem .9rem; border-radius:.5rem; }
section, .tile { background:var(--card); border:1px solid var(--line); border-radius:.7rem; }
section { margin-top:1rem; padding:1.1rem 1.2rem; }
.tiles { display:grid; grid-template-columns:repeat(auto-fit,minmax(min(45%,13rem),1fr)); gap:.7rem;
  margin:1.4rem 0 0; }
.tile { padding:.7rem .9rem; }
.tile dt { color:var(--soft); font-size:.82rem; }
.tile dd { margin:0; font-size:1.6rem; font-weight:600; font-variant-numeric:tabular-nums; }
.tile dd span { font-size:.9rem; font-weight:400; color:var(--soft); }
.scroll { overflow-x:auto; }
table { border-collapse:collapse; width:100%; font-size:.92rem; font-variant-numeric:tabular-nums; }
th, td { padding:.35rem .7rem; border-bottom:1px solid var(--line); text-align:left; font-weight:400; }
.errors th, .errors td { white-space:nowrap; }
.errors td, .errors thead th { text-align:right; }
thead th { color:var(--soft); font-size:.82rem; }
tbody tr:last-child > * { border-bottom:0; }
.note, figcaption { margin:.6rem 0 0; color:var(--soft); font-size:.85rem; }
figure { margin:0; }
figure svg { display:block; width:100%; min-width:30rem; height:auto; }
svg * { stroke-linejoin:round; stroke-linecap:butt; }
.gallery { display:grid; grid-template-columns:repeat(auto-fit,minmax(min(100%,25rem),1fr)); gap:1rem; }
.gallery img { display:block; width:100%; height:auto; border-radius:.4rem; background:#181818; }
.gallery figcaption strong { color:var(--ink); font-weight:600; }
@media (max-width:34rem) { section { padding:.9rem .8rem; } th, td { padding:.35rem .3rem; font-size:.85rem; }
  figure svg { min-width:26rem; } }
.key { display:inline-block; width:.7em; height:.7em; border-radius:50%; margin:0 .3em 0 .5em; }
.key.tracking { background:var(--tracking); margin-left:0; } .key.searching { background:var(--searching); }
.key.lost { background:var(--lost); } .key.truth { background:var(--truth); opacity:.5; }
.key.omnivision { background:var(--omnivision); } .key.both { background:var(--both); }
.key.odometry { background:var(--odometry); } .key.first-located { border:1.5px solid var(--ink); }
.keys { display:flex; flex-wrap:wrap; gap:.1rem 1.1rem; margin-bottom:.4rem; color:var(--ink); }
.keys > span { white-space:nowrap; } .keys .key { margin-left:0; }
summary { cursor:pointer; } details[open] summary { margin-bottom:.5rem; }
ul, ol { margin:.2rem 0; padding-left:1.4rem; } .small { font-size:.88rem; }
footer { margin-top:1.4rem; color:var(--soft); font-size:.8rem; }
"""
"""The stylesheet; the figures take their colours from its variables."""
