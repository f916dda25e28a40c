"""What both simulated cameras share: motion during the exposure, rolling shutter, occlusion, the image sensor."""

import math
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from touchline.geometry import BoolArray, Float32Array, FloatArray, Pose, tilt_rotation
from touchline.types import ImageArray
from touchline_lab.simulation.cameras.image_sensor import ImageSensor, check_exposure
from touchline_lab.simulation.rendering.rendering import RayGrid, Renderer
from touchline_lab.simulation.rendering.scene import Scene
from touchline_lab.simulation.world.world import World, WorldState


class Motion(NamedTuple):
    """How the robot moves while the image is taken: base frame, m/s and rad/s; and how fast its body leans over."""

    vx: float
    vy: float
    turn_rate: float
    roll_rate: float = 0.0
    pitch_rate: float = 0.0


class SimulatedCameraModel:
    """A camera on a robot in a world. Not thread-safe: buffers are reused from image to image.

    sensor: the exposure model. side: samples along each side of a pixel. blur_steps: instants over which
    the exposure is averaged where a motion is given. readout_s: rolling shutter, time from the first row to the last;
    0 is a global shutter. The time of an image is the middle of its exposure (of its middle row).
    """

    def __init__(
        self,
        make_grid: Callable[[], RayGrid],
        sensor: ImageSensor | None = None,
        side: int = 2,
        blur_steps: int = 5,
        readout_s: float = 0.0,
    ) -> None:
        """make_grid: what each pixel looks along; asked for with the first image, so that who wants none won't wait."""
        self.sensor = sensor or ImageSensor()
        self.blur_steps = blur_steps
        self.readout_s = readout_s
        self._make_grid, self._side = make_grid, side
        self._scene: Scene | None = None
        self._cover: tuple[Sequence[tuple[float, float]], BoolArray] | None = None

    @cached_property
    def _grid(self) -> RayGrid:
        return self._make_grid()

    @cached_property
    def _renderer(self) -> Renderer:
        return Renderer(self._grid, self._side)

    @property
    def width(self) -> int:
        """Columns of the image."""
        return self._grid.shape[1]

    @property
    def height(self) -> int:
        """Rows of the image."""
        return self._grid.shape[0]

    def bent_rays(self, swing_rad: tuple[float, float]) -> Float32Array | None:
        """(H, W, 6) by how much the rays differ where a mirror swings by so much about x and y; None: not at all."""
        return None

    def render(
        self,
        world: World,
        state: WorldState,
        robot_pose: Pose,
        attitude: tuple[float, float] = (0.0, 0.0),
        exposure_ms: float = 12.0,
        gain: float = 1.7,
        rng: np.random.Generator | None = None,
        motion: Motion | None = None,
    ) -> ImageArray:
        """The picture (H, W, 3) uint8 BGR from a pose (field frame) with a lean (roll, pitch) of the body.

        rng: of the noise; None leaves it out. motion: blurs (and skews, with rolling shutter); None is a still robot.
        Raises InputError for an exposure or gain that is not positive, and for a body or robot outside the hall.
        """
        check_exposure(exposure_ms, gain)
        if state.covered:
            radiance = np.zeros((self.height, self.width, 3), dtype=np.float32)
        else:
            radiance = self.radiance(world, state, robot_pose, attitude, motion, exposure_ms)
        return self.sensor.develop(radiance, exposure_ms, gain, rng)

    def radiance(
        self,
        world: World,
        state: WorldState,
        robot_pose: Pose,
        attitude: tuple[float, float] = (0.0, 0.0),
        motion: Motion | None = None,
        exposure_ms: float = 12.0,
    ) -> Float32Array:
        """Linear radiance (H, W, 3) float32, red green blue, before blur and sensor; see `render`.

        exposure_ms: over which a motion is averaged. The array is overwritten by the next call.
        """
        world.check_inside("the robot", robot_pose.x, robot_pose.y)
        if self._scene is None or self._scene.world is not world:
            self._scene = Scene(world)
        self._scene.update(state)
        self._renderer.bend(self.bent_rays(state.mirror_swing_rad))
        if motion is None:
            poses = field_from_body(robot_pose, attitude)[np.newaxis]
            image = self._renderer.render(self._scene, poses)
        else:
            image = self._blurred(self._scene, robot_pose, attitude, exposure_ms, motion)
        self._occlude(image, state)
        return image

    def paint_ratio(
        self, world: World, state: WorldState, robot_pose: Pose, attitude: tuple[float, float] = (0.0, 0.0)
    ) -> tuple[Float32Array, Float32Array]:
        """`radiance` of a still robot, and how much of each pixel's light (H, W) comes from the field's lines."""
        whole = self.radiance(world, state, robot_pose, attitude).copy()
        assert self._scene is not None
        white = self._scene.paints[0].copy()
        self._scene.paints[0] = 0.0
        bare = self.radiance(world, state, robot_pose, attitude)
        self._scene.paints[0] = white
        ratio = (whole[..., 1] - bare[..., 1]) / np.maximum(whole[..., 1], np.float32(1e-9))
        return whole, ratio.astype(np.float32)

    def _blurred(
        self, scene: Scene, pose: Pose, attitude: tuple[float, float], exposure_ms: float, motion: Motion
    ) -> Float32Array:
        steps = max(1, self.blur_steps)
        rows = self.height if self.readout_s > 0.0 else 1
        delays = (np.arange(rows) / max(rows - 1, 1) - 0.5) * self.readout_s if rows > 1 else np.zeros(1)
        total = np.zeros((self.height, self.width, 3), dtype=np.float32)
        for step in range(steps):
            instant = ((step + 0.5) / steps - 0.5) * 1e-3 * exposure_ms
            poses = np.stack([_body_at(pose, attitude, motion, instant + float(delay)) for delay in delays])
            total += self._renderer.render(scene, poses)
        total /= np.float32(steps)
        return total

    def _occlude(self, image: Float32Array, state: WorldState) -> None:
        """A dark cover over directions of the base frame."""
        if not state.occluded_rad:
            return
        if self._cover is None or self._cover[0] != state.occluded_rad:
            self._cover = state.occluded_rad, self._covered(state.occluded_rad)
        image[self._cover[1]] = 0.0

    def _covered(self, occluded_rad: Sequence[tuple[float, float]]) -> BoolArray:
        """(H, W) the pixels that see nothing but the cover."""
        bearings = np.arctan2(self._grid.rays[..., 4], self._grid.rays[..., 3]).astype(np.float64)
        covered = np.zeros(bearings.shape, dtype=np.bool_)
        for start, end in occluded_rad:
            covered |= np.mod(bearings - start, 2.0 * math.pi) <= (end - start) % (2.0 * math.pi)
        return covered


def _body_at(pose: Pose, attitude: tuple[float, float], motion: Motion, time_s: float) -> FloatArray:
    """Where the body is and how it leans after a time of constant motion, (12,)."""
    roll, pitch = attitude[0] + motion.roll_rate * time_s, attitude[1] + motion.pitch_rate * time_s
    return field_from_body(moved(pose, motion, time_s), (roll, pitch))


def with_glare(layer: Float32Array, rays: Float32Array) -> Float32Array:
    """Lay a glare over a camera's fixed layer (H, W, 4), in place: seen from above, the carpet's pile glistens.

    rays (H, W, 6): body frame. 2 % white at 0.6 m, a third of that for each further metre, as in the recordings.
    """
    falling = rays[..., 5] < -1e-3
    level = np.hypot(rays[..., 3], rays[..., 4])
    distance = np.where(falling, level * rays[..., 2] / np.where(falling, -rays[..., 5], 1.0), np.inf)
    glare = 0.036 * np.exp(-distance)
    layer += ((1.0 - layer[..., 3]) * np.where(glare > 0.003, glare, 0.0))[..., np.newaxis]
    return layer


def field_from_body(pose: Pose, attitude: tuple[float, float] = (0.0, 0.0)) -> FloatArray:
    """Rz(heading) Ry(pitch) Rx(roll) by rows and the translation, (12,)."""
    roll, pitch = attitude
    ch, sh = math.cos(pose.heading), math.sin(pose.heading)
    rotation = np.array([[ch, -sh, 0.0], [sh, ch, 0.0], [0.0, 0.0, 1.0]]) @ tilt_rotation(roll, pitch)
    return np.concatenate((rotation.reshape(-1), (pose.x, pose.y, 0.0)))


def moved(pose: Pose, motion: Motion, time_s: float) -> Pose:
    """The pose after a time of constant motion along the exact arc."""
    turn = motion.turn_rate * time_s
    half = 0.5 * turn
    chord = time_s * (math.sin(half) / half if abs(half) > 1e-9 else 1.0)
    c, s = math.cos(half), math.sin(half)
    step = Pose(chord * (c * motion.vx - s * motion.vy), chord * (s * motion.vx + c * motion.vy), turn)
    return pose.compose(step)
