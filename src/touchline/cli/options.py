"""Options that several commands share."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from touchline.errors import InputError

if TYPE_CHECKING:
    from touchline.sources import BagOptions

FollowLinks = Annotated[
    bool, typer.Option("--follow-links", help="Also read what the recording names or links to outside of its folder.")
]
Topics = Annotated[
    list[str] | None,
    typer.Option(
        "--topic",
        metavar="ROLE=/NAME",
        help="Of a bag: image, odometry, detections, …, as docs/how-to-bags.md lists them; may be repeated.",
    ),
]
BagField = Annotated[
    str | None, typer.Option("--field", metavar="NAME|FILE", help="Of a bag or video: the field, which none tells.")
]
BagCamera = Annotated[Path | None, typer.Option("--camera", help="Of a bag or video: its camera.yaml.")]
BagBase = Annotated[
    str | None,
    typer.Option(
        "--base", metavar="FRAME", help="Of a bag or topics: the robot's frame on the ground (base_footprint, …)."
    ),
]

BagLate = Annotated[
    float,
    typer.Option(
        metavar="MS",
        min=-1000.0,
        max=1000.0,
        help="Messages without a stamp were received so much later than measured; touchline check tells.",
    ),
]
FromZero = Annotated[bool, typer.Option("--from-zero", help="Of a bag: times count from its first second.")]
SkipUnusable = Annotated[bool, typer.Option("--skip-unusable", help="Leave out images that don't show the strip.")]
SystemName = Annotated[
    str | None, typer.Option("--system", help="The system to run (default: touchline); see touchline systems.")
]
ConfigFile = Annotated[Path | None, typer.Option("--config", help="YAML file of settings.")]
Overrides = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change one setting; may be repeated.")
]
Preset = Annotated[
    str | None,
    typer.Option("--preset", metavar="paper", help="The system's exact form in its paper; file and --set win over it."),
]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Same seed, same trajectory.")]
StartPose = Annotated[
    str | None, typer.Option("--start", metavar="X,Y,HEADING", help="Where the robot starts (m, m, rad), field frame.")
]
OwnHalf = Annotated[bool, typer.Option("--own-half", help="The robot starts in its own half (x < 0).")]


def bag_options(
    topics: list[str] | None,
    field: str | None,
    camera: Path | None,
    base: str | None,
    late_ms: float = 0.0,
    from_zero: bool = False,
) -> BagOptions:
    """What a bag does not say of itself. Raises InputError for a topic that is not ROLE=/NAME."""
    from touchline.sources.bags.roles import BagOptions

    named = [text.partition("=") for text in topics or ()]
    for role, equals, name in named:
        if not (role and equals and name):
            raise InputError(f"--topic {role}{equals}{name}: expected ROLE=/NAME, for example image=/front/image_raw")
    return BagOptions({role: name for role, _, name in named}, field, camera, base, late_ms, from_zero)


def numbers(text: str, option: str, expected: str, example: str) -> tuple[float, ...]:
    """Numbers between commas, as many as the example has. Raises InputError for anything else."""
    try:
        found = tuple(map(float, text.split(",")))
    except ValueError:
        found = ()
    if len(found) != example.count(",") + 1:
        raise InputError(f"{option} {text}: expected {expected}, for example {option}={example}")
    return found


def turn_in_rad(angle: float, option: str) -> float:
    """The angle. Raises InputError for more than a full turn: degrees, then, or for what is no number."""
    if not abs(angle) <= 2.0 * math.pi:
        raise InputError(f"{option} {angle:g}: is more than a full turn; an angle in rad is expected (90° are 1.5708)")
    return angle


WorkerCount = Annotated[
    int | None,
    typer.Option("--workers", min=1, metavar="N", help="So many processes (default: all cores); same numbers."),
]
TimedWorkers = Annotated[
    int,
    typer.Option("--workers", min=1, metavar="N", help="So many processes; same errors, but times of a busy machine."),
]
DaskAddress = Annotated[
    str | None, typer.Option("--dask", metavar="ADDRESS", help="On a Dask cluster (tcp://HOST:PORT; extra season).")
]
