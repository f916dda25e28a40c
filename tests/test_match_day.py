"""What a match does to a robot: the referee, penalties, falls, pick-ups, restarts, a team that lies."""

from __future__ import annotations

import math
import socket
from pathlib import Path

import numpy as np
import pytest
from fakes import codes_of
from line_scenes import errors, seen

from touchline.cli import main
from touchline.errors import InputError
from touchline.field import open_field
from touchline.geometry import Pose
from touchline.live.datagrams import Datagrams
from touchline.live.game_controller import GameController, WithGameController
from touchline.live.heard import Heard, Published
from touchline.live.state_file import StateFile, prior_of, resume
from touchline.localization.estimator.game_states import Referee
from touchline.localizer import Localizer
from touchline.types import Evidence, GameState, Prior, Status

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
    referee = Referee(open_field("msl-18x12"))

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


def test_messages_count_once_and_fill_no_queue() -> None:
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
def test_images_that_wait_are_no_clock_that_was_set(waits: int) -> None:
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
