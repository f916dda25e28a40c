"""A page that needs nothing but a browser: stylesheet, scripts and data within, nothing from elsewhere.

Its templates are in web/, beside uPlot, which draws the curves (https://github.com/leeoniya/uPlot, MIT).
"""

from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from touchline.files.opened import read_text
from touchline.messages import counted

_MAX_BYTES = 200_000
_WEB = Path(__file__).parent / "web"


def html_page(template: str, data: str | None, **values: Any) -> str:
    """The page that a template of web/ makes of these values, of which every text is escaped.

    data: JSON as `timeline.page_data` writes it, for the template's `time_panel`; None: there is none.
    """
    marked = None if data is None else Markup(data)
    return _templates().get_template(template).render(data=marked, **values)


@cache
def _templates() -> Environment:
    templates = Environment(
        loader=FileSystemLoader(_WEB), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    templates.globals |= {"counted": counted, "file": lambda name: Markup(read_text(_WEB / name, _MAX_BYTES))}
    return templates
