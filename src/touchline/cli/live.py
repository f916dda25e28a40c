"""`touchline live` and `touchline play`: a robot that runs, and a recording sent as if it did."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from touchline.cli.console import announce_compiling, errors_console, say
from touchline.cli.interrupts import interruptible
from touchline.cli.options import (
    BagBase,
    BagLate,
    ConfigFile,
    FollowLinks,
    Overrides,
    OwnHalf,
    StartPose,
    SystemName,
    bag_options,
    turn_in_rad,
)
from touchline.errors import InputError, TouchlineError
from touchline.messages import counted, without_numbers

if TYPE_CHECKING:
    from touchline.live.heard import Link, Published, Robot
    from touchline.live.loop import LiveLoop
    from touchline.live.ros_link import Transport
    from touchline.localizer import Localizer

PORT = 28400
Address = Annotated[
    str | None,
    typer.Option(
        "--udp", metavar="[HOST:]PORT", help=f"Where Touchline hears the robot (default: {PORT} of loopback)."
    ),
]
ByDds = Annotated[bool, typer.Option("--dds", help="By ROS 2's topics, without ROS (extra ros2).")]
ByZenoh = Annotated[bool, typer.Option("--zenoh", help="By ROS 2's topics over Zenoh, without ROS (extra zenoh).")]
ByRclpy = Annotated[
    bool, typer.Option("--rclpy", help="By ROS 2's topics as a node of ROS, in an environment that has it.")
]
ByBridge = Annotated[
    str | None, typer.Option(metavar="[HOST:]PORT", help="By ROS 2's topics that touchline_ros's bridge brings.")
]
Namespace = Annotated[str, typer.Option(metavar="/NAME", help="Of this robot in ROS: its topics come first.")]
BeyondMachine = Annotated[bool, typer.Option("--network", help="Of --dds, --zenoh: beyond this machine.")]
Topics = Annotated[
    list[str] | None,
    typer.Option("--topic", metavar="ROLE=/NAME", help="Of ROS: image, odometry, detections, …; repeatable."),
]
_SILENT_S = 3.0  # without an image until it is reported what was received, and what is there
_EVERY_S = 1.0  # so often a line on the terminal
_REPEAT_S = 5.0  # after which a problem that is shown is shown again


def live(
    field: Annotated[str, typer.Option(metavar="NAME|FILE", help="The field.")],
    camera: Annotated[Path | None, typer.Option(help="camera.yaml; none is needed for points of a detector.")] = None,
    system: SystemName = None,
    dds: ByDds = False,
    zenoh: ByZenoh = False,
    rclpy: ByRclpy = False,
    bridge: ByBridge = None,
    topics: Topics = None,
    base: BagBase = None,
    late: BagLate = 0.0,
    namespace: Namespace = "",
    network: BeyondMachine = False,
    udp: Address = None,
    to: Annotated[
        str | None,
        typer.Option("--to", metavar="[HOST:]PORT", help=f"Where the poses go (default: {PORT + 1} of loopback)."),
    ] = None,
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
    """Localise a running robot: images and sensors in by ROS 2's topics or UDP, poses out. Ctrl-C ends it."""
    from touchline.api import checked_prior
    from touchline.cli.run import parse_pose
    from touchline.config import load_settings
    from touchline.live.loop import LiveLoop
    from touchline.localizer import Localizer
    from touchline.systems import DEFAULT_SYSTEM, SYSTEMS, system_info
    from touchline.types import Prior

    ros = {"--dds": dds, "--zenoh": zenoh, "--rclpy": rclpy, "--bridge": bridge is not None}
    of_ros = {"--topic": topics, "--base": base, "--late": late, "--namespace": namespace}
    refuse_of_other_link(ros, {"--udp": udp, "--to": to}, of_ros, network)
    if mates and not team_evidence:
        raise InputError("--mate: counts only with --team-evidence")
    if (team is None) != (player is None) or (team is not None and not game_controller):
        raise InputError("--team and --player belong together, and to --game-controller")
    namespace, named = as_namespace(namespace), bag_options(topics, None, None, None).topics
    udp, to = udp or str(PORT), to or str(PORT + 1)
    if camera is not None and str(camera).startswith("/dev/"):
        raise InputError(f"--camera {camera}: is a device: --device {camera} reads it, --camera names its camera.yaml")
    name = system or DEFAULT_SYSTEM
    others = {other: info.settings for other, info in SYSTEMS.items() if other != name}
    chosen = load_settings(system_info(name).settings, config, settings or (), elsewhere=others)
    localizer = Localizer(field, camera, name, _pair(wheels, "--wheels"), chosen)
    if state is not None:
        from touchline.live.state_file import resume

        errors_console().print(resume(state, localizer))
    if start is not None or own_half:
        pose = None if start is None else checked_prior(Prior(parse_pose(start)), localizer.field).pose
        localizer.reset(pose, own_half=own_half)
    link = open_link(LinkChoice(ros, named, base, late, namespace, network, bridge, udp, to), localizer)
    if device is not None:
        link = _with_camera(link, device)
    if game_controller:
        from touchline.live.game_controller import GameController, WithGameController

        link = WithGameController(link, GameController(team, player))
    console = errors_console()
    topics_of_ros = f"reads topics of ROS 2, publishes {namespace}/touchline/pose"
    where = topics_of_ros if any(ros.values()) else f"hears udp {udp}, tells udp {to}"
    console.print(f"{name}: {where}; Ctrl-C ends it")
    ends_s = None if seconds is None else time.monotonic() + seconds
    with (
        closing(link),
        announce_compiling(console.print),
        interruptible() as stop,
    ):
        shown = _Shown()
        on_published = shown.take if state is None else _kept_in(state, localizer, shown.take)
        loop = LiveLoop(link, localizer, on_published, team_evidence, mates or ())
        silence = _Silence(loop, link, console.print)
        loop.run(lambda: stop() or silence.report() or (ends_s is not None and time.monotonic() > ends_s))
        refused, around = link.refused, silence.received()
    _tell_end(loop, {**localizer.problems, **refused}, around if silence.reported else None)


class LinkChoice(NamedTuple):
    """What carries the messages: ros, by option; of ROS topics, base, late (ms), namespace, network, and the bridge's
    address; else UDP, from and to.
    """

    ros: Mapping[str, bool]
    topics: Mapping[str, str]
    base: str | None
    late: float
    namespace: str
    network: bool
    bridge: str | None
    udp: str
    to: str


def open_link(of: LinkChoice, localizer: Localizer) -> Link:
    """The link to a running robot. Raises InputError where there is none."""
    if any(of.ros.values()):
        from touchline.live.ros_link import RosLink, RosOptions

        options = RosOptions(of.topics, of.base, of.namespace, localizer.field, localizer.camera, of.late)
        here = None if of.bridge is None else address(of.bridge, "--bridge")
        return RosLink(_transport(of.ros, of.namespace, of.network, here), options)
    from touchline.live.udp import UdpLink

    return UdpLink(address(of.udp, "--udp"), address(of.to, "--to"))


def _with_camera(link: Link, device: str) -> Link:
    from touchline.live.camera_device import WithCamera
    from touchline.sources.uvc_camera import UvcCamera

    return WithCamera(link, UvcCamera(int(device) if device.isdigit() else device, automatic=True))


def _kept_in(path: Path, localizer: Localizer, show: Callable[[Published], None]) -> Callable[[Published], None]:
    """Shows an estimate, and keeps it."""
    from touchline.live.state_file import StateFile

    kept = StateFile(path, localizer)

    def take(published: Published) -> None:
        show(published)
        kept.take(published.estimate, published.map_from_odom)

    return take


def refuse_of_other_link(
    ros: Mapping[str, bool], of_udp: Mapping[str, object], of_ros: Mapping[str, object], network: bool
) -> None:
    """Raises InputError for two links, and for an option that would be left aside."""
    chosen = [option for option, given in ros.items() if given]
    if len(chosen) > 1:
        raise InputError(f"{' '.join(chosen)}: one of them carries the messages")
    wrong = [option for option, value in (of_udp if chosen else of_ros).items() if value]
    if wrong:
        raise InputError(f"{wrong[0]}: counts only {'without ' + chosen[0] if chosen else 'with ' + _one_of(ros)}")
    if network and not {"--dds", "--zenoh"} & set(chosen):
        raise InputError("--network: counts only with --dds or --zenoh")


def _one_of(ros: Mapping[str, bool]) -> str:
    return " or ".join((", ".join(list(ros)[:-1]), list(ros)[-1]))


def _transport(
    ros: Mapping[str, bool], namespace: str, network: bool, here: tuple[str, int] | None = None, name: str = "touchline"
) -> Transport:
    """What carries ROS's messages. Raises InputError where it cannot."""
    if here is not None:
        _require("--bridge", "bags", "rosbags")
        from touchline.live.bridge import Bridge

        return Bridge(here)
    if ros["--dds"]:
        _require("--dds", "ros2", "cyclonedds", "rosbags")
        from touchline.live.dds import Dds

        return Dds(namespace, network, name)
    if ros["--zenoh"]:
        _require("--zenoh", "zenoh", "zenoh", "rosbags")
        from touchline.live.zenoh_link import Zenoh

        return Zenoh(namespace, network, name)
    from touchline.live.rclpy_link import Rclpy, require_rclpy

    require_rclpy()
    return Rclpy(namespace, name=name)


def as_namespace(text: str) -> str:
    """/robot1 of /robot1, robot1 and /robot1/. Raises InputError for what ROS takes for none."""
    name = text.strip("/")
    if name and not all(part.isidentifier() and part.isascii() for part in name.split("/")):
        raise InputError(f"--namespace {text}: letters, digits and _ between slashes, for example /robot1")
    return f"/{name}" if name else ""


def _require(option: str, extra: str, *modules: str) -> None:
    """Raises InputError where a library is not installed."""
    from importlib.util import find_spec

    missing = [name for name in modules if find_spec(name) is None]
    if missing:
        raise InputError(f"{option}: {' and '.join(missing)} is not installed: pip install 'touchline[{extra}]'")


def play(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", help="A recording, or a bag.")],
    dds: ByDds = False,
    zenoh: ByZenoh = False,
    network: BeyondMachine = False,
    udp: Address = None,
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

    ros = {"--dds": dds, "--zenoh": zenoh}
    refuse_of_other_link(ros, {"--udp": udp}, {}, network)
    udp = udp or str(PORT)
    source = open_source(recording, follow_links)
    robot: Robot
    if any(ros.values()):
        transport = _transport(ros, "", network, name="touchline_play")
        from touchline.live.ros_link import RosRobot
        from touchline.sources.bags.camera_file import ros_camera

        robot = RosRobot(transport, ros_camera(source))
    else:
        from touchline.live.udp import UdpRobot

        robot = UdpRobot(address(udp, "--udp"))
    where = "topics of ROS 2" if any(ros.values()) else f"udp {udp}"
    errors_console().print(f"{source.name}: {counted(len(source), 'image')} to {where}; Ctrl-C ends it")
    sent = 0
    with interruptible() as stop:
        while True:
            sent += play_recording(source, robot.send, speed, stop, delay)
            if not loop or stop():
                break
    robot.close()
    say(f"{counted(sent, 'image')} sent")


def address(text: str, option: str) -> tuple[str, int]:
    """[HOST:]PORT. Raises InputError for anything else."""
    host, colon, port = text.rpartition(":")
    if not port.isdigit() or not 0 < int(port) < 65536 or (colon and not host):
        raise InputError(f"{option} {text}: expected a port, or HOST:PORT, for example 127.0.0.1:{PORT}")
    return host or "127.0.0.1", int(port)


def _pair(text: str | None, option: str) -> tuple[float, float] | None:
    if text is None:
        return None
    try:
        a, b = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"{option} {text}: expected A,B in rad, for example {option}=0.785,2.356") from None
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
    """A line on the terminal now and then."""

    def __init__(self) -> None:
        self._last_s = 0.0
        self._shown_s: dict[str, float] = {}

    def take(self, published: Published) -> None:
        """One estimate of an image."""
        estimate, now_s = published.estimate, time.monotonic()
        for problem in estimate.problems:
            alike = without_numbers(problem)
            if now_s - self._shown_s.get(alike, -math.inf) > _REPEAT_S:
                say(problem)
            self._shown_s[alike] = now_s
        if now_s - self._last_s < _EVERY_S:
            return
        self._last_s = now_s
        x, y, heading = estimate.pose
        say(
            f"{estimate.status_text()}: x {x:.2f} m, y {y:.2f} m, {math.degrees(heading):.0f}°, "
            f"{1e3 * published.after_s:.1f} ms after the image came, {published.dropped} dropped"
        )


def _tell_end(loop: LiveLoop, problems: dict[str, int], around: str | None) -> None:
    """What came and what became of it. around: what else was received where no image came.

    Raises TouchlineError where there was nothing to localise, or to see with.
    """
    from touchline.types import Status

    counts = loop.counts
    by_status = ", ".join(f"{status.value} {counts[status.value]}" for status in Status)
    say(
        f"{counts['published']} of {counted(counts['images'], 'image')} looked at: {by_status}; "
        f"{counts['dropped']} dropped; {counts['readings']} samples of sensors",
        *(f"{count} × {what}" for what, count in sorted(problems.items())),
    )
    if counts["evidence"]:
        say(f"{counts['evidence']} × evidence of others, left out: --team-evidence lets it count")
    if not counts["images"] and around is not None:
        raise TouchlineError(f"nothing came that could be localised: {around}")
    if not counts[Status.TRACKING.value] and any("no camera" in what for what in problems):
        raise TouchlineError(f"none of {counted(counts['images'], 'image')} was localised: no camera is known")
