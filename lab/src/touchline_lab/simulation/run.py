"""One run of a scenario, frame by frame: as a source like a recording, or live, with the camera's exposure in hand."""

import math
from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from touchline.camera import Camera, OmniCamera, camera_from_mapping, require_omni
from touchline.errors import InputError
from touchline.field import FieldModel, open_field
from touchline.geometry import FloatArray, IntArray, Pose
from touchline.sources import ProblemLog, Truth
from touchline.sources.folder import known_columns
from touchline.types import Frame, GameState, ImageArray, LinePoints, Observation, Samples
from touchline_lab.simulation.cameras.factory import SimulatedCamera, base_motion, open_simulated_camera
from touchline_lab.simulation.cameras.head import draw_head, known_camera
from touchline_lab.simulation.cameras.omni import SimulatedOmniCamera, omni_mapping
from touchline_lab.simulation.observation.feature_noise import PINHOLE_FEATURES, FeatureNoise
from touchline_lab.simulation.observation.features import ObservedFeatures, turned
from touchline_lab.simulation.observation.observed_lines import (
    NUBOT_PATHS,
    BuiltCamera,
    ObservedLines,
    ScanPaths,
    leaning_view,
)
from touchline_lab.simulation.observation.point_errors import ObservationNoise
from touchline_lab.simulation.robot.match import referee_says
from touchline_lab.simulation.robot.motions import make_track
from touchline_lab.simulation.robot.others import bodies_at, make_others
from touchline_lab.simulation.robot.sensors import arrived_by, simulate_sensors
from touchline_lab.simulation.robot.track import STEP_S
from touchline_lab.simulation.scenario import Scenario
from touchline_lab.simulation.sequence import describe
from touchline_lab.simulation.stage import PERSON_PARTS, body_parts, make_world
from touchline_lab.simulation.world.calibration_layout import make_layout
from touchline_lab.simulation.world.hall import beside_lines
from touchline_lab.simulation.world.world import World, WorldState

LEVELS = ("images", "points")
_BALL = (0.11, 0.22)
_PERSON_SIZES = np.array([*PERSON_PARTS, (0.0, 0.0)])
_PINHOLE_REACH_M = 6.5
_PINHOLE_NOISE = ObservationNoise(noise_px=0.3, lean_noise_rad=math.radians(PINHOLE_FEATURES.lean_deg), height_m=1.1)


class Eyes(NamedTuple):
    """Who looks through a mirror at the observation level: where, how well, and what the points are read with.

    noise: none: as the scenario says. known: none: the simulation's own `camera`.
    """

    paths: ScanPaths = NUBOT_PATHS
    noise: ObservationNoise | None = None
    known: OmniCamera | None = None


class Simulation:
    """A source of frames like a `touchline.sources.Recording` that are made while they are asked for.

    Every pass over it gives the same frames again, unless the exposure is set otherwise on the way:

        for frame in simulation:            # 1. see
            simulation.set(8.0, 2.0)        # 2. the next image is taken with 8 ms and gain 2
            image = simulation.grab()       # or look again at once, while the robot waits

    level: `images` renders, `points` gives line points as perception would, at a hundredth of the time.
    image_stamps, arrival_stamps: int64 (N,) (ns); track, others, sensors, world: what the run is made of.
    """

    def __init__(
        self,
        scenario: Scenario,
        level: str = "images",
        feature_noise: FeatureNoise | None = None,
        eyes: Eyes | None = None,
    ) -> None:
        """Raises InputError, in one message, for whatever is wrong with the scenario.

        feature_noise: of a perspective camera's features at the observation level; none: as fitted to the detector.
        eyes: of a mirror, instead of NuBot's detector.
        """
        if level not in LEVELS:
            raise InputError(f"level '{level}' is unknown; known: {', '.join(LEVELS)}")
        self.scenario, self.level, self.name = scenario, level, scenario.name
        self.rate_hz, self.camera_kind = scenario.camera.rate_hz, scenario.camera.kind
        self.camera_file: Path | None = None  # a run has no files
        self.problems = ProblemLog()  # and nothing about it is ever odd
        wheels = scenario.sensors.wheels
        self.wheel_directions_rad = wheels.a_dir_rad, wheels.b_dir_rad
        self.field: FieldModel = open_field(scenario.field)
        streams = scenario.streams()
        self.track = make_track(scenario, self.field, streams["motion"])
        self.others = make_others(scenario, self.field, self.track, streams["others"])
        self.sensors = simulate_sensors(self.track, scenario.sensors, streams["sensors"])
        self.start = self.track.pose_at(0.0)
        self.layout = make_layout(scenario.calibration.kind, scenario.calibration.regions, self.start)
        self.world: World = make_world(scenario, self.field, self.others, self.layout)
        self.head = draw_head(scenario.camera, self.track, streams["camera"])
        self.camera_model: SimulatedCamera = open_simulated_camera(scenario.camera, self.head.mount)
        self.image_times_s = _image_times(scenario, self.track.poses)
        taken: IntArray = np.rint(self.image_times_s * 1e9).astype(np.int64)
        self.arrival_stamps = _arrivals(scenario, taken, streams["delays"])
        self.image_stamps = self.arrival_stamps if scenario.camera.stamped == "arrived" else taken
        self._black_rad = np.radians(np.array(scenario.camera.black_sectors_deg, dtype=np.float64).reshape(-1, 2))
        self._feature_noise, self._eyes = feature_noise, eyes or Eyes()
        self._index = 0
        self._grabs = 0
        self.exposure_ms, self.gain = scenario.camera.exposure_ms, scenario.camera.gain

    @cached_property
    def sequence(self) -> Mapping[str, Any]:
        """What sequence.yaml would say."""
        return describe(self.scenario, self.track.events, self.layout, self.camera_model)

    @property
    def events(self) -> tuple[Mapping[str, Any], ...]:
        """What happens, each with t and kind. For evaluation only."""
        return tuple(self.sequence["events"])

    @cached_property
    def camera(self) -> Camera:
        """The camera as camera.yaml tells it: without what nobody knows of its mirror's lean and displacement."""
        return camera_from_mapping(self.camera_yaml, Path(f"{self.name}, camera"))

    @cached_property
    def camera_yaml(self) -> dict[str, Any]:
        """The mapping that a recording's camera.yaml holds."""
        if isinstance(self.camera_model, SimulatedOmniCamera):
            return omni_mapping(known_camera(self.scenario.camera, self.head, self.camera_model))
        return self.camera_model.design.mapping()

    @cached_property
    def truth(self) -> Truth:
        """The true poses at the images' stamps. For evaluation only."""
        late = self.image_stamps is self.arrival_stamps
        return Truth(self.image_stamps, self.track.poses_at(1e-9 * self.image_stamps) if late else self._poses)

    @cached_property
    def _poses(self) -> FloatArray:
        """(N, 3) the true poses where the images were taken."""
        return self.track.poses_at(self.image_times_s)

    def __len__(self) -> int:
        return len(self.image_stamps)

    def __iter__(self) -> Iterator[Frame]:
        self.set(self.scenario.camera.exposure_ms, self.scenario.camera.gain)
        for index in range(len(self)):
            yield self.frame(index)

    def set(self, exposure_ms: float, gain: float) -> None:
        """Take the following images with this exposure. Raises InputError for numbers that are no exposure."""
        if not (0.0 < exposure_ms <= 1000.0 and 0.0 < gain <= 1000.0):
            raise InputError(f"exposure {exposure_ms:g} ms, gain {gain:g}: both have to be above 0 and at most 1000")
        self.exposure_ms, self.gain = float(exposure_ms), float(gain)

    def grab(self) -> ImageArray:
        """Another image from where the robot is, with the exposure set now; time and robot stand still meanwhile."""
        self._grabs += 1
        return self.image(self._index, self._grabs)

    def frame(self, index: int) -> Frame:
        """One frame by its index, with all samples that arrived since the frame before."""
        index = range(len(self))[index]  # from the end, too
        self._index, self._grabs = index, 0
        odometry, wheels, imu = (
            Samples(log.stamp_ns[new], log.values[new]) if new.stop > new.start else None
            for log, new in zip(
                self.sensors, (slice(*ends[index : index + 2]) for ends in self._sample_ends), strict=True
            )
        )
        images, stamp_ns = self.level == "images", int(self.image_stamps[index])
        said = slice(*np.searchsorted(self._said_ns, [self.image_stamps[index - 1] if index else 0, stamp_ns], "right"))
        return Frame(
            stamp_ns=stamp_ns,
            image=self.image(index) if images else None,
            observation=None if images else Observation(stamp_ns, self.points(index)),
            odometry=odometry,
            wheels=wheels,
            gyro=known_columns(imu, 3, 6),
            compass=known_columns(imu, 2, 3),
            tilt=known_columns(imu, 0, 2),
            exposure_ms=self.exposure_ms if images else None,
            gain=self.gain if images else None,
            game=self.game_states[said],
            name=image_name(index),
        )

    @cached_property
    def game_states(self) -> tuple[GameState, ...]:
        """What the referee says in a match."""
        match, game = self.track.match, self.scenario.game
        return referee_says(match, self.scenario.seconds, game.missed_ready) if game.half_s else ()

    @cached_property
    def _said_ns(self) -> list[int]:
        return [said.stamp_ns for said in self.game_states]

    @cached_property
    def _covered(self) -> list[bool]:
        return [self.track.covered_at(float(time_s)) for time_s in self.image_times_s]

    @cached_property
    def _sample_ends(self) -> tuple[list[int], ...]:
        """Of odometry, wheels and IMU how many samples have arrived before the first image and with each."""
        return tuple(arrived_by(log, self.arrival_stamps) for log in self.sensors)

    def image(self, index: int, again: int = 0) -> ImageArray:
        """The image of one frame, uint8 (H, W, 3) BGR, with the exposure set now. again: for another noise."""
        time_s, track, camera = float(self.image_times_s[index]), self.track, self.scenario.camera
        rng = np.random.default_rng([self.scenario.seed, 5, index, again])
        pose, motion = track.pose_at(time_s), None
        if camera.motion_blur or camera.rolling_shutter_ms > 0.0:
            motion = base_motion(track.velocity_at(time_s), pose.heading, track.leaning_at(time_s))
        exposure = self.exposure_ms, self.gain
        return self.camera_model.render(
            self.world, self.state(time_s), pose, track.attitude_at(time_s), *exposure, rng, motion
        )

    def state(self, time_s: float) -> WorldState:
        """Where everything that moves is at a time."""
        robots, balls = self.others.at(time_s)
        return WorldState(
            time_s,
            [(float(x), float(y), float(heading)) for x, y, heading in robots],
            [(float(x), float(y)) for x, y in balls],
            self.track.covered_at(time_s),
            [(float(start), float(end)) for start, end in self._black_rad],
            self.head.swing_at(time_s),
        )

    def points(self, index: int) -> LinePoints:
        """The line points of one frame at the observation level, whatever the run's own level is."""
        time_s = float(self.image_times_s[index])
        if self._covered[index]:
            return LinePoints.none()
        rng = np.random.default_rng([self.scenario.seed, 6, index])
        pose = Pose(*self._poses[index].tolist())
        swing = self.head.swing_at(time_s)
        return self._observed.observe(pose, rng, self._bodies(time_s), self._black_rad, swing)

    def features(self, index: int, pan_rad: float = 0.0) -> Observation:
        """Lines, crossings, posts and poles of one frame at the observation level, without its line points.

        pan_rad: by which the head is turned, to the left; what is seen is in the robot frame nevertheless.
        """
        time_s = float(self.image_times_s[index])
        if self.track.covered_at(time_s):
            return Observation(int(self.image_stamps[index]))
        rng = np.random.default_rng([self.scenario.seed, 9, index])
        pose, stamp_ns = Pose(*self._poses[index].tolist()), int(self.image_stamps[index])
        looking = Pose(pose.x, pose.y, pose.heading + pan_rad)
        seen = self._features.observe(looking, rng, self._bodies(time_s), self._black_rad, stamp_ns)
        return turned(seen, pan_rad) if pan_rad else seen

    @cached_property
    def _features(self) -> ObservedFeatures:
        camera = self.camera_model
        if isinstance(camera, SimulatedOmniCamera):
            return ObservedFeatures(self._observed.camera, self.field, view_rad=self._observed.view_rad)
        return ObservedFeatures(camera.design, self.field, self._feature_noise or PINHOLE_FEATURES)

    def _bodies(self, time_s: float) -> FloatArray:
        """(K, 4) x, y, radius, height of what hides lines: robots as cylinders one on another, and balls."""
        return bodies_at(self.others, time_s, self._body_sizes, _PERSON_SIZES)

    @cached_property
    def _body_sizes(self) -> FloatArray:
        return np.array([*body_parts(self.camera_kind), _BALL])

    @cached_property
    def _observed(self) -> ObservedLines:
        camera, seed = self.camera_model, self.scenario.seed
        if isinstance(camera, SimulatedOmniCamera):
            eyes = self._eyes
            mirror = eyes.known or require_omni(self.camera, "line points are computed for")
            beside = beside_lines(self.field) if self.scenario.hall.beside else None
            built = BuiltCamera(camera.project, camera.shift_by_swing, mirror)
            noise = self._point_noise
            return ObservedLines(camera.design, self.field, noise, eyes.paths, math.pi, seed, built, beside)
        design, kind = camera.design, self.scenario.camera.kind
        view = leaning_view(float(design.base_from_camera.translation_m[2]), design.fx, _PINHOLE_REACH_M)
        half = 0.5 * design.width / design.fx
        half_rad = half if kind == "fisheye" else math.atan(half)
        return ObservedLines(view, self.field, _PINHOLE_NOISE, view_rad=half_rad, seed=seed)

    @property
    def _point_noise(self) -> ObservationNoise | None:
        """Of points seen through a mirror; a scenario's own deviation stands for NuBot's, and adds to other eyes'."""
        noise, noise_px = self._eyes.noise, self.scenario.camera.line_noise_px
        if noise_px is None:
            return noise
        if noise is None:
            return ObservationNoise(noise_px=noise_px)
        more = max(noise_px**2 - ObservationNoise().noise_px ** 2, 0.0)
        return noise.model_copy(update={"noise_px": math.sqrt(noise.noise_px**2 + more)})


def image_name(index: int) -> str:
    """The file of an image in a recording."""
    return f"images/{index:06d}.jpg"


def _image_times(scenario: Scenario, poses: FloatArray) -> FloatArray:
    """Times of the images (s): even ones; where a calibration goes from pose to pose, the middle of each stand."""
    period_s = 1.0 / scenario.camera.rate_hz
    if scenario.calibration.kind in ("strip", "chessboard"):
        times = _middles_of_stands(poses)
        times = times[times <= scenario.seconds]
    else:
        times = period_s * np.arange(1, math.floor(scenario.seconds / period_s + 1e-6) + 1)
    if len(times) == 0:
        raise InputError(f"seconds: {scenario.seconds:g} s are too short for a single image")
    return np.round(times, 4)  # images.csv holds a tenth of a millisecond


def _arrivals(scenario: Scenario, taken: IntArray, rng: np.random.Generator) -> IntArray:
    """When images arrive (ns) that were taken at these stamps (N,); none overtakes another."""
    camera = scenario.camera
    delays_s = camera.delay_s + camera.delay_spread_s * rng.uniform(-1.0, 1.0, len(taken))
    arrivals = taken + np.rint(np.maximum(delays_s, 0.0) * 1e9).astype(np.int64)
    return np.maximum.accumulate(arrivals)


def _middles_of_stands(poses: FloatArray) -> FloatArray:
    still = np.concatenate(([False], (np.diff(poses, axis=0) == 0.0).all(axis=1), [False]))
    first = np.flatnonzero(~still[:-1] & still[1:])
    last = np.flatnonzero(still[:-1] & ~still[1:])
    long_enough = (last - first) * STEP_S > 0.3
    return 0.5 * STEP_S * (first + last)[long_enough]
