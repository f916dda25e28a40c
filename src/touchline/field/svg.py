"""A field from above as SVG text, as notebooks show it."""

from __future__ import annotations

import html
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from touchline.field.model import FieldModel

_CARPET, _PAINT, _GOAL = "#2c7c3a", "#f8f8f8", "#54924f"


def field_svg(field: FieldModel, width_px: int = 640, marks: str = "") -> str:
    """The field with its lines, marks, goals and posts; x to the right, y up, metres within; marks: SVG on top."""
    beyond = max([field.border, *(goal.depth + 0.1 for goal in field.goals)])
    length, width = field.length + 2.0 * beyond, field.width + 2.0 * beyond
    paths = " ".join("M" + " ".join(f"{x:.3f},{y:.3f}" for x, y in line) for line in field.polylines(0.1))
    discs = "".join(f'<circle cx="{x:.3f}" cy="{y:.3f}" r="{d / 2:.3f}" fill="{_PAINT}"/>' for x, y, d in field.discs)
    nets = "".join(
        f'<rect x="{min(goal.x, goal.x + (goal.depth if goal.x > 0 else -goal.depth)):.3f}" '
        f'y="{min(goal.y_posts):.3f}" width="{goal.depth:.3f}" height="{max(goal.y_posts) - min(goal.y_posts):.3f}" '
        f'fill="{_GOAL}"/>'
        for goal in field.goals
    )
    posts = "".join(
        f'<circle cx="{post.x:.3f}" cy="{post.y:.3f}" r="{max(post.diameter, 0.1) / 2:.3f}" fill="#111" '
        f'stroke="{html.escape(post.colors_from_ground[0], quote=True)}" stroke-width="0.04"/>'
        for post in field.posts
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width_px}" style="max-width:100%" '
        f'viewBox="{-length / 2:.3f} {-width / 2:.3f} {length:.3f} {width:.3f}"><g transform="scale(1,-1)">'
        f'<rect x="{-length / 2:.3f}" y="{-width / 2:.3f}" width="{length:.3f}" height="{width:.3f}" fill="{_CARPET}"/>'
        f'{nets}<path d="{paths}" fill="none" stroke="{_PAINT}" stroke-width="{field.line_width:g}" '
        f'stroke-linecap="square"/>{discs}{posts}{marks}</g></svg>'
    )
