"""report.html: one self-contained page about a run, readable on a phone, by day and by night."""

import base64
import html
import io
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np

from touchline.config import leaves
from touchline.evaluation.latency import milliseconds
from touchline.evaluation.metrics import COLUMNS, ErrorStatistics, ErrorTable
from touchline.evaluation.protection import stanford_diagram
from touchline.evaluation.run_data import RunData
from touchline.evaluation.run_folder import REPORT
from touchline.evaluation.runner import Thumbnail, said_text
from touchline.evaluation.summary import RunSummary
from touchline.evaluation.timeline import (
    MODE_COLORS,
    dot_colors,
    error_charts,
    latency_tree,
    page_data,
    run_tree,
    shown_rows,
    truth_tree,
)
from touchline.evaluation.tum import pose_text
from touchline.evaluation.web_page import html_page, time_panel
from touchline.files.new import replace_file
from touchline.geometry import Pose
from touchline.messages import counted
from touchline.types import ImageArray, Status

_JPEG_QUALITY = 82


@dataclass(frozen=True, eq=False, slots=True)
class Picture:
    """An image (H, W, 3) BGR of the report with what it shows."""

    title: str
    caption: str
    image: ImageArray


def write_report(
    folder: Path,
    summary: RunSummary,
    data: RunData,
    errors: ErrorTable | None,
    pictures: Iterable[Picture] = (),
    thumbnails: Sequence[Thumbnail] = (),
) -> Path:
    """Write report.html into the folder of a run; Returns its path.

    thumbnails: small pictures of images throughout the run, that the slider shows.

    Raises TouchlineError if it cannot be written.
    """
    shows_time = bool(len(data.table))
    sections = [
        _header(summary),
        _key_figures(summary, errors, data),
        _time_section(data, bool(thumbnails)) if shows_time else "",
        _error_table(errors, summary, data),
        _protection(data),
        _latency(data, summary),
        _gallery(pictures),
        _said(summary),
        _problems(summary),
        _settings(summary),
        _footer(summary),
    ]
    title = f"{summary.recording.name} · {summary.system} · Touchline"
    page = html_page(title, sections, _page_data(data, thumbnails, summary) if shows_time else None)
    path = folder / REPORT
    replace_file(path, page.encode(errors="replace"))  # a name may be no UTF-8
    return path


def _header(summary: RunSummary) -> str:
    recording, name = summary.recording, html.escape(summary.recording.name)
    ended = {
        "complete": "",
        "interrupted": "The run was interrupted; this is what was done until then.",
        "failed": f"The run failed: {summary.failure}. This is what was done until then.",
    }[summary.ended]
    notes = "".join(f'<p class="warning">{html.escape(text)}</p>' for text in (ended, other_side_text(summary)) if text)
    facts = [
        f"system <strong>{html.escape(summary.system)}</strong>",
        f"field {html.escape(recording.field)}",
        f"{counted(summary.frames, 'image')} in {summary.duration_s:.1f} s",
        html.escape(summary.started[:16].replace("T", " ")),
    ]
    description = html.escape(recording.description)
    return (
        f"<header><p class='brand'>Touchline</p><h1>{name}</h1><p class='facts'>{' · '.join(facts)}</p>"
        f"<p class='description'>{description}</p>{notes}</header>"
    )


def other_side_text(summary: RunSummary) -> str:
    """That the side of the field is unknown, how sure it is, and what to do; empty if it is known."""
    found, prior = summary.either_side, summary.prior
    if not found.count or found.other_pose is None:
        return ""
    pose, twin = pose_text(Pose(*found.other_pose)), found.probability
    images = f"in {found.count} of {counted(summary.frames, 'image')}"
    if prior.pose is None and not prior.own_half:
        sure = "" if twin is None else f"; there with {100 * twin:.0f} %"
        return (
            f"{images} the robot may as well stand at the other end of the field (the other: at last {pose}{sure}); "
            "--own-half or --start tells which"
        )
    sure = "" if twin is None else f"{100 * twin:.0f} %, "
    return (
        f"undecided which end of the field it is: {images} nothing but the start that was told speaks against the "
        f"other end (the other: {sure}at last {pose})"
    )


def _page_data(data: RunData, thumbnails: Sequence[Thumbnail], summary: RunSummary) -> str:
    rows = shown_rows(data)
    spent_ms = (data.table.perception_ms + data.table.localization_ms).astype(np.float64)
    truth = truth_tree(data, rows)
    runs = [run_tree("estimate", data, rows), *([] if truth is None else [truth])]
    times = latency_tree(spent_ms, summary.latency_ms)
    return page_data(data, error_charts(data, rows), runs, rows, thumbnails, times)


def _key_figures(summary: RunSummary, errors: ErrorTable | None, data: RunData) -> str:
    tiles: list[tuple[str, str, str]] = _kidnap_tiles(data)
    tracked = data.tracked_errors()
    if errors is not None:
        x, y, heading, position = (
            (errors.x, errors.y, errors.heading, errors.position)
            if tracked is None
            else (tracked["x"], tracked["y"], tracked["heading"], tracked["position"])
        )
        which = "" if tracked is None else ", tracked"
        tiles += [
            (f"mean |x|{which}", f"{100 * x.mean:.2f}", "cm"),
            (f"mean |y|{which}", f"{100 * y.mean:.2f}", "cm"),
            (f"mean |heading|{which}", f"{math.degrees(heading.mean):.2f}", "°"),
            (f"largest position error{which}", f"{100 * position.max:.1f}", "cm"),
        ]
    frames = summary.frames
    if frames:
        tiles.append(("images tracked", f"{100 * summary.status['tracking'] / frames:.1f}", "%"))
    for label, values in (("of the pose", data.table.probability), ("of its twin", data.table.twin_probability)):
        if not np.isnan(values).all():
            tiles.append((f"probability {label}, median", f"{100 * np.nanmedian(values):.1f}", "%"))
    latency, left_out = summary.latency_ms.total, summary.latency_ms.first_left_out
    if latency.median is not None and latency.p99 is not None:
        which = f", first {left_out} left out" if left_out else ""
        tiles.append((f"time per image, median{which}", milliseconds(latency.median), "ms"))
        tiles.append((f"time per image, p99{which}", milliseconds(latency.p99), "ms"))
    cells = "".join(
        f"<div class='tile'><dt>{label}</dt><dd>{value}<span>{'' if unit == '°' else ' '}{unit}</span></dd></div>"
        for label, value, unit in tiles
    )
    return f"<dl class='tiles'>{cells}</dl>"


def _kidnap_tiles(data: RunData) -> list[tuple[str, str, str]]:
    """Where the robot was carried and the truth is known: how soon it was right again, how long wrong unnoticed."""
    recoveries = data.recoveries_s()
    if not recoveries:
        return []
    found = sorted(time_s for time_s in recoveries if time_s is not None)
    tiles = [("right again after a kidnap", f"{len(found)} of {len(recoveries)}", "")]
    if found:
        tiles.append(("recovery time, median", f"{found[len(found) // 2]:.2f}", "s"))
        tiles.append(("recovery time, longest", f"{found[-1]:.2f}", "s"))
    wrong = data.wrong_while_tracking()
    if wrong is not None:
        tiles.append((f"wrong while tracking ({counted(wrong.frames, 'image')})", f"{wrong.seconds:.2f}", "s"))
    return tiles


def _error_table(errors: ErrorTable | None, summary: RunSummary, data: RunData) -> str:
    if errors is None:
        why = summary.why_no_errors
        return f"<section><h2>Errors</h2><p>{html.escape(why[:1].upper() + why[1:])}.</p></section>"
    head = "".join(f"<th>{title}</th>" for title in COLUMNS)
    printed = [*tracked_rows(data.tracked_errors()), *errors.rows()]
    rows = "".join(
        f"<tr><th>{name}</th>{''.join(f'<td>{value}</td>' for value in values)}</tr>" for name, values in printed
    )
    note = "std e is of the signed error, std |e| of its size."
    return (
        f"<section><h2>Errors</h2><div class='scroll'><table class='errors'><thead><tr><th></th>{head}</tr></thead>"
        f"<tbody>{rows}</tbody></table></div><p class='note'>{'. '.join(errors.notes())}. {note}</p></section>"
    )


def tracked_rows(tracked: dict[str, ErrorStatistics] | None) -> list[tuple[str, list[str]]]:
    """Rows of the tracked images alone, which come first; none where they are all that count."""
    if tracked is None:
        return []
    named = (("x", 100.0, 2, "cm"), ("y", 100.0, 2, "cm"), ("heading", math.degrees(1.0), 3, "°"))
    return [
        (f"{name}, tracked ({unit})", [f"{scale * value:.{digits}f}" for value in asdict(tracked[name]).values()])
        for name, scale, digits, unit in named
    ]


def _time_section(data: RunData, has_images: bool) -> str:
    """The path, the image and the curves, all at the time of one slider."""
    if data.first_located < len(data.table):
        by = "mode: which sensors it comes from" if data.table.has_modes else "status of its estimate"
        caption = f"Each dot is one image since the robot was first located, coloured by the {by}."
    elif data.truth is not None:
        caption = "The truth alone: the robot was never located."
    else:
        caption = "The robot was never located."
    return time_panel(path_key(data), has_images, _of_the_curves(data), caption)


def path_key(data: RunData) -> list[tuple[str, str]]:
    """What the picture of the path shows, in words, each with the stylesheet's name of its colour."""
    labels = {color: mode.value for mode, color in MODE_COLORS.items()} | {
        status.value: status.value for status in Status
    }
    shown = set(dot_colors(data).tolist())
    key = [("truth", "truth")] if data.truth is not None else []
    key += [(label, color) for color, label in labels.items() if color in shown]
    return key + ([("first located", "first-located")] if data.first_located < len(data.table) else [])


def _of_the_curves(data: RunData) -> str:
    said = "Residual: mean distance of points or features from the field's."
    if data.errors_since_located() is not None:
        sigma = "Shaded about zero: ± 2σ as the system states it."
        said = f"Estimate minus truth, in the field frame, since the robot was first located. {sigma} {said}"
        said += " Grey: black images, which do not count." if data.black_ns else ""
    if data.said:
        said += " Orange: what the system said while it ran, at its time."
    if data.table.statistics:
        said += " Consistency: how far sensors and field contradict each other; from 1 on it is an alarm."
    return said


def _protection(data: RunData) -> str:
    """The Stanford diagram, where the truth and protection levels are known."""
    bounded = data.bounded_errors()
    if bounded is None:
        return ""
    drawn = io.BytesIO()
    stanford_diagram(*bounded)[0].savefig(drawn, dpi=110, format="png", metadata={"Software": None})
    image = f"<img alt='Stanford diagram: error against protection level' src='{_source('png', drawn.getvalue())}'>"
    caption = "Shade: how many images; dots: single images whose error is larger than their protection level."
    figure = f"<figure class='histogram'>{image}<figcaption>{caption}</figcaption></figure>"
    return f"<section><h2>Protection level</h2>{figure}</section>"


def _source(kind: str, data: bytes) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"


def _latency(data: RunData, summary: RunSummary) -> str:
    if not len(data.table):
        return ""
    caption = "Perception and localization together, without reading and decoding. "
    caption += _of_the_start(summary.latency_ms.first_left_out, summary.learns_colours)
    drawing = "<div id='histogram' role='img' aria-label='Histogram of the time per frame'></div>"
    figure = f"<figure class='histogram'>{drawing}<figcaption>{caption}</figcaption></figure>"
    return f"<section><h2>Latency</h2>{figure}</section>"


def _of_the_start(left_out: int, learns_colours: bool) -> str:
    why = f"compiled code is loaded{' and the colours are learned' if learns_colours else ''}"
    if left_out:
        return f"Median and p99 leave out the first {left_out} images (grey), in which {why}."
    return f"The first images take longest: {why}."


def _gallery(pictures: Iterable[Picture]) -> str:
    items = []
    for picture in pictures:
        done, code = cv2.imencode(".jpg", picture.image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
        if not done:
            continue
        items.append(
            f"<figure><img alt='{html.escape(picture.title)}' loading='lazy' src='{_source('jpeg', code.tobytes())}'>"
            f"<figcaption><strong>{html.escape(picture.title)}</strong> {html.escape(picture.caption)}</figcaption>"
            "</figure>"
        )
    return f"<section><h2>Images</h2><div class='gallery'>{''.join(items)}</div></section>" if items else ""


def _problems(summary: RunSummary) -> str:
    problems = summary.problems
    if not problems.counts:
        return "<section><h2>Problems of the recording</h2><p>None were found while reading it.</p></section>"
    counts = "".join(f"<li>{count} × {html.escape(kind)}</li>" for kind, count in problems.counts.items())
    lines = "".join(f"<li>{html.escape(message)}</li>" for message in problems.messages)
    return (
        f"<section><h2>Problems of the recording</h2><ul>{counts}</ul>"
        f"<details><summary>The first {len(problems.messages)}</summary><ol class='small'>{lines}</ol></details>"
        "</section>"
    )


def _said(summary: RunSummary) -> str:
    """What the system said while it ran; nothing where it said nothing."""
    if not summary.said:
        return ""
    lines = "".join(f"<li>{html.escape(said_text(one))}</li>" for one in summary.said)
    return f"<section><h2>What the system said</h2><ol class='small'>{lines}</ol></section>"


def _settings(summary: RunSummary) -> str:
    rows = "".join(
        f"<tr><th>{html.escape(key)}</th><td>{html.escape(str(value))}</td></tr>"
        for key, value in leaves(summary.settings).items()
    )
    table = f"<div class='scroll'><table>{rows}</table></div>"
    return f"<section><h2>Settings</h2><details><summary>All of this run</summary>{table}</details></section>"


def _footer(summary: RunSummary) -> str:
    versions = " · ".join(f"{html.escape(name)} {html.escape(v)}" for name, v in summary.versions.items())
    return f"<footer>seed {summary.seed} · {html.escape(summary.cpu)} · {versions}</footer>"
