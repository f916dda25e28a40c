"""A recording in the folder format: frames read lazily, in constant memory at any length."""

from __future__ import annotations

import itertools
from collections.abc import Container, Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from touchline.errors import InputError
from touchline.files.opened import OwnFolder, UnreadableError, open_bytes
from touchline.geometry import IntArray
from touchline.messages import counted
from touchline.sources.bags.roles import BagOptions
from touchline.sources.camera_poses import CAMERA_POSES, CameraPoses
from touchline.sources.camera_poses import COLUMNS as CAMERA_POSE_COLUMNS
from touchline.sources.decoding import Decoded, FolderImages, ImageStore, usable_image
from touchline.sources.description import CAMERA, NO_CAMERA, read_description, wheel_directions_rad
from touchline.sources.images import ImageList, read_image_list
from touchline.sources.observations import OBSERVATIONS, ObservationList, read_observation_list
from touchline.sources.problems import ProblemKind, ProblemLog
from touchline.sources.sensors import SensorStream
from touchline.sources.tables import StampArray, Table, TableError, open_table
from touchline.sources.truth import TRUTH, Truth, read_truth
from touchline.types import Frame, GameState, ImageArray, Observation, Samples
from touchline.types.game import PHASES, STAYS

if TYPE_CHECKING:
    from touchline.camera import Camera
    from touchline.field import FieldModel

IMAGE_LIST = "images.csv"
SENSOR_COLUMNS = {
    "odometry.csv": ("x", "y", "theta"),
    "wheels.csv": ("a", "b"),
    "imu.csv": ("roll", "pitch", "yaw", "gx", "gy", "gz"),
}
SENSOR_FILES = {
    "odometry": "odometry.csv",
    "wheels": "wheels.csv",
    "gyro": "imu.csv",
    "compass": "imu.csv",
    "tilt": "imu.csv",
}
"""The table in which a recording keeps each sensor of `Frame`."""
GAME_STATES, _GAME_COLUMNS = "game_states.csv", ("phase", "penalised", "first_half")
_MAY_BE_EMPTY = SENSOR_COLUMNS["imu.csv"]  # three sensors in one file: a robot without compass has the others


class Recording:
    """A folder as docs/how-to-recording.md describes it: iterate for `Frame`s, as often as you like.

    Frames are those of images.csv, or of observations.csv where there are no images; what observations.csv says of an
    image comes with it. Files outside of the folder, by absolute paths, `..` or links, are only read with
    `follow_links`. Every frame carries the samples in the half-open interval (stamp of the frame before, its own
    stamp]; the first one all samples up to its stamp. A sensor without a sample there is None. A frame whose image is
    missing or broken has image None and says why in `problem`.

    path: what the user named, where the folder holds the tables of a bag. images: where its images are.
    problems: of the way they came. name, sequence (as it was written), events, camera_kind (`omni`, `pinhole`,
    `fisheye` or `none`: observations.csv takes the place of a camera), camera_file (None without one), linear (images
    are 16-bit linear PNG files) and stated_rate_hz (None without one) are what sequence.yaml says.

    Raises InputError when it can't be opened at all; what can be survived is in `problems`.
    """

    def __init__(
        self,
        folder: Path,
        follow_links: bool = False,
        path: Path | None = None,
        images: ImageStore | None = None,
        problems: ProblemLog | None = None,
    ) -> None:
        if not folder.exists():
            raise InputError(f"{folder}: there is no such recording")
        if not folder.is_dir():
            raise InputError(f"{folder}: is not a recording; expected a folder that holds sequence.yaml and images.csv")
        self.folder = folder
        self.path = path or folder
        self.kept: object = None
        """What has to live as long as the recording: a temporary folder."""
        self.options = BagOptions()
        """What a bag did not say of itself."""
        self._own = OwnFolder(folder, follow_links)
        self.image_store: ImageStore = images or FolderImages(self._own)
        self._opening = ProblemLog() if problems is None else problems
        self._pass = ProblemLog(self._opening.topics)
        about = read_description(self._own, self._opening)
        self.name, self.sequence, self.events = about.name, about.sequence, about.events
        self.camera_kind, self.camera_file, self.linear = about.camera_kind, about.camera_file, about.linear
        self._camera_model = about.camera_model
        self.stated_rate_hz, self._field_source = about.rate_hz, about.field_source
        self._observations = self._open_observations()
        self._images = self._open_images()
        frames = self._images or self._observations
        assert frames is not None
        self._stamp_ns: StampArray = frames.stamp_ns
        self._observed = self._match_observations()
        self._tables: dict[str, Table] = {}
        others = (CAMERA_POSES, CAMERA_POSE_COLUMNS), (GAME_STATES, _GAME_COLUMNS)
        for name, columns in (*SENSOR_COLUMNS.items(), *others):
            self._open_sensor(name, columns)
        self._camera_poses, self._game = self._tables.pop(CAMERA_POSES, None), self._tables.pop(GAME_STATES, None)
        self.truth: Truth | None = None
        """The true poses, where they are known. For evaluation only."""
        if (folder / TRUTH).exists():
            self.truth = read_truth(self.file(TRUTH), self._stamp_ns, self._opening)
        self._size = about.image_size

    def file(self, name: str) -> Path:
        """The path of a file of the recording. Raises UnreadableError for one elsewhere that must not be followed."""
        return self._own.file(name)

    def _open_observations(self) -> ObservationList | None:
        """observations.csv, if it is there; a file that can't be used is fatal only where no camera sees instead."""
        path = self.folder / OBSERVATIONS
        if not path.exists():
            if self.camera_kind == NO_CAMERA:
                raise InputError(f"{path}: is missing, but sequence.yaml says camera 'none': nothing would be seen")
            return None
        try:
            return read_observation_list(self.file(OBSERVATIONS), self._opening)
        except (TableError, UnreadableError) as error:
            if self.camera_kind == NO_CAMERA or not (self.folder / IMAGE_LIST).exists():
                raise
            self._report_unused(OBSERVATIONS, error)
        return None

    def _open_images(self) -> ImageList | None:
        """images.csv; None where observations.csv tells the times instead."""
        path = self.folder / IMAGE_LIST
        if self.camera_kind == NO_CAMERA or (self._observations is not None and not path.exists()):
            return None
        if not path.exists():
            raise InputError(
                f"{path}: is missing; it has to list the images as t,file,exposure_ms,gain, unless there is an "
                f"{OBSERVATIONS}"
            )
        return read_image_list(self.file(IMAGE_LIST), self._opening)

    def _match_observations(self) -> IntArray | None:
        """(N,) the observation of each frame, -1 where there is none; those at no frame's time are reported."""
        if self._observations is None:
            return None
        found = self._observations.indices_at(self._stamp_ns)
        for index in np.setdiff1d(np.arange(len(self._observations)), found).tolist():
            time_s, line = self._observations.stamp_ns[index] / 1e9, int(self._observations.lines[index])
            what = f"no image of {IMAGE_LIST} was taken at t = {time_s:.4f} s; what was seen then is left out"
            self._opening.add(ProblemKind.TIME_ORDER, OBSERVATIONS, what, line=line)
        return found

    def _open_sensor(self, name: str, columns: Sequence[str]) -> None:
        """Note the table of a sensor; a file that can't be used is reported, the recording goes on without it."""
        if not (self.folder / name).exists():
            return
        try:
            self._tables[name] = open_table(self.file(name), ["t", *columns])
        except (TableError, UnreadableError) as error:
            self._report_unused(name, error)

    def _report_unused(self, name: str, error: TableError | UnreadableError) -> None:
        what = f"{error.what}; the recording is read without it"
        line = error.line if isinstance(error, TableError) else None
        self._opening.add(ProblemKind.SENSOR_FILE, name, what, line=line)

    @property
    def follows_links(self) -> bool:
        """Whether files outside of the folder are read."""
        return self._own.follow_links

    @property
    def has_images(self) -> bool:
        """Whether there are images at all: observations.csv may take their place."""
        return self._images is not None

    @property
    def has_observations(self) -> bool:
        """Whether the robot's own detector has written what it found."""
        return self._observations is not None

    @property
    def frame_list(self) -> str:
        """The file that tells when frames were taken."""
        return OBSERVATIONS if self._images is None else IMAGE_LIST

    @cached_property
    def camera(self) -> Camera:
        """The camera model; InputError if there is none."""
        from touchline.camera import camera_from_mapping

        if self.camera_file is None or self._camera_model is None:
            said = next((problem.message for problem in self._opening if problem.file == CAMERA), None)
            raise InputError(
                said or f"{self.folder / CAMERA}: is missing; without it pixels have no place on the ground"
            )
        try:
            return camera_from_mapping(self._camera_model, self.camera_file)
        except InputError as error:  # of a bag the tables lie in a folder that nobody knows
            raise InputError(str(error).replace(str(self.folder), str(self.path), 1)) from None

    @cached_property
    def field(self) -> FieldModel:
        """The field of field.yaml, else the preset that sequence.yaml names."""
        from touchline.field import open_field

        return open_field(self._field_source)

    @property
    def wheel_directions_rad(self) -> tuple[float, float] | None:
        """Rolling directions of the measuring wheels a and b in the robot frame; None where sequence.yaml has none."""
        return wheel_directions_rad(self.sequence)

    @property
    def sensor_files(self) -> tuple[str, ...]:
        """The tables of sensors that can be read."""
        return tuple(self._tables)

    def table(self, name: str) -> Table | None:
        """One of the recording's tables of numbers by its file; None where there is none that can be used."""
        if name in (IMAGE_LIST, OBSERVATIONS):
            listed = self._images if name == IMAGE_LIST else self._observations
            return None if listed is None else listed.table
        return self._camera_poses if name == CAMERA_POSES else self._tables.get(name)

    @property
    def rate_hz(self) -> float:
        """Nominal image rate; the median one where sequence.yaml names none (NaN for a single image)."""
        if self.stated_rate_hz is not None:
            return self.stated_rate_hz
        steps = np.diff(self.image_stamps)
        return 1e9 / float(np.median(steps)) if len(steps) else float("nan")

    @property
    def image_stamps(self) -> StampArray:
        """Stamps of all frames (ns), int64 (N,)."""
        return self._stamp_ns

    @property
    def problems(self) -> ProblemLog:
        """What was odd: at opening, and so far in the latest pass over the frames."""
        return self._opening.joined(self._pass)

    def __len__(self) -> int:
        return len(self._stamp_ns)

    def __repr__(self) -> str:
        what = counted(len(self), "image" if self.has_images else "observation")
        return f"Recording({self.name}: {what}, field {self.field.name}, camera {self.camera_kind})"

    def __iter__(self) -> Iterator[Frame]:
        self._pass = ProblemLog(self._opening.topics)
        return self._frames(self._pass)

    def again(self, seen: Container[int] | None = None) -> Iterator[Frame]:
        """The frames once more, for another look: `problems` stays as the latest pass left it.

        seen: indices of the frames whose image or observation is read, the others have none; None: of all.
        """
        return self._frames(ProblemLog(), seen)

    def _frames(self, log: ProblemLog, seen: Container[int] | None = None) -> Iterator[Frame]:
        streams = {
            name: SensorStream(table, SENSOR_COLUMNS[name], log, _MAY_BE_EMPTY if name == "imu.csv" else ())
            for name, table in self._tables.items()
        }
        poses = None if self._camera_poses is None else CameraPoses(self._camera_poses, log)
        if self._game is not None:
            streams[GAME_STATES] = SensorStream(self._game, _GAME_COLUMNS, log)
        pictures = self._pictures(log, seen)
        for index, observation in enumerate(self._seen(log, seen)):
            stamp = int(self._stamp_ns[index])
            taken = {name: stream.take_until(stamp) for name, stream in streams.items()}
            name, image, problem = next(pictures)
            imu = taken.get("imu.csv")
            exposure, gain = self._exposure(index)
            yield Frame(
                stamp_ns=stamp,
                image=image,
                observation=observation,
                base_from_camera=None if poses is None else poses.at(stamp),
                odometry=taken.get("odometry.csv"),
                wheels=taken.get("wheels.csv"),
                gyro=known_columns(imu, 3, 6),
                compass=known_columns(imu, 2, 3),
                tilt=known_columns(imu, 0, 2),
                exposure_ms=exposure,
                gain=gain,
                game=game_states(taken.get(GAME_STATES)),
                name=name,
                problem=problem,
            )
        for stream in streams.values():
            stream.drain()
        if poses is not None:
            poses.drain()

    def _seen(self, log: ProblemLog, seen: Container[int] | None) -> Iterator[Observation | None]:
        """What the robot's own detector found in each frame; None where observations.csv has nothing of it."""
        if self._observations is None or self._observed is None:
            yield from itertools.repeat(None, len(self))
            return
        with open_bytes(self._observations.table.path) as file:
            for frame, index in enumerate(self._observed):
                wanted = index >= 0 and (seen is None or frame in seen)
                yield self._observations.read(int(index), file, log) if wanted else None

    def _pictures(
        self, log: ProblemLog, seen: Container[int] | None
    ) -> Iterator[tuple[str, ImageArray | None, str | None]]:
        """Name, image and problem of each frame; nothing of each where there are no images."""
        if self._images is None:
            yield from itertools.repeat(("", None, None), len(self))
            return
        for index, name in enumerate(self._images.file_names()):
            yield (name, *self._load(index, name, log)) if seen is None or index in seen else (name, None, None)

    def _exposure(self, index: int) -> tuple[float | None, float | None]:
        """Exposure (ms) and gain of a frame, where they are known."""
        if self._images is None:
            return None, None
        values = float(self._images.exposure_ms[index]), float(self._images.gain[index])
        exposure_ms, gain = (None if np.isnan(value) else value for value in values)
        return exposure_ms, gain

    def image(self, index: int) -> ImageArray | None:
        """The image of one frame by its index, uint8 (H, W, 3) BGR; None where it is missing or broken.

        For a look at single frames out of order; adds nothing to `problems`.
        """
        index = range(len(self))[index]
        if self._images is None:
            return None
        return self._load(index, self.image_name(index), ProblemLog())[0]

    def stored_image(self, index: int) -> Decoded:
        """The image of one frame as it was stored, 16-bit linear ones included, or why there is none."""
        index = range(len(self))[index]
        if self._images is None:
            return Decoded(None, ProblemKind.MISSING_IMAGE, "is missing: the recording has no images")
        return self._decoded(index, self.image_name(index))

    def image_bytes(self, index: int) -> bytes | None:
        """The image of one frame as the content of its file; None where there is none."""
        index = range(len(self))[index]
        if self._images is None:
            return None
        try:
            return self.image_store.file_bytes(int(self._images.lines[index]) - 2, self.image_name(index))
        except UnreadableError:
            return None

    def listed_images(self) -> Iterator[tuple[int, str]]:
        """Row (from 0) and file of every image that images.csv lists, usable or not."""
        if self._images is not None:
            yield from self._images.listed()

    def _decoded(self, index: int, name: str) -> Decoded:
        assert self._images is not None
        return self.image_store.decode(int(self._images.lines[index]) - 2, name, self._size)

    def image_name(self, index: int) -> str:
        """The file of one frame by its index, relative to the recording; empty where there are no images."""
        if self._images is None:
            return ""
        return next(self._images.file_names(range(len(self))[index]))

    def _load(self, index: int, name: str, log: ProblemLog) -> tuple[ImageArray | None, str | None]:
        """The image of one frame, or the problem that left none."""
        assert self._images is not None
        image, outcome = usable_image(self._decoded(index, name), self._size)
        if image is None:
            kind = outcome.kind or ProblemKind.BROKEN_IMAGE
            line = int(self._images.lines[index])
            shown = "" if IMAGE_LIST in log.topics else f"{name if name.isprintable() else repr(name)} "
            return None, log.add(kind, IMAGE_LIST, f"{shown}{outcome.what}", line=line, frame=index).message
        if self._size is None:
            self._size = (image.shape[1], image.shape[0])
        return image, None


def known_columns(samples: Samples | None, start: int, stop: int) -> Samples | None:
    """Some of the columns; rows with an empty one left out."""
    if samples is None:
        return None
    values = samples.values[:, start:stop]
    known = np.isfinite(values).all(axis=1)
    if known.all():
        return Samples(samples.stamp_ns, values)
    return Samples(samples.stamp_ns[known], values[known]) if known.any() else None


def game_states(rows: Samples | None) -> tuple[GameState, ...]:
    """What the referee said: phase by its number in `PHASES`; penalised 0, 1, or 2 for one that moves nobody."""
    if rows is None:
        return ()
    penalties = ("", "removed", STAYS)
    return tuple(
        GameState(stamp_ns, PHASES[int(phase)], penalties[int(penalised)], first_half == 1.0)
        for stamp_ns, (phase, penalised, first_half) in zip(rows.stamp_ns.tolist(), rows.values.tolist(), strict=True)
        if phase in range(len(PHASES)) and penalised in range(len(penalties))
    )
