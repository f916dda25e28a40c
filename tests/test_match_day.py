"""What a match does to a robot: the referee, penalties, falls, pick-ups, restarts, a team that lies."""

from __future__ import annotations

import importlib.util
import math
import socket
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fakes import codes_of
from test_touchline_system import FIELD, errors, frame, seen

from touchline.cli import main
from touchline.errors import InputError
from touchline.geometry import Pose
from touchline.live.datagrams import Datagrams
from touchline.live.game_controller import GameController, WithGameController
from touchline.live.heard import Heard, Published
from touchline.live.state_file import StateFile, prior_of, resume
from touchline.localization.estimator.game_states import Referee, game_prior
from touchline.localizer import Localizer
from touchline.sources import open_source
from touchline.systems import RobotSetup
from touchline.systems.touchline import Touchline, TouchlineSettings
from touchline.types import Estimate, Evidence, Frame, GameState, Prior, Samples, Status, WeightedPose
from touchline_lab.simulation.recording import write_recording
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

# teams 5 and 12; PLAYING (3) in the first half; player 2 of team 12 has the penalty named, 33 s and its cards
HEAD = "52476d65 %s 2a 05 00 00 00 03 00 01 0c 58 02 f6 ff"
TEAM = "%s 00 01 01 00 00 0000 e02e"
PACKETS = {
    18: (HEAD % "12" + TEAM % "05" + "0e00" * 20 + TEAM % "0c" + "0000 0321" + "0e00" * 18, "motion in set"),
    19: (HEAD % "13" + TEAM % "05" + "0b000000" * 20 + TEAM % "0c" + "00000000 03210100" + "0b000000" * 18,
         "local game stuck"),
    20: (HEAD % "14" + TEAM % "05" + "0d0000" * 20 + TEAM % "0c" + "000000 062101" + "0d0000" * 18, "picked up"),
}  # fmt: skip


@pytest.mark.parametrize("version", [18, 19, 20])
def test_a_packet_says_the_state_and_the_penalty(version: int) -> None:
    text, penalty = PACKETS[version]
    packet = bytes.fromhex(text)
    assert len(packet) == {18: 118, 19: 198, 20: 158}[version]
    assert GameController(12, 2).read(packet, 7) == GameState(7, "playing", penalty, True)
    assert GameController(12, 1).read(packet, 7) == GameState(7, "playing", "", True)
    assert GameController(5, 3).read(packet, 7) == GameState(7, "playing", "substitute", True)
    assert GameController().read(packet, 7) == GameState(7, "playing", "", True)
    other = GameController(3, 1)
    assert other.read(packet, 7) is None
    assert "other teams than 3" in next(iter(other.refused))


def test_packets_that_are_none_are_named_and_counted() -> None:
    controller, right = GameController(12, 2), bytes.fromhex(PACKETS[20][0])
    for wrong in (b"", b"RGme", right[:-1], right + b"\0", right[:4] + b"\x0c" + right[5:], b"RGTD" + right[4:],
                  right[:4] + b"\x13" + right[5:], right[:10] + b"\x07" + right[11:]):  # fmt: skip
        assert controller.read(wrong, 0) is None
    said = " / ".join(controller.refused)
    assert sum(controller.refused.values()) == 8
    for words in ("version 12; known: 18, 19, 20", "version 20 with 157 bytes, not 158", "version 19 with 158 bytes",
                  "the state 7", "none of the GameController"):  # fmt: skip
        assert words in said


class Silent:
    """A link that brings nothing."""

    refused: dict[str, int] = {}  # noqa: RUF012

    def hear(self, timeout_s: float) -> list[Heard]:
        return []

    def publish(self, published: Published) -> None: ...

    def around(self) -> str:
        return ""

    def close(self) -> None: ...


def test_broadcasts_are_heard_and_not_answered() -> None:
    link = WithGameController(Silent(), GameController(12, 2), ("127.0.0.1", 0))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as referee:
        referee.bind(("127.0.0.1", 0))
        referee.setblocking(False)
        assert link.hear(0.0) == []
        assert list(link.refused) == [f"no packet of the GameController on UDP port {link.address[1]}"]
        referee.sendto(bytes.fromhex(PACKETS[20][0]), link.address)
        assert link.hear(0.0) == [GameState(0, "playing", "picked up", True)]
        assert link.refused == {}
        with pytest.raises(BlockingIOError):
            referee.recv(10)
    link.close()


@pytest.mark.parametrize("wrong", [["--team", "3"], ["--game-controller", "--team", "3"], ["--team=1", "--player=2"]])
def test_team_and_player_belong_together(wrong: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["live", "udp", "--field", "msl-18x12", "--seconds", "0", *wrong]) == 2
    assert "belong together" in capsys.readouterr().err


def test_the_referee_turns_changes_into_priors() -> None:
    referee = Referee(FIELD)

    def said(phase: str, penalty: str = "", first_half: bool = True) -> tuple[Prior, ...]:
        return referee.update(GameState(0, phase, penalty, first_half))

    assert said("ready") == ()  # nobody knows what was before
    assert said("initial") == ()
    assert [prior.own_half for prior in said("ready")] == [True]
    assert said("set") == said("playing") == said("ready") == ()  # after a goal the robot is anywhere
    assert said("playing", "motion in set") == said("playing") == ()  # it stays where it is
    (penalised,) = said("playing", "pushing")
    assert 0.0 < penalised.kept < 1.0
    assert referee.penalty == "pushing"
    assert said("playing", "pushing") == ()
    (back,) = said("playing")
    assert [round(one.pose.heading, 2) for one in back.poses] == [-1.57, 1.57]
    assert all(one.pose.x < 0.0 for one in back.poses)
    assert back.kept > 0.1
    assert said("initial", first_half=False) == (Prior(own_half=True),)
    assert [prior.kept for prior in said("set", first_half=False)] == [1.0]  # READY was not received
    with pytest.raises(InputError, match="game state: "):
        GameState(0, "halftime")


def test_weights_beyond_one_are_refused() -> None:
    one = WeightedPose(Pose(0.0, 0.0, 0.0), np.eye(3), 0.6)
    for wrong in (
        {"poses": (one, one)},
        {"poses": (one,), "kept": 0.5},
        {"kept": 1.1},
        {"kept": 0.1, "pose": one.pose},
    ):
        with pytest.raises(InputError):
            Prior(**wrong)  # type: ignore[arg-type]
    with pytest.raises(InputError):
        WeightedPose(Pose(0.0, 0.0, 0.0), np.eye(3), 0.0)


def started(place: Pose) -> Touchline:
    system = Touchline(RobotSetup(FIELD), TouchlineSettings(), np.random.default_rng(0))
    system.reset(Prior(place))
    for k in range(1, 4):
        system.step(frame(k, seen(place, k)))
    return system


def stands(system: Touchline, place: Pose, images: range) -> list[Estimate]:
    return [system.step(frame(k, seen(place, k))) for k in images]


@pytest.mark.parametrize("side", [1.0, -1.0, 0.0])
def test_back_from_a_penalty_it_stands_at_a_touch_line_or_where_it_stood(side: float) -> None:
    """Without a compass, in a half that looks like the other one."""
    stood = Pose(3.0, 1.0, 0.4)
    mark_m = -game_prior("back from a penalty", FIELD, Prior()).poses[0].pose.x
    there = Pose(-mark_m + 0.3, side * (0.5 * FIELD.width - 0.2), -side * 1.5) if side else stood
    system = started(stood)
    system.reset(game_prior("penalised", FIELD, Prior()))
    system.reset(game_prior("back from a penalty", FIELD, Prior()))
    first, *later = stands(system, there, range(20, 32))
    assert first.status is Status.SEARCHING
    assert first.reason == "moved: not yet confirmed by images"
    assert later[-1].status is Status.TRACKING
    assert errors(later[-1], there)[0] < 0.1
    assert all(estimate.status is not Status.TRACKING or errors(estimate, there)[0] < 0.1 for estimate in later)


def test_a_pose_and_its_twin_are_one_hypothesis_after_a_penalty() -> None:
    """Else both explain every image alike, and neither is ever likely."""
    system = started(Pose(1.3, -0.5, -0.6))
    system.reset(game_prior("back from a penalty", FIELD, Prior()))
    poses = [one.filter.pose for one in system.bank.members]
    assert len(poses) == 3
    assert not any(one.mirrored().distance_to(other) < 0.3 for one in poses for other in poses)


@pytest.mark.parametrize(("x", "sure"), [(0.1, True), (-3.0, True), (3.0, False)])
def test_a_ready_on_the_middle_line_leaves_the_end_of_who_is_tracked(x: float, sure: bool) -> None:
    """It may have walked on before it was told; three metres in the other half something is wrong."""
    place = Pose(x, 1.0, 0.4)
    system = started(place)
    system.reset(Prior(own_half=True, kept=1.0))
    last = stands(system, place, range(4, 10))[-1]
    assert (last.status is Status.TRACKING) is sure
    assert ((last.end_probability or 0.0) > 0.95) is sure


def test_the_own_half_is_that_of_when_it_was_told() -> None:
    """First seen after it has crossed the middle line, through images too sparse to be found by until then."""
    system = Touchline(RobotSetup(FIELD), TouchlineSettings(), np.random.default_rng(0))
    system.reset(Prior(own_half=True))
    for k in range(40):
        place = Pose(-2.5 + 0.1 * k, 1.0, 0.0)
        odometry = Samples(np.array([100_000_000 * k]), np.array([[0.1 * k, 0.0, 0.0]]))
        shown = frame(k, seen(place, k, reach_m=5.0 if k >= 30 else 0.1))
        estimate = system.step(replace(shown, odometry=odometry))
        if estimate.probability is not None:
            assert errors(estimate, place)[0] < 0.1
    assert estimate.status is Status.TRACKING
    assert (estimate.end_probability or 0.0) > 0.95


def test_where_the_end_stays_open_no_pose_is_tracked() -> None:
    system = started(Pose(2.0, 1.0, 0.4))
    system.reset(Prior(kept=0.001))  # carried, nobody knows whereto
    last = stands(system, Pose(-4.0, -2.5, 2.0), range(20, 32))[-1]
    assert (last.status, last.reason) == (Status.SEARCHING, "which end of the field is open")
    assert any(errors(replace(last, pose=one.pose), Pose(-4.0, -2.5, 2.0))[0] < 0.1 for one in [last, *last.hypotheses])


def lying(one: Frame, pitch_rad: float) -> Frame:
    return replace(one, tilt=Samples(np.array([one.stamp_ns]), np.array([[0.0, pitch_rad]])))


def test_who_lies_is_not_tracked_and_what_it_felt_is_not_believed() -> None:
    stood, there = Pose(-3.0, 1.0, 0.4), Pose(-2.7, 1.4, 1.3)
    system = started(stood)
    for k in range(4, 34):
        fallen = lying(frame(k, seen(Pose(5.0, -3.0, 0.0), k)), 1.4)
        drifted = np.column_stack((np.full(2, 0.1 * k), np.zeros(2), np.full(2, 0.2 * k)))
        assert fallen.odometry is not None
        down = system.step(replace(fallen, odometry=Samples(fallen.odometry.stamp_ns, drifted)))
        assert (down.status, down.reason) == (Status.SEARCHING, "the robot lies")
        assert down.pose.distance_to(stood) < 0.1
    found = [system.step(lying(frame(k, seen(there, k)), 0.02)) for k in range(34, 50)]
    tracked = [estimate.status is Status.TRACKING for estimate in found]
    assert tracked.index(True) < 12  # 0.4 s upright, and some images
    assert all(
        errors(estimate, there)[0] < 0.1 for estimate, is_tracked in zip(found, tracked, strict=True) if is_tracked
    )
    assert (found[-1].end_probability or 0.0) > 0.9


def test_who_was_tracked_with_an_open_end_is_tracked_again_after_a_fall_with_its_twin_named() -> None:
    there = Pose(-3.0, 1.0, 0.4)
    system = Touchline(RobotSetup(FIELD), TouchlineSettings(), np.random.default_rng(0))
    for k in range(20):  # found anywhere, at one of both ends, and walking, which confirms it
        place = Pose(there.x + 0.05 * k, there.y, there.heading)
        moved = Samples(
            np.array([100_000_000 * k]), np.array([[0.05 * k * math.cos(-0.4), 0.05 * k * math.sin(-0.4), 0.0]])
        )
        before = system.step(replace(frame(k, seen(place, k)), odometry=moved))
    assert before.status is Status.TRACKING
    assert before.end_probability == pytest.approx(0.5)
    for k in range(20, 30):
        system.step(lying(frame(k, seen(place, k)), 1.4))
    last = [system.step(lying(frame(k, seen(place, k)), 0.02)) for k in range(30, 46)][-1]
    assert last.status is Status.TRACKING
    assert last.end_probability == pytest.approx(0.5)
    assert any(one.pose.distance_to(last.pose.mirrored()) < 0.1 for one in last.hypotheses)


def test_a_lean_of_a_walking_robot_is_no_fall() -> None:
    system = started(Pose(-3.0, 1.0, 0.4))
    for k in range(4, 20):
        estimate = system.step(lying(frame(k, seen(Pose(-3.0, 1.0, 0.4), k)), math.radians(20.0) * (-1) ** k))
        assert estimate.status is Status.TRACKING


def test_a_localizer_takes_what_the_referee_says() -> None:
    localizer = Localizer("msl-18x12")
    localizer.reset((-3.0, 1.0, 0.4))
    localizer.add_game_state(0, "playing", "pushing")
    localizer.add_game_state(0, "half-time")
    points = seen(Pose(-3.0, 1.0, 0.4), 1)
    estimate = localizer.localize(100_000_000, points=points)
    assert estimate.reason == "penalised: pushing"
    assert "game-state-unusable" in codes_of(estimate)
    localizer.reset(state="back from a penalty")
    assert localizer.localize(200_000_000, points=points).pose.distance_to(Pose(-3.0, 1.0, 0.4)) < 0.2


def test_a_simulated_match_is_recorded_with_its_referee(tmp_path: Path) -> None:
    changes = ("game.half_s=12", "game.every_s=1", "camera.rate_hz=2")
    match = Simulation(open_scenario("match-day", 3, 100.0, changes), "points")
    write_recording(match, tmp_path / "match")
    recorded = open_source(tmp_path / "match")
    said = [state for one in recorded for state in one.game]
    assert [replace(state, penalty="") for state in said] == [
        replace(state, penalty="") for one in match for state in one.game
    ]
    assert {state.phase for state in said} >= {"initial", "ready", "set", "playing", "finished"}
    assert any(state.penalty for state in said)
    assert not all(state.first_half for state in said)
    assert main(["convert", str(tmp_path / "match"), str(tmp_path / "match.mcap")]) == 0
    assert [state for one in open_source(tmp_path / "match.mcap") for state in one.game] == said


def test_a_new_process_goes_on_where_the_robot_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Told its end once, killed in play, a second process finds its pose and its end with the first images."""
    place, path, now_s = Pose(2.0, 1.0, 0.3), tmp_path / "robot.json", [1.7e9]
    monkeypatch.setattr("touchline.live.state_file.time.time", lambda: now_s[0])
    assert "from now on" in resume(path, Localizer("msl-18x12"))
    first = Localizer("msl-18x12")
    first.reset(place)
    kept = StateFile(path, first)
    for k in range(1, 5):
        kept.take(first.localize(100_000_000 * k, points=seen(place, k)))
    kept.close()
    assert [one.name for one in tmp_path.iterdir()] == ["robot.json"]
    second, now_s[0] = Localizer("msl-18x12"), now_s[0] + 4.6
    assert "goes on from 5 s ago, x 2.00 m, y 1.00 m" in resume(path, second)
    walked_on = Pose(2.6, 1.3, 0.6)
    found = [second.localize(100_000_000 * k, points=seen(walked_on, k)) for k in range(50, 62)]
    tracked = [estimate for estimate in found if estimate.status is Status.TRACKING]
    assert len(tracked) >= 5
    assert all(errors(estimate, walked_on)[0] < 0.1 for estimate in tracked)
    assert (tracked[-1].end_probability or 0.0) > 0.9
    assert second.camera_errors is not None


def killed_in_play(path: Path, place: Pose, now_s: list[float]) -> None:
    """A state of 0.4 s, written by a process whose odometry began at (4, 1, 0)."""
    first = Localizer("msl-18x12")
    first.reset(place)
    kept = StateFile(path, first)
    for k in range(1, 5):
        first.add_odometry(100_000_000 * k, 4.0, 1.0, 0.0)
        estimate = first.localize(100_000_000 * k, points=seen(place, k))
        kept.take(estimate, estimate.pose.compose(Pose(4.0, 1.0, 0.0).inverse()))
    kept.close()
    now_s[0] += 6.6  # the first image has waited for two seconds, while code was loaded


@pytest.mark.parametrize(("origin", "tracked"), [((4.0, 1.0), True), ((0.0, 0.0), False)])
def test_odometry_that_goes_on_leads_a_new_process(
    origin: tuple[float, float], tracked: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It has driven to the other half and turned round meanwhile; where odometry has begun anew, its end is open."""
    place, moved, path, now_s = Pose(2.0, 1.0, 0.3), Pose(-4.5, 1.0, 2.6), tmp_path / "robot.json", [1.7e9]
    monkeypatch.setattr("touchline.live.state_file.time.time", lambda: now_s[0])
    killed_in_play(path, place, now_s)
    second, now = Localizer("msl-18x12"), place.compose(moved)
    resume(path, second)
    x, y = origin[0] + tracked * moved.x, origin[1] + tracked * moved.y
    found = []
    for k in range(50, 60):
        second.add_odometry(100_000_000 * k, x, y, tracked * moved.heading)
        found.append(second.localize(100_000_000 * k, points=seen(now, k)))
    assert all(errors(estimate, now)[0] < 0.1 for estimate in found if estimate.status is Status.TRACKING)
    assert (found[5].status is Status.TRACKING) is tracked
    assert tracked or found[-1].reason == "which end of the field is open"


def test_a_robot_with_a_detector_of_its_own_goes_on(tmp_path: Path) -> None:
    """No camera is described: what was learned of a perspective one is known before the first crossing."""
    first, path = Localizer("hsl-s-9x6"), tmp_path / "robot.json"
    first.reset((-2.5, 1.0, 0.0))
    kept = StateFile(path, first)
    robot = Simulation(open_scenario("match-day", 3, 2.0), "points")
    for k in range(len(robot)):
        seen_by_it = robot.features(k)
        kept.take(first.localize(seen_by_it.stamp_ns, observation=seen_by_it))
    kept.close()
    learned, second = first.camera_errors, Localizer("hsl-s-9x6")
    assert learned is not None
    assert second.camera_errors is not None
    assert len(second.camera_errors) != len(learned)
    resume(path, second)
    assert len(second.camera_errors) == len(learned)


def test_the_older_a_state_is_the_less_it_tells() -> None:
    known = [{"pose": [1.0, 2.0, 0.3], "covariance": np.diag([0.01, 0.01, 0.001]).tolist(), "probability": 0.98}]
    young, old = prior_of(known, 2.0), prior_of(known, 1800.0)
    assert young.rest < 0.2 < 0.8 < old.rest
    stood, slowly, fast = (math.sqrt(one.covariance[0, 0]) for one in young.poses)
    assert stood < 0.15
    assert 0.4 < slowly < 1.0
    assert 3.0 < fast < 5.0


def test_a_state_that_is_none_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "robot.json"
    for text in ("", "{}", '{"field": "msl-18x12", "unix_s": 0, "poses": [3], "camera_errors": null}', "[" * 100_000):
        path.write_text(text)
        with pytest.raises(InputError, match="is no state of"):
            resume(path, Localizer("msl-18x12"))
    with pytest.raises(InputError, match="cannot be written"):
        resume(tmp_path / "nowhere" / "robot.json", Localizer("msl-18x12"))
    assert main(["live", "udp", "--field", "msl-18x12", "--seconds", "0", "--state", str(path)]) == 2


def made_up(names: int, k: int, place: Pose) -> tuple[Evidence, ...]:
    x, y, _ = place.mirrored()
    half = [Evidence(f"no {n} {k}", 0.99, own_half=x < 0.0, known=False) for n in range(names)]
    return (*half, *(Evidence(f"nobody {n}", 0.999, place_m=(x, y), known=False) for n in range(names)))


@pytest.mark.parametrize("names", [5, 200])
def test_no_number_of_unknown_names_turns_a_pose(names: int) -> None:
    place = Pose(2.0, 1.0, 0.3)
    system = started(place)
    for k in range(4, 60):
        estimate = system.step(replace(frame(k, seen(place, k)), evidence=made_up(names, k, place)))
        assert errors(estimate, place)[0] < 0.1
        assert estimate.status is Status.TRACKING
    assert len(system.end._said) <= 50
    mate = Evidence("the keeper", 0.999, own_half=False)
    ball = Evidence("the ball", 0.99, own_half=False)
    twin = started(place.mirrored())
    turned = [twin.step(replace(frame(k, seen(place, k)), evidence=(mate, ball))) for k in range(4, 60)]
    assert errors(turned[-1], place)[0] < 0.1  # but two who are known correct a wrong start


def test_a_message_counts_once_and_a_sender_does_not_fill_the_queue() -> None:
    localizer = Localizer("msl-18x12")
    for message in (1, 1, 2, 2):
        localizer.add_evidence("mate", 0.9, own_half=True, message=message)
    assert [one.message for one in localizer._said] == [1, 2]
    for k in range(500):
        localizer.add_evidence(f"flood {k}", 0.99, own_half=False, known=False)
    for _ in range(9):
        localizer.add_evidence("keeper", 0.9, own_half=True)
    sources = [one.source for one in localizer._said]
    assert (len(sources), sources.count("keeper"), sources.count("mate")) == (100, 4, 2)


@pytest.mark.parametrize("waits", [0, 3])
def test_images_that_wait_for_the_processor_are_no_clock_that_was_set(waits: int) -> None:
    """The samples that came while they waited are the next ones'."""
    localizer, place, waiting = Localizer("msl-18x12"), Pose(-3.0, 1.0, 0.0), []
    localizer.reset(place)
    for k in range(40):
        there = Pose(place.x + 0.12 * k, 1.0, 0.0)
        localizer.add_odometry(100_000_000 * k, 0.12 * k, 0.0, 0.0)
        waiting.append((100_000_000 * k, seen(there, k), there, localizer.samples_come))
        if k > 10 + waits or k < 10:
            stamp_ns, points, truth, samples = waiting.pop(0)
            estimate = localizer.localize(stamp_ns, points=points, samples=samples)
            assert estimate.status is Status.TRACKING
            assert errors(estimate, truth)[0] < 0.1


def test_a_team_turns_the_robot_that_was_given_the_wrong_end() -> None:
    path = Path(__file__).parents[1] / "examples" / "three_robots.py"
    spec = importlib.util.spec_from_file_location("three_robots", path)
    assert spec is not None
    assert spec.loader is not None
    example = importlib.util.module_from_spec(spec)
    sys.modules["three_robots"] = example  # where its named tuple looks
    spec.loader.exec_module(example)
    off_m = example.play(flipped=1, seconds=12.0)
    assert off_m[1][2] > 1.0
    assert all(errors_m[-1] < 0.3 for errors_m in off_m)


def test_datagrams_of_the_team_and_the_referee() -> None:
    said = Datagrams().read(b'{"kind": "evidence", "source": "mate", "own_half": true, "message": 7}')
    assert isinstance(said, Evidence)
    assert said.message == 7
    state = Datagrams().read(b'{"kind": "game_state", "stamp_ns": 5, "phase": "set", "penalty": "pushing"}')
    assert state == GameState(5, "set", "pushing")
    wrong = Datagrams()
    for text in (b'"phase": "half"', b'"phase": "set", "penalty": 3', b'"phase": "set", "first_half": "yes"'):
        assert wrong.read(b'{"kind": "game_state", "stamp_ns": 5, ' + text + b"}") is None
    assert wrong.read(b'{"kind": "evidence", "source": "mate", "own_half": true, "message": "7"}') is None
    assert sum(wrong.refused.values()) == 4
