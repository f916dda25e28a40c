"""A field as the text of a field.yaml (docs/how-to-field.md), exact to the last digit."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import yaml

if TYPE_CHECKING:
    from touchline.field.model import FieldModel

_HEADER = """\
# A marked field. Origin at the centre mark, x along the length towards the opponent goal, y left; metres, radians.
# length and width reach to the outer edge of the lines; the rows are centre lines: segments x1, y1, x2, y2;
# circles cx, cy, radius; arcs cx, cy, radius, start, end (counter-clockwise); discs cx, cy, diameter of a filled mark.
"""


def field_to_text(field: FieldModel) -> str:
    """The text of a field.yaml that loads as an equal field."""
    tree: dict[str, Any] = {"name": field.name}
    if field.description:
        tree["description"] = field.description
    for key in ("length", "width", "line_width", "border"):
        tree[key] = getattr(field, key)
    if field.letters:
        tree["letters"] = dict(field.letters)
    for key in ("segments", "circles", "arcs", "discs"):
        tree[key] = getattr(field, key).tolist()
    tree["goals"] = [{**asdict(goal), "y_posts": list(goal.y_posts)} for goal in field.goals]
    tree["poles"] = [{**asdict(pole), "bands_from_ground": list(pole.bands_from_ground)} for pole in field.poles]
    return _HEADER + yaml.safe_dump(tree, sort_keys=False, default_flow_style=None, allow_unicode=True, width=120)
