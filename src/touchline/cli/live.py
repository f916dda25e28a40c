"""`touchline live` and `touchline play`: a robot that runs, and a recording sent as if it did."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

import typer

from touchline.cli.console import announce_compiling, errors_console, say
from touchline.cli.interrupts import interruptible
from touchline.cli.options import (
    ConfigFile,
    FollowLinks,
    Overrides,
    OwnHalf,
    StartPose,
    SystemName,
    bag_options,
    numbers,
    turn_in_rad,
)
from touchline.errors import InputError, TouchlineError
from touchline.messages import counted, without_numbers

if TYPE_CHECKING:
    from touchline.live.heard import Link, Published
    from touchline.live.loop import LiveLoop
    from touchline.live.ros_link import RosRobot
    from touchline.live.ros_node import RosNode
    from touchline.live.state_file import StateFile
    from touchline.live.udp import UdpRobot
    from touchline.localizer import Localizer
    from touchline.sources import Recording
    from touchline.types import Problem

PORT = 28400


_OF_UDP, _OF_ROS = "Options of udp", "Options of ros"
LinkArgument = Annotated[
    Literal["udp", "ros"],
    typer.Argument(metavar="LINK", help="Datagrams, or the topics of ROS 2 (as a node by rclpy)."),
]
Listen = Annotated[
    str | None,
    typer.Option(
        "--listen",
        metavar="[HOST:]PORT",
        help=f"Where the robot's messages come (default: {PORT} of loopback).",
        rich_help_panel=_OF_UDP,
    ),
]
RosTopics = Annotated[
    list[str] | None,
    typer.Option(
        "--topic",
        metavar="ROLE=/NAME",
        help="A topic that its type doesn't give: image, odometry, compass, …; repeatable.",
        rich_help_panel=_OF_ROS,
    ),
]
RosBase = Annotated[
    str | None,
    typer.Option(
        "--base",
        metavar="FRAME",
        help="The robot's frame on the ground (default: by its usual names).",
        rich_help_panel=_OF_ROS,
    ),
]
Namespace = Annotated[
    str,
    typer.Option(metavar="/NAME", help="This robot's namespace: its topics come first.", rich_help_panel=_OF_ROS),
]
_SILENT_S = 3.0  # without an image until it is reported what was received, and what is there
_EVERY_S = 1.0  # so often a line on the terminal
_REPEAT_S = 5.0  # after which a problem that is shown is shown again


def live(
    link: LinkArgument,
    field: Annotated[str, typer.Option(metavar="NAME|FILE", help="The field.")],
    camera: Annotated[Path | None, typer.Option(help="camera.yaml; none is needed for points of a detector.")] = None,
    system: SystemName = None,
    listen: Listen = None,
    to: Annotated[
        str | None,
        typer.Option(
            "--to",
            metavar="[HOST:]PORT",
            help=f"Where the poses go (default: {PORT + 1} of loopback).",
            rich_help_panel=_OF_UDP,
        ),
    ] = None,
    topics: RosTopics = None,
    base: RosBase = None,
    late: Annotated[
        float,
        typer.Option(
            metavar="MS",
            min=-1000.0,
            max=1000.0,
            help="Delay of messages without a stamp; touchline check of a bag measures it.",
            rich_help_panel=_OF_ROS,
        ),
    ] = 0.0,
    namespace: Namespace = "",
    device: Annotated[
        str | None, typer.Option(metavar="/dev/videoN", help="Images of this camera, sensors by the link.")
    ] = None,
    start: StartPose = None,
    own_half: OwnHalf = False,
    wheels: Annotated[
        str | None, typer.Option(metavar="A,B", help="Rolling directions of two measuring wheels (rad).")
    ] = None,
    config: ConfigFile = None,
    settings: Overrides = None,
    seconds: Annotated[float | None, typer.Option(min=0, help="End after so long.")] = None,
    team_evidence: Annotated[
        bool, typer.Option("--team-evidence", help="What others say of where the robot is counts; anybody may say it.")
    ] = False,
    mates: Annotated[
        list[str] | None,
        typer.Option("--mate", metavar="NAME", help="Of --team-evidence: who is known; all others are one voice."),
    ] = None,
    game_controller: Annotated[
        bool, typer.Option("--game-controller", help="Listen to the referee (UDP 3838); nothing is sent.")
    ] = False,
    team: Annotated[int | None, typer.Option(min=0, max=255, help="Number of its team: penalties count.")] = None,
    player: Annotated[int | None, typer.Option(min=1, max=20, help="Its number in the team.")] = None,
    state: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Keep there once a second what is known; go on from there at the start."),
    ] = None,
) -> None:
    """Localise a running robot: images and sensors come, poses go, by UDP or ROS 2. Ctrl-C ends it."""
    from touchline.api import settings_given
    from touchline.live.loop import LiveLoop
    from touchline.live.state_file import StateFile, resume
    from touchline.localizer import Localizer
    from touchline.systems import DEFAULT_SYSTEM, system_info

    choice = LinkChoice(link, listen, to, topics or (), base, late, namespace)
    choice.require_own_options()
    if mates and not team_evidence:
        raise InputError("--mate: counts only with --team-evidence")
    if (team is None) != (player is None) or (team is not None and not game_controller):
        raise InputError("--team and --player belong together, and to --game-controller")
    if camera is not None and str(camera).startswith("/dev/"):
        raise InputError(f"--camera {camera}: is a device: --device {camera} reads it, --camera names its camera.yaml")
    name = system or DEFAULT_SYSTEM
    chosen = settings_given(system_info(name), config, settings or (), None)
    localizer = Localizer(field, camera, name, _pair(wheels, "--wheels"), chosen)
    if state is not None:
        errors_console().print(resume(state, localizer))
    begin(localizer, start, own_half)
    opened = open_link(choice, localizer)
    if device is not None:
        from touchline.live.camera_device import WithCamera
        from touchline.sources.uvc_camera import UvcCamera

        opened = WithCamera(opened, UvcCamera(int(device) if device.isdigit() else device, automatic=True))
    if game_controller:
        from touchline.live.game_controller import GameController, WithGameController

        opened = WithGameController(opened, GameController(team, player))
    console = errors_console()
    console.print(f"{name}: {choice}; Ctrl-C ends it")
    ends_s = None if seconds is None else time.monotonic() + seconds
    with (
        closing(opened),
        announce_compiling(console.print),
        interruptible() as stop,
    ):
        kept = None if state is None else StateFile(state, localizer)
        loop = LiveLoop(opened, localizer, _Shown(kept).take, team_evidence, mates or ())
        silence = _Silence(loop, opened, console.print)
        loop.run(lambda: stop() or silence.report() or (ends_s is not None and time.monotonic() > ends_s))
        refused, around = opened.refused, silence.received()
    _tell_end(loop, localizer.problems, refused, around if silence.reported else None)


def begin(localizer: Localizer, start: str | None, own_half: bool = False) -> None:
    """Where the robot starts, if that was given. Raises InputError for what is no place on the field."""
    from touchline.api import checked_prior
    from touchline.cli.run import parse_pose
    from touchline.types import Prior

    if start is not None or own_half:
        pose = None if start is None else checked_prior(Prior(parse_pose(start)), localizer.field).pose
        localizer.reset(pose, own_half=own_half)


class LinkChoice(NamedTuple):
    """A link and its options. link: None where a recording takes its place."""

    link: str | None
    listen: str | None
    to: str | None
    topics: Sequence[str]
    base: str | None
    late_ms: float
    namespace: str

    def require_own_options(self) -> None:
        """Raises InputError for an option of another link, which would be ignored."""
        of_udp: dict[str, object] = {"--listen": self.listen, "--to": self.to}
        of_ros: dict[str, object] = {"--topic": self.topics, "--base": self.base, "--late": self.late_ms}
        for link, values in (("udp", of_udp), ("ros", of_ros | {"--namespace": self.namespace})):
            wrong = next((option for option, value in values.items() if value), None)
            if wrong is not None and link != self.link:
                raise InputError(f"{wrong}: is an option of {link}")

    def __str__(self) -> str:
        if self.link == "ros":
            return f"reads topics of ROS 2, publishes {_as_namespace(self.namespace)}/touchline/pose"
        return f"listens on UDP {self.listen or PORT}, sends poses to UDP {self.to or PORT + 1}"


def open_link(choice: LinkChoice, localizer: Localizer) -> Link:
    """The link to a running robot. Raises InputError where there is none."""
    if choice.link == "ros":
        named, namespace = bag_options([*choice.topics], None, None, None).topics, _as_namespace(choice.namespace)
        node = _ros_node("touchline", namespace)
        from touchline.live.ros_link import RosLink, RosOptions

        return RosLink(node, RosOptions(named, choice.base, localizer.field, localizer.camera, choice.late_ms))
    from touchline.live.udp import UdpLink

    return UdpLink(address(choice.listen or str(PORT), "--listen"), address(choice.to or str(PORT + 1), "--to"))


def _ros_node(name: str, namespace: str = "") -> RosNode:
    """Raises InputError where a library is missing."""
    from importlib.util import find_spec

    if find_spec("rclpy") is None:
        raise InputError(
            "ros: rclpy cannot be imported: source ROS's setup.bash, in an environment of ROS's own Python; "
            "udp needs no ROS"
        )
    if find_spec("rosbags") is None:
        raise InputError("ros: rosbags is not installed: pip install 'touchline[bags]'")
    from touchline.live.ros_node import RosNode

    return RosNode(name, namespace)


def _as_namespace(text: str) -> str:
    """/robot1 of /robot1, robot1 and /robot1/. Raises InputError for what ROS takes for none."""
    name = text.strip("/")
    if name and not all(part.isidentifier() and part.isascii() for part in name.split("/")):
        raise InputError(f"--namespace {text}: letters, digits and _ between slashes, for example /robot1")
    return f"/{name}" if name else ""


def play(
    link: LinkArgument,
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", help="A recording, or a bag.")],
    to: Annotated[
        str | None,
        typer.Option(
            "--to",
            metavar="[HOST:]PORT",
            help=f"Where touchline live listens (default: {PORT} of loopback).",
            rich_help_panel=_OF_UDP,
        ),
    ] = None,
    speed: Annotated[float, typer.Option(min=0.01, max=100.0, help="As fast as it was recorded, times this.")] = 1.0,
    delay: Annotated[
        float, typer.Option(min=0.0, max=10.0, help="Images come so much later than they were taken (s).")
    ] = 0.0,
    loop: Annotated[bool, typer.Option("--loop", help="Once more from the beginning, until Ctrl-C.")] = False,
    follow_links: FollowLinks = False,
) -> None:
    """Send a recording to `touchline live` as a robot would, in real time."""
    from touchline.live.playing import play as play_recording
    from touchline.sources import open_source

    LinkChoice(link, None, to, (), None, 0.0, "").require_own_options()
    source = open_source(recording, follow_links)
    robot = _robot(link, to or str(PORT), source)
    where = "topics of ROS 2" if link == "ros" else f"UDP {to or PORT}"
    errors_console().print(f"{source.name}: {counted(len(source), 'image')} to {where}; Ctrl-C ends it")
    sent = 0
    with interruptible() as stop:
        while True:
            sent += play_recording(source, robot.send, speed, stop, delay)
            if not loop or stop():
                break
    robot.close()
    say(f"{counted(sent, 'image')} sent")


def _robot(link: str, to: str, source: Recording) -> UdpRobot | RosRobot:
    """The robot's end of a link. Raises InputError where there is none."""
    if link == "ros":
        node = _ros_node("touchline_play")
        from touchline.live.ros_link import RosRobot
        from touchline.sources.bags.camera_file import ros_camera

        return RosRobot(node, ros_camera(source))
    from touchline.live.udp import UdpRobot

    return UdpRobot(address(to, "--to"))


def address(text: str, option: str) -> tuple[str, int]:
    """[HOST:]PORT. Raises InputError for anything else."""
    host, colon, port = text.rpartition(":")
    if not port.isdigit() or not 0 < int(port) < 65536 or (colon and not host):
        raise InputError(f"{option} {text}: expected a port, or HOST:PORT, for example 127.0.0.1:{PORT}")
    return host or "127.0.0.1", int(port)


def _pair(text: str | None, option: str) -> tuple[float, float] | None:
    if text is None:
        return None
    a, b = numbers(text, option, "A,B in rad", "0.785,2.356")
    return turn_in_rad(a, option), turn_in_rad(b, option)


class _Silence:
    """Reports once, where no image comes, what was received."""

    def __init__(self, loop: LiveLoop, link: Link, tell: Callable[[str], None]) -> None:
        self._loop, self._link, self._tell = loop, link, tell
        self._due_s = time.monotonic() + _SILENT_S
        self.reported = False

    def report(self) -> bool:
        """False: the loop goes on."""
        if time.monotonic() > self._due_s and not self._loop.counts["images"]:
            self._tell(f"nothing to localise for {_SILENT_S:g} s: {self.received()}")
            self._due_s, self.reported = math.inf, True
        return False

    def received(self) -> str:
        """Samples of sensors, and what the link has found."""
        return f"{counted(self._loop.counts['readings'], 'sample')} of sensors; {self._link.around()}"


class _Shown:
    """A line on the terminal now and then; what is tracked is kept, too, where a file is named."""

    def __init__(self, kept: StateFile | None = None) -> None:
        self._kept = kept
        self._last_s = 0.0
        self._shown_s: dict[str, float] = {}

    def take(self, published: Published) -> None:
        """One estimate of an image."""
        estimate, now_s = published.estimate, time.monotonic()
        if self._kept is not None:
            self._kept.take(estimate, published.map_from_odom)
        for problem in estimate.problems:
            alike = without_numbers(problem.sentence)
            if now_s - self._shown_s.get(alike, -math.inf) > _REPEAT_S:
                say(problem.sentence)
            self._shown_s[alike] = now_s
        if now_s - self._last_s < _EVERY_S:
            return
        self._last_s = now_s
        x, y, heading = estimate.pose
        say(
            f"{estimate.status_text()}: x {x:.2f} m, y {y:.2f} m, {math.degrees(heading):.0f}°, "
            f"{1e3 * published.after_s:.1f} ms after the image came, {published.dropped} dropped"
        )


def _tell_end(loop: LiveLoop, problems: dict[Problem, int], refused: dict[str, int], around: str | None) -> None:
    """What came and what became of it. refused: messages. around: what else was received where no image came.

    Raises TouchlineError where there was nothing to localise, or to see with.
    """
    from touchline.types import ProblemCode, Status

    counts, odd = loop.counts, {one.sentence: count for one, count in problems.items()} | refused
    by_status = ", ".join(f"{status.value} {counts[status.value]}" for status in Status)
    say(
        f"{counts['published']} of {counted(counts['images'], 'image')} looked at: {by_status}; "
        f"{counts['dropped']} dropped; {counts['readings']} samples of sensors",
        *(f"{count} × {what}" for what, count in sorted(odd.items())),
    )
    if counts["evidence"]:
        say(f"{counts['evidence']} × evidence of others, left out: --team-evidence lets it count")
    if not counts["images"] and around is not None:
        raise TouchlineError(f"nothing came that could be localised: {around}")
    if not counts[Status.TRACKING.value] and any(one.code == ProblemCode.CAMERA_MISSING for one in problems):
        raise TouchlineError(f"none of {counted(counts['images'], 'image')} was localised: no camera is known")
