"""A page that needs nothing but a browser: stylesheet, scripts and data within, nothing from elsewhere.

The curves are drawn by uPlot (https://github.com/leeoniya/uPlot, MIT; its licence lies beside it in web/).
"""

import html
from collections.abc import Sequence
from pathlib import Path

from touchline.files.opened import read_text

_MAX_BYTES = 200_000
_WEB = Path(__file__).parent / "web"


def html_page(title: str, sections: Sequence[str], data: str | None = None) -> str:
    """The page of these sections; data: JSON as `timeline.page_data` writes it, for the section of `time_panel`."""
    style, scripts = _file("page.css"), ""
    if data is not None:
        style = _file("uPlot.min.css") + style
        scripts = f'<script type="application/json" id="data">{data}</script>\n' + "".join(
            f"<script>{_file(name)}</script>\n" for name in ("uPlot.iife.min.js", "drawing.js", "page.js")
        )
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{html.escape(title)}</title>\n<style>{style}</style>\n</head>\n<body>\n<main>\n"
        + "\n".join(section for section in sections if section)
        + f"\n</main>\n{scripts}</body>\n</html>\n"
    )


def time_panel(key: Sequence[tuple[str, str]], has_images: bool, caption: str, about_path: str = "") -> str:
    """The section with the picture of the path, the image, the curves, and the slider that links them.

    key: what the picture of the path shows, in words, each with the stylesheet's name of its colour. caption: of the
    curves.
    """
    names = " ".join(f"<span><i class='key {color}'></i>{html.escape(label)}</span>" for label, color in key)
    path = "<svg id='path' role='img' aria-label='Field with the estimated and the true path'></svg>"
    figure = f"<figure>{path}<figcaption><span class='keys'>{names}</span>{about_path}</figcaption></figure>"
    image = (
        "<figure><img id='frame' alt='the image at this time'><figcaption id='frame-time'></figcaption></figure>"
        if has_images
        else ""
    )
    buttons = "".join(
        f"<button type='button' id='{name}'>{label}</button>"
        for name, label in (("play", "Play"), ("zoom-in", "Zoom in"), ("zoom-out", "Zoom out"), ("zoom-all", "All"))
    )
    form = "" if has_images else " class='alone'"
    return (
        "<div class='timed'><div class='panel'><p id='said'></p><input type='range' id='time' min='0' value='0' "
        f"aria-label='time'>{buttons}</div>"
        f"<section><h2>Path</h2><div id='view'{form}>{figure}{image}</div></section>"
        "<section><h2>Over time</h2><noscript><p>The curves need JavaScript.</p></noscript><div id='charts'></div>"
        f"<p class='note'>{caption} "
        "Drag across a curve to zoom, double-click for all; point at a curve or at the path to go there.</p></section>"
        "</div>"
    )


def _file(name: str) -> str:
    return read_text(_WEB / name, _MAX_BYTES)
