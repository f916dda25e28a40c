"""Options that several commands share."""

from __future__ import annotations

from typing import Annotated

import typer

FollowLinks = Annotated[
    bool,
    typer.Option("--follow-links", help="Also read what the recording names or links to outside of its folder."),
]
