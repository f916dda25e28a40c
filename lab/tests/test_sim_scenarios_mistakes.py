"""Scenarios with mistakes, and the command."""

from __future__ import annotations

from pathlib import Path

import pytest
from simulated import content, scenario_file, shortened
from syrupy.assertion import SnapshotAssertion

from touchline.cli import main
from touchline.errors import InputError
from touchline.field import open_field
from touchline.types import Frame
from touchline_lab.simulation.recording import write_recording
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

MISTAKES = (
    "secondss: 3",
    "motion: {kind: match, sped_m_s: 2}",
    "motion: {kind: fly}",
    "motion: {kind: stand, sway_deg: 2}",
    "motion: {kind: waypoints}",
    "camera: {rate_hz: 0}",
    "disturbances: {kidnap_every_s: 0.3}",
    "sensors: {odometry: {base: tracks}}",
    "motion: {kind: stand, pose: [40, 0, 0]}",
    "motion: {kind: tour, margin_m: 7}",
    "field: msl-18x21",
    "seconds: 0.01",
    "camera: {kind: omni, file: nowhere.yaml}",
    "camera: {mirror: {profile: hyperbolic, horizon_px: 20}}",
    "light: {lamps: -1}",
    "seconds: [",
    "",
    "[1, 2]",
    "seed: 1.5",
    "seconds: .nan",
    "seed: 3\nseconds: true",
    "seed: yes",
    "motion:\n  kind: stand\n  pose: [0, on, 0]",
    "seconds: 3\nseed: 1\nseconds: 4",
    "motion:\n  kind: match\n  kind: stand",
    "others:\n  robots: -1\ncamera:\n  rate_hz: 0",
    "name: ../elsewhere",
    "motion: {kind: stand, pose: [0, 0]}",
    "light: {changes: [{time: 1}]}",
    "light: {changes: [{time_s: 1, row: 9, lamps: 0}]}",
    "light: {changes: [{time_s: 1, row: 1}]}",
    "light: {sun: 3}",
    "camera: {kind: pinhole, mirror: {profile: hyperbolic}}",
    "camera: {mirror: {horizon_px: 150}}",
    "camera: {mirror: {tilt_deg: [80, 0]}}",
    "camera: {delay_s: 0.1, delay_spread_s: 0.2}",
    "disturbances: {shove_m: [0.3, 0.1]}",
    "disturbances: {kidnap_every_s: 5, kidnap_to: [[50, 0, 0]]}",
    "{motion: {kind: stand}, disturbances: {shove_every_s: 1, shove_m: [8, 9]}}",
    "{ideal: true, others: {near_m: 2}}",
    "sensors: {imu: {gyro_bias_deg_s: [0.5, 0.2]}}",
    "sensors: {wheels: {a_dir_rad: 0.5, b_dir_rad: 0.5}}",
    "{one: 1, two: 2, three: 3, four: 4, five: 5, six: 6}",
)


class TestMistakes:
    def test_a_mistake_of_the_command_line_is_not_put_down_to_the_file(self) -> None:
        with pytest.raises(InputError, match=r"^setting 'others.robots': input should be .* \(got -1\)"):
            open_scenario("match", changes=["others.robots=-1"])
        with pytest.raises(InputError, match=r"^setting 'seconds': input should be greater than 0"):
            open_scenario("match", seconds=0.0)
        with pytest.raises(InputError, match=r"^unknown setting 'other'"):  # the group is as wrong as what is in it
            open_scenario("match", changes=["other.robots=1"])

    def test_a_scenario_with_a_mistake_gives_one_clear_message(
        self, tmp_path: Path, snapshot: SnapshotAssertion
    ) -> None:
        told = {}
        for text in MISTAKES:
            with pytest.raises(InputError) as caught:
                Simulation(open_scenario(scenario_file(tmp_path, text)))
            told[text] = str(caught.value).replace(f"{tmp_path}/", "")
        assert not any("\n" in message for message in told.values())
        assert told == snapshot

    def test_a_mistake_in_a_change_of_a_key_is_not_told_as_the_file_s(self, tmp_path: Path) -> None:
        path = scenario_file(tmp_path, "seconds: 3\nmotion: {kind: stand}")
        with pytest.raises(InputError, match=r"^seconds: a number is wanted, not true or false"):
            open_scenario(path, changes=["seconds=true"])
        with pytest.raises(InputError, match=r"^setting 'seconds': input should be greater than 0"):
            open_scenario(path, seconds=0.0)

    def test_a_recording_that_was_not_simulated_holds_no_scenario(self, tmp_path: Path) -> None:
        (tmp_path / "sequence.yaml").write_text("format: 1\nname: recorded\n", encoding="utf-8")
        with pytest.raises(InputError, match="tells no scenario; only recordings that were simulated hold theirs"):
            open_scenario(tmp_path)

    def test_an_unknown_name_is_told_with_the_nearest_one(self) -> None:
        with pytest.raises(InputError, match="scenario 'mtch' is unknown; did you mean 'match'"):
            open_scenario("mtch")
        with pytest.raises(InputError, match="there is no such scenario file"):
            open_scenario("nowhere/match.yaml")


class TestCommand:
    @pytest.mark.slow
    def test_it_writes_a_recording_and_never_overwrites_one(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        arguments = [
            "simulate",
            "straight-tracks",
            "--output",
            str(tmp_path / "new"),
            "--seconds",
            "0.2",
            "--seed",
            "3",
        ]
        assert main(arguments) == 0
        assert "2 images" in capsys.readouterr().out
        before = content(tmp_path / "new")
        assert main(arguments) == 2
        assert "exists already and is not overwritten" in capsys.readouterr().err
        assert content(tmp_path / "new") == before

    @pytest.mark.slow
    def test_a_simulated_recording_is_made_again_from_its_own_folder(self, tmp_path: Path) -> None:
        for name in ("straight-tracks",):
            first, again = tmp_path / name, tmp_path / f"{name}-again"
            assert main(["simulate", name, "--output", str(first), "--seconds", "0.2", "--seed", "4"]) == 0
            assert main(["simulate", str(first), "--output", str(again)]) == 0
            assert content(first) == content(again)

    @pytest.mark.slow
    def test_single_keys_are_changed_from_the_command_line(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        arguments = ["simulate", "match", "--seconds", "0.2", "--output", str(tmp_path / "new")]
        assert main([*arguments, "--set", "others.robts=1"]) == 2
        assert "did you mean 'others.robots'" in " ".join(capsys.readouterr().err.split())
        assert main([*arguments, "--set", "others.robots=1", "--set", "camera.rate_hz=20"]) == 0
        assert "4 images" in capsys.readouterr().out
        assert open_scenario(tmp_path / "new").others.robots == 1

    def test_a_recording_that_is_interrupted_is_taken_away(self, tmp_path: Path) -> None:
        def stop(frame: Frame) -> None:
            raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            write_recording(shortened("straight-tracks", 0.3), tmp_path / "new", stop)
        assert not (tmp_path / "new").exists()

    def test_files_named_in_a_scenario_are_found_beside_it(self, tmp_path: Path) -> None:
        open_field("indoor-9x6").to_yaml(tmp_path / "hall.yaml")
        simulation = Simulation(open_scenario(scenario_file(tmp_path, "{seconds: 1, field: hall.yaml}")), "points")
        assert simulation.field.length == 9.0

    def test_a_mistake_ends_with_status_2_and_no_folder(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        path = scenario_file(tmp_path, "motion: {kind: stand, pose: [40, 0, 0]}")
        assert main(["simulate", str(path), "--output", str(tmp_path / "new")]) == 2
        message = capsys.readouterr().err
        assert "mine.yaml: motion: the robot can't go to 40, 0: that is outside the carpet" in " ".join(message.split())
        assert not (tmp_path / "new").exists()
