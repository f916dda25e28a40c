"""report.html: one self-contained page about a run, readable on a phone, by day and by night."""

import base64
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from touchline.config import leaves
from touchline.evaluation.latency import milliseconds
from touchline.evaluation.metrics import COLUMNS, ErrorTable
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
from touchline.evaluation.web_page import html_page
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
    page = html_page(
        "report.html.jinja",
        _page_data(data, thumbnails, summary) if len(data.table) else None,
        title=f"{summary.recording.name} · {summary.system}",
        summary=summary,
        recording=summary.recording,
        run=data,
        errors=errors,
        other_side=other_side_text(summary),
        tiles=_key_figures(summary, errors, data),
        key=path_key(data),
        has_images=bool(thumbnails),
        columns=list(COLUMNS),
        error_rows=[] if errors is None else errors.rows(),
        pictures=[(picture, _jpeg(picture.image)) for picture in pictures],
        said=[(said_text(one), one.code) for one in summary.said],
        settings=leaves(summary.settings),
    )
    path = folder / REPORT
    replace_file(path, page.encode(errors="replace"))  # a name may be no UTF-8
    return path


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


def _key_figures(summary: RunSummary, errors: ErrorTable | None, data: RunData) -> list[tuple[str, str, str]]:
    """Label, value and unit of the figures that come first."""
    tiles = _kidnap_tiles(data)
    if errors is not None:
        x, y = errors.tracked_x or errors.x, errors.tracked_y or errors.y
        heading, position = errors.tracked_heading or errors.heading, errors.tracked_position or errors.position
        which = "" if errors.tracked_x is None else ", tracked"
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
    return tiles


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


def path_key(data: RunData) -> list[tuple[str, str]]:
    """What the picture of the path shows, in words, each with the stylesheet's name of its colour."""
    labels = {color: mode.value for mode, color in MODE_COLORS.items()} | {
        status.value: status.value for status in Status
    }
    shown = set(dot_colors(data).tolist())
    key = [("truth", "truth")] if data.truth is not None else []
    key += [(label, color) for color, label in labels.items() if color in shown]
    return key + ([("first located", "first-located")] if data.first_located < len(data.table) else [])


def _jpeg(image: ImageArray) -> str:
    """An image as the source of one."""
    code = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1]
    return f"data:image/jpeg;base64,{base64.b64encode(code.tobytes()).decode('ascii')}"
