"""Scenarios with mistakes, and the command."""

from __future__ import annotations

from pathlib import Path

import pytest
from simulated import NAMES, content, scenario_file, shortened

from touchline.cli import main
from touchline.errors import InputError
from touchline.simulation.recording import write_recording
from touchline.simulation.run import Simulation
from touchline.simulation.scenario import Scenario, open_scenario


class TestMistakes:
    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("secondss: 3", r"mine.yaml: unknown setting 'secondss': did you mean 'seconds'"),
            (
                "motion: {kind: match, sped_m_s: 2}",
                r"unknown setting 'motion.sped_m_s': did you mean 'motion.speed_m_s'",
            ),
            ("motion: {kind: fly}", r"setting 'motion.kind'.*got 'fly'"),
            ("motion: {kind: stand, sway_deg: 2}", r"a motion of kind 'stand' does not use 'sway_deg'"),
            ("motion: {kind: waypoints}", r"motion.waypoints is empty"),
            ("camera: {rate_hz: 0}", r"setting 'camera.rate_hz'"),
            ("mishaps: {kidnap_every_s: 0.3}", r"kidnap_every_s is no longer than the 0.5 s that each kidnap takes"),
            ("sensors: {odometry: {base: tracks}}", r"base 'tracks' is unknown"),
            ("motion: {kind: stand, pose: [40, 0, 0]}", r"the robot can't go to 40, 0: that is outside the carpet"),
            ("motion: {kind: tour, margin_m: 7}", r"a margin of 7 m leaves nothing of the field"),
            ("field: msl-18x21", r"msl-18x21"),
            ("seconds: 0.01", r"too short for a single image"),
            ("camera: {kind: omni, file: nowhere.yaml}", r"nowhere.yaml: cannot be read"),
            ("camera: {mirror: {profile: hyperbolic, horizon_px: 20}}", r"mirror: no profile shows this range: at \d+"),
            ("light: {lamps: -1}", r"setting 'light.lamps'"),
            ("seconds: [", r"mine.yaml, line 2: is not valid YAML"),
        ],
    )
    def test_a_scenario_with_a_mistake_gives_one_clear_message(self, tmp_path: Path, text: str, message: str) -> None:
        with pytest.raises(InputError, match=message) as caught:
            Simulation(open_scenario(scenario_file(tmp_path, text)))
        assert "\n" not in str(caught.value)

    def test_an_unknown_name_is_told_with_the_nearest_one(self) -> None:
        with pytest.raises(InputError, match="scenario 'mtch' is unknown; did you mean 'match'"):
            open_scenario("mtch")
        with pytest.raises(InputError, match="there is no such scenario file"):
            open_scenario("nowhere/match.yaml")

    def test_an_unknown_level_and_points_as_recording_are_refused(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="level 'dots' is unknown"):
            Simulation(Scenario(), "dots")
        with pytest.raises(InputError, match="a recording holds images"):
            write_recording(Simulation(Scenario(seconds=1.0), "points"), tmp_path / "new")

    def test_a_pinhole_camera_is_no_omni_camera(self) -> None:
        with pytest.raises(InputError, match="at the level of points"):
            _ = shortened("humanoid-walk").camera


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

    def test_a_mistake_ends_with_status_2_and_no_folder(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        path = scenario_file(tmp_path, "motion: {kind: stand, pose: [40, 0, 0]}")
        assert main(["simulate", str(path), "--output", str(tmp_path / "new")]) == 2
        assert "outside the carpet" in capsys.readouterr().err
        assert not (tmp_path / "new").exists()
