"""Scenarios with mistakes, and the command."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from simulated import NAMES, content, scenario_file, shortened

from touchline.cli import main
from touchline.errors import InputError
from touchline.field import open_field
from touchline.systems import RobotSetup, open_system
from touchline.types import Frame
from touchline_lab.simulation.recording import write_recording
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import Scenario, open_scenario


class TestMistakes:
    def test_a_mistake_of_the_command_line_is_not_put_down_to_the_file(self) -> None:
        with pytest.raises(InputError, match=r"^setting 'others.robots': input should be .* \(got -1\)"):
            open_scenario("match", changes=["others.robots=-1"])
        with pytest.raises(InputError, match=r"^setting 'seconds': input should be greater than 0"):
            open_scenario("match", seconds=0.0)
        with pytest.raises(InputError, match=r"^unknown setting 'other'"):  # the group is as wrong as what is in it
            open_scenario("match", changes=["other.robots=1"])

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("secondss: 3", r"mine.yaml, line 1: unknown setting 'secondss': did you mean 'seconds'"),
            (
                "motion: {kind: match, sped_m_s: 2}",
                r"unknown setting 'motion.sped_m_s': did you mean 'motion.speed_m_s'",
            ),
            ("motion: {kind: fly}", r"setting 'motion.kind'.*got 'fly'"),
            ("motion: {kind: stand, sway_deg: 2}", r"a motion of kind 'stand' does not use 'sway_deg'"),
            ("motion: {kind: waypoints}", r"motion.waypoints is empty"),
            ("camera: {rate_hz: 0}", r"setting 'camera.rate_hz'"),
            (
                "disturbances: {kidnap_every_s: 0.3}",
                r"kidnap_every_s is no longer than the 0.5 s that each kidnap takes",
            ),
            ("sensors: {odometry: {base: tracks}}", r"base 'tracks' is unknown"),
            ("motion: {kind: stand, pose: [40, 0, 0]}", r"the robot can't go to 40, 0: that is outside the carpet"),
            ("motion: {kind: tour, margin_m: 7}", r"a margin of 7 m leaves nothing of the field"),
            ("field: msl-18x21", r"msl-18x21"),
            ("seconds: 0.01", r"too short for a single image"),
            ("camera: {kind: omni, file: nowhere.yaml}", r"nowhere.yaml: cannot be read"),
            ("camera: {mirror: {profile: hyperbolic, horizon_px: 20}}", r"mirror: no profile shows this range: at \d+"),
            ("light: {lamps: -1}", r"setting 'light.lamps'"),
            ("seconds: [", r"mine.yaml, line 2: is not valid YAML"),
            ("", r"mine.yaml: is empty; name at least the kind of motion"),
            ("[1, 2]", r"expected keys and values at the top level, found a list"),
            ("seed: 1.5", r"setting 'seed': input should be a valid integer"),
            ("seconds: .nan", r"setting 'seconds': input should be a finite number"),
            (
                "seed: 3\nseconds: true",
                r"mine.yaml, line 2: seconds: a number is wanted, not true or false \(got True\)",
            ),
            ("seed: yes", r"mine.yaml, line 1: seed: a number is wanted"),
            ("motion:\n  kind: stand\n  pose: [0, on, 0]", r"mine.yaml, line 3: motion.pose: a number is wanted"),
            ("seconds: 3\nseed: 1\nseconds: 4", r"mine.yaml, line 3: 'seconds' stands in line 1 already; keep one"),
            ("motion:\n  kind: match\n  kind: stand", r"mine.yaml, line 3: 'kind' stands in line 2 already; keep one"),
            (
                "others:\n  robots: -1\ncamera:\n  rate_hz: 0",
                r"line 2: setting 'others.robots'|line 4: setting 'camera.r",
            ),
            ("name: ../elsewhere", r"name: '../elsewhere' is no name of a folder"),
            ("motion: {kind: stand, pose: [0, 0]}", r"setting 'motion.pose.2': field required"),
            (
                "light: {changes: [{time: 1}]}",
                r"unknown setting 'light.changes.0.time': did you mean 'light.changes.0.time_s'",
            ),
            ("light: {changes: [{time_s: 1, row: 9, lamps: 0}]}", r"row 9 is unknown; there are rows 0 to 3"),
            ("light: {changes: [{time_s: 1, row: 1}]}", r"names a row of lamps but not its level"),
            ("light: {sun: 3}", r"light: the sun shines through windows, and there are none"),
            ("camera: {kind: pinhole, mirror: {profile: hyperbolic}}", r"camera: 'mirror' is not used: a pinhole"),
            ("camera: {mirror: {horizon_px: 150}}", r"profile 'combined' does not use 'horizon_px'"),
            ("camera: {mirror: {tilt_deg: [80, 0]}}", r"setting 'camera.mirror.tilt_deg.0'.*less than or equal to 10"),
            ("camera: {delay_s: 0.1, delay_spread_s: 0.2}", r"delay_spread_s \(0.2\) is more than delay_s \(0.1\)"),
            ("disturbances: {shove_m: [0.3, 0.1]}", r"disturbances.shove_m: is a range from low to high"),
            (
                "disturbances: {kidnap_every_s: 5, kidnap_to: [[50, 0, 0]]}",
                r"disturbances.kidnap_to: the robot can't go to 50, 0",
            ),
            (
                "{motion: {kind: stand}, disturbances: {shove_every_s: 1, shove_m: [8, 9]}}",
                r"a shove brings the robot to .* into a wall",
            ),
            ("{ideal: true, others: {near_m: 2}}", r"others: near_m needs moving: true"),
            ("sensors: {imu: {gyro_bias_deg_s: [0.5, 0.2]}}", r"gyro_bias_deg_s: is a range from low to high"),
            ("sensors: {wheels: {a_dir_rad: 0.5, b_dir_rad: 0.5}}", r"both wheels roll along the same line"),
            ("{one: 1, two: 2, three: 3, four: 4, five: 5, six: 6}", r"; and 2 more mistakes$"),
        ],
    )
    def test_a_scenario_with_a_mistake_gives_one_clear_message(self, tmp_path: Path, text: str, message: str) -> None:
        with pytest.raises(InputError, match=message) as caught:
            Simulation(open_scenario(scenario_file(tmp_path, text)))
        assert "\n" not in str(caught.value)

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

    def test_an_unknown_level_is_refused(self) -> None:
        with pytest.raises(InputError, match="level 'dots' is unknown"):
            Simulation(Scenario(), "dots")

    def test_a_system_for_mirrors_says_so_of_a_pinhole_camera(self) -> None:
        simulation = shortened("humanoid-walk")
        with pytest.raises(InputError, match=r"nubot-mti finds line points in images of an omnidirectional camera; "):
            open_system("nubot-mti", RobotSetup(simulation.field, simulation.camera))


class TestCommand:
    def test_it_lists_the_scenarios(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert main(["simulate"]) == 0
        printed = capsys.readouterr().out
        assert all(name in printed for name in NAMES)

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

    def test_a_simulated_recording_is_made_again_from_its_own_folder(self, tmp_path: Path) -> None:
        for name in ("humanoid-walk", "kidnap"):
            first, again = tmp_path / name, tmp_path / f"{name}-again"
            assert main(["simulate", name, "--output", str(first), "--seconds", "0.3", "--seed", "4"]) == 0
            assert main(["simulate", str(first), "--output", str(again)]) == 0
            assert content(first) == content(again)

    def test_single_keys_are_changed_from_the_command_line(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        arguments = ["simulate", "match", "--seconds", "0.2", "--output", str(tmp_path / "new")]
        assert main([*arguments, "--set", "others.robts=1"]) == 2
        assert "did you mean 'others.robots'" in " ".join(capsys.readouterr().err.split())
        assert main([*arguments, "--set", "others.robots=1", "--set", "camera.rate_hz=20"]) == 0
        assert "4 images" in capsys.readouterr().out
        assert open_scenario(tmp_path / "new").others.robots == 1

    def test_another_process_writes_the_same_bytes(self, tmp_path: Path) -> None:
        write_recording(shortened("match", 0.2), tmp_path / "here")
        command = [
            sys.executable,
            "-m",
            "touchline",
            "simulate",
            "match",
            "--seconds",
            "0.2",
            "--set",
            "ideal=true",
            "--output",
        ]
        subprocess.run([*command, str(tmp_path / "there")], check=True, capture_output=True)
        assert content(tmp_path / "here") == content(tmp_path / "there")

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

    @pytest.mark.parametrize(
        ("name", "seconds", "advised"),
        [
            ("match", "0.2", ["run"]),
            ("walk-in-place", "0.2", ["check"]),
            ("marked-points", "1.5", ["calibrate colour", "calibrate range", "run"]),
            ("calibration-strip", "3.5", ["run"]),  # too few directions for a calibration
        ],
    )
    def test_what_it_advises_works_with_the_recording(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, seconds: str, advised: list[str]
    ) -> None:
        folder = tmp_path / "new"
        assert main(["simulate", name, "--seconds", seconds, "--output", str(folder)]) == 0
        told = " ".join(capsys.readouterr().out.split()).split("touchline ")[1:]
        assert [sentence.split(f" {folder}")[0] for sentence in told] == advised
        suffixes = {"run": "", "calibrate colour": ".npz", "calibrate range": ".yaml"}
        for command in advised:
            new = tmp_path / f"{command.split()[-1]}{suffixes.get(command, '')}"
            output = [] if command == "check" else ["--output", str(new)]
            assert main([*command.split(), str(folder), *output]) == 0
