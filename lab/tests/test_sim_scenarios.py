"""Every scenario runs, is written as a recording and localised; same seed, same bytes."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from line_profiles import line_offsets, projected_lines
from simulated import NAMES, content, errors_of, shortened

from touchline.geometry import Pose
from touchline.sources import open_source
from touchline.systems import RobotSetup, open_system
from touchline.types import Prior
from touchline_lab.simulation.cameras.perspective import SimulatedPerspectiveCamera
from touchline_lab.simulation.recording import write_recording
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario, scenario_names
from touchline_lab.simulation.stage import body_parts, body_size
from touchline_lab.simulation.world.world import RobotActor, robot_blocks

HUMANOID = ("chessboard", "humanoid-fisheye", "humanoid-walk", "walk-in-place")


class Recordings(dict[str, Path]):
    """Every scenario at reduced length, written when first asked for: no process writes what its tests do not need."""

    def __init__(self, parent: Path) -> None:
        super().__init__()
        self.parent = parent

    def __missing__(self, name: str) -> Path:
        self[name] = self.parent / name
        write_recording(shortened(name), self[name])
        return self[name]


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Recordings:
    return Recordings(tmp_path_factory.mktemp("simulated"))


class TestEveryScenario:
    def test_these_come_with_the_package(self) -> None:
        assert tuple(scenario_names()) == NAMES

    @pytest.mark.parametrize("name", NAMES)
    def test_its_recording_is_read_without_a_problem(self, recordings: Recordings, name: str) -> None:
        recording = open_source(recordings[name])
        frames = list(recording)
        assert len(frames) == len(recording) > 0
        assert [str(problem) for problem in recording.problems] == []
        assert all(frame.image is not None and frame.odometry is not None for frame in frames)
        assert recording.truth is not None
        assert recording.sequence["simulation"]["seed"] == 1

    @pytest.mark.parametrize(
        "name", [name for name in NAMES if name not in (*HUMANOID, "calibration-strip", "match-day")]
    )
    def test_nubot_mti_follows_the_robot_to_a_centimetre(self, recordings: Recordings, name: str) -> None:
        recording = open_source(recordings[name])
        errors = errors_of(recording, recording.camera)
        without = {"kidnap": 3, "worn-hall": 2}.get(
            name, 0
        )  # black images; among people the first ones tell too little
        assert len(errors) >= len(recording) - without - 1, "all but these, and at most one after them"
        assert np.mean(errors[:, 0]) < 0.012
        assert np.max(errors[:, 0]) < 0.04
        assert np.degrees(np.mean(errors[:, 1])) < 0.1

    @pytest.mark.parametrize("name", HUMANOID)
    def test_the_humanoids_images_show_the_lines_where_the_projection_says(
        self, recordings: Recordings, name: str
    ) -> None:
        recording, simulation = open_source(recordings[name]), shortened(name)
        camera = simulation.camera_model
        assert isinstance(camera, SimulatedPerspectiveCamera)
        measured = []
        for index in range(0, len(recording), 3):
            image = recording.image(index)
            assert image is not None
            lean = simulation.track.attitude_at(float(simulation.image_times_s[index]))
            project = partial(camera.project, attitude=lean)
            size = (camera.width, camera.height)
            places, normals, half, _ = projected_lines(project, recording.field, simulation.truth[index], size)
            measured.append(line_offsets(image, places, normals, half, 6.0))
        offsets = np.concatenate(measured)
        offsets = offsets[np.isfinite(offsets)]
        assert len(offsets) > 100
        assert np.median(np.abs(offsets)) < 0.15
        assert np.percentile(np.abs(offsets), 95) < 0.5

    @pytest.mark.parametrize("name", HUMANOID)
    def test_nubot_mti_follows_the_humanoid_at_the_level_of_points(self, name: str) -> None:
        simulation = Simulation(open_scenario(name, seconds=20.0), "points")
        system = open_system("nubot-mti", RobotSetup(simulation.field))
        system.reset(Prior(pose=simulation.start))
        errors = [
            system.step(frame).pose.distance_to(simulation.truth[index]) for index, frame in enumerate(simulation)
        ]
        assert np.median(errors) < 0.06


class TestDeterminism:
    def test_the_same_seed_gives_the_same_bytes_and_another_seed_another_run(self, tmp_path: Path) -> None:
        for folder, seed in (("one", 5), ("same", 5), ("other", 6)):
            write_recording(shortened("match", 0.3, seed), tmp_path / folder)
        one, same, other = (content(tmp_path / folder) for folder in ("one", "same", "other"))
        assert one == same
        assert one.keys() == other.keys()
        differing = {name for name in one if one[name] != other[name]}
        assert {"images/000000.jpg", "imu.csv", "odometry.csv", "wheels.csv", "ground_truth.tum"} <= differing
        assert {"field.yaml", "camera.yaml", "images.csv"} & differing == set()

    def test_a_second_pass_gives_the_same_frames(self) -> None:
        simulation = shortened("kidnap", 0.3)
        first, second = list(simulation), list(simulation)
        for one, other in zip(first, second, strict=True):
            assert one.image is not None
            assert other.image is not None
            np.testing.assert_array_equal(one.image, other.image)

    def test_a_frame_is_the_same_whatever_was_asked_for_before(self) -> None:
        simulation = shortened("match", 1.0)
        list(simulation)
        np.testing.assert_array_equal(simulation.image(1), shortened("match", 1.0).image(1))

    def test_the_live_samples_are_those_of_the_recording(self, recordings: Recordings) -> None:
        for live, read in zip(shortened("match"), open_source(recordings["match"]), strict=True):
            for sensor in ("odometry", "wheels", "gyro", "compass", "tilt"):
                one, other = getattr(live, sensor), getattr(read, sensor)
                np.testing.assert_array_equal(one.stamp_ns, other.stamp_ns)
                np.testing.assert_array_equal(one.values, other.values)


class TestOcclusionAndLight:
    def test_covered_images_are_black(self, recordings: Recordings) -> None:
        means = [frame.image.mean() for frame in open_source(recordings["kidnap"]) if frame.image is not None]
        assert max(means[17:20]) < 10.0
        assert min(means[:17] + means[20:]) > 20.0

    @pytest.mark.parametrize(
        ("name", "share"), [("occlusion-12", 0.125), ("occlusion-25", 0.25), ("occlusion-50", 0.5)]
    )
    def test_black_sectors_hide_their_share_of_every_image(self, name: str, share: float) -> None:
        simulation = shortened(name, 0.5)
        camera = simulation.camera
        v, u = np.mgrid[0 : camera.height, 0 : camera.width]
        ring = np.abs(np.hypot(u - camera.center[0], v - camera.center[1]) - 0.7 * camera.outer_radius_px) < 0.25 * 200
        for index in (0, 4):
            dark = simulation.image(index).max(axis=2)[ring] < 40
            assert np.mean(dark) == pytest.approx(share, abs=0.045)

    def test_the_three_lightings_differ_as_their_levels_do(self, recordings: Recordings) -> None:
        green = {
            name: float(np.median(open_source(recordings[name]).image(0)[..., 1]))  # type: ignore[index]
            for name in ("lighting-1", "lighting-2", "lighting-3")
        }
        assert green["lighting-2"] < 0.8 * green["lighting-1"]
        assert green["lighting-3"] > 1.05 * green["lighting-1"]

    def test_lamps_are_dimmed_and_switched_row_by_row_while_the_robot_drives(self) -> None:
        simulation = Simulation(open_scenario("light-changes", changes=["ideal=true"]))
        rows = sorted({lamp.y for lamp in simulation.world.lights.lamps})

        def levels(time_s: float) -> tuple[list[float], float, float]:
            lamps, sun, ambient = simulation.world.lights.levels(time_s)
            by_row = [lamps[[lamp.y == y for lamp in simulation.world.lights.lamps]] for y in rows]
            assert all(np.ptp(row) == 0.0 for row in by_row)
            return [float(row[0]) for row in by_row], sun, ambient

        assert levels(0.0) == ([1.0] * 4, 3.0, 0.35)
        assert levels(5.0)[0] == pytest.approx([0.65] * 4), "half way down"
        assert levels(12.9)[0] == [1.0] * 4
        assert levels(14.0)[0] == [1.0, 1.0, 1.0, 0.0]
        assert levels(22.0) == ([1.0] * 4, pytest.approx(0.3), 0.35)
        assert levels(26.0) == ([0.0] * 4, pytest.approx(0.3), 0.25)
        kinds = [(event["t"], event["kind"], event.get("row")) for event in simulation.events]
        assert kinds[2] == (13.0, "light_change", 3)
        near = simulation.camera_model
        green = [
            float(np.median(near.render(simulation.world, simulation.state(t), Pose(0.0, 0.0, 0.0))[..., 1]))
            for t in (3.9, 8.9, 9.1, 29.0)
        ]
        assert green[1] < 0.85 * green[0]
        assert green[2] == pytest.approx(green[0], rel=0.03)
        assert green[3] < 0.7 * green[0]


@pytest.mark.parametrize(("kind", "shape"), [("omni", "msl"), ("pinhole", "humanoid")])
def test_other_robots_hide_lines_up_to_where_their_bodies_reach(kind: str, shape: str) -> None:
    blocks = robot_blocks(RobotActor(0.0, 0.0, 0.0, *body_size(kind), shape=shape))
    tops = [top for _, top in body_parts(kind)]
    assert tops == sorted(tops)
    assert tops[-1] == pytest.approx(max(block.top for block in blocks))
    below = 0.0
    for radius, top in body_parts(kind):
        middle = 0.5 * (below + top)
        there = [block for block in blocks if block.bottom <= middle <= block.top]
        reach = np.array([(abs(b.x) + 0.5 * b.length, abs(b.y) + 0.5 * b.width) for b in there])
        assert 0.5 * reach.max() < radius < np.hypot(*reach.T).max(), "no broader than corner to corner"
        below = top
