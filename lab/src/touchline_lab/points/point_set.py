"""A point set (.npz): many single observations of line points, each with the true pose and what may be told of it."""

import io
import math
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from touchline.errors import InputError
from touchline.field import FieldModel
from touchline.files.arrays import stored_array
from touchline.files.opened import read_bytes
from touchline.geometry import BoolArray, FloatArray, Pose
from touchline.types import LinePoints
from touchline_lab.points.bound import bound_covariance, mean_errors

MAX_BYTES = 200_000_000
MAX_FRAMES = 1_000_000
LINE_WIDTH_M = 0.125  # which the file does not tell; nothing but drawings and the field's outer size depend on it
USUAL_NOISE = (0.02, 0.01, math.radians(0.5))  # of the range: a share, and m; of the bearing: rad
_SHAPES: dict[str, tuple[int | None, ...]] = {
    "points": (None, 2),
    "offsets": (None,),
    "truth": (None, 3),
    "init": (None, 3),
    "compass": (None,),
    "segments": (None, 4),
    "arcs": (None, 5),
}


@dataclass(frozen=True, eq=False, slots=True)
class PointSet:
    """Frames of line points on one field.

    points: of each frame, robot frame. truth, init (F, 3): true pose and a start near it, x, y (m), heading (rad).
    compass (F,): heading (rad) with a compass's error. clutter: of each frame, (N,) which points are of no line; None
    where the file does not tell. name: of the file.
    """

    name: str
    field: FieldModel
    points: tuple[LinePoints, ...]
    truth: FloatArray
    init: FloatArray
    compass: FloatArray
    clutter: tuple[BoolArray, ...] | None

    def __len__(self) -> int:
        return len(self.points)

    def bound(self) -> tuple[float, float]:
        """Mean position (m) and heading error (rad) that no unbiased localizer falls below, clutter left out.

        Raises InputError for points that leave a pose open.
        """
        found = []
        for k in range(len(self)):
            try:
                found.append(mean_errors(self.bound_of(k)))
            except (ValueError, np.linalg.LinAlgError):
                raise InputError(f"{self.name}: frame {k}: its points leave the pose open") from None
        position_m, heading_rad = np.mean(found, axis=0)
        return float(position_m), float(heading_rad)

    def bound_of(self, k: int) -> FloatArray:
        """(3, 3) Cramér and Rao's bound on the covariance of a frame's pose, clutter left out.

        Raises ValueError or LinAlgError for points that leave the pose open.
        """
        points = self.points[k]
        kept = np.ones(len(points), np.bool_) if self.clutter is None else ~self.clutter[k]
        pose = Pose(*self.truth[k].tolist())
        return bound_covariance(self.field, points.positions_m[kept], points.covariances_m2[kept], pose)


def read_point_set(path: Path) -> PointSet:
    """A point set. Raises InputError for any other file."""
    data = read_bytes(path, MAX_BYTES)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as stored:
            arrays = {name: _numbers(stored, name, shape) for name, shape in _SHAPES.items()}
            clutter = _optional(stored, "is_outlier", (None,))
            noise = _optional(stored, "noise", (3,))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except Exception:  # whatever zipfile and NumPy raise of what is no such archive
        raise InputError(f"{path}: is no point set (.npz with {', '.join(_SHAPES)})") from None
    try:
        return _point_set(path.stem, arrays, clutter, USUAL_NOISE if noise is None else tuple(noise.tolist()))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def polar_covariances(positions_m: FloatArray, noise: tuple[float, ...]) -> FloatArray:
    """Covariances (N, 2, 2) in m² of positions (N, 2) in m, robot frame, of a camera that errs in range and bearing.

    noise: standard deviation of the range as a share of it and in m, which add up, and of the bearing in rad.
    """
    ranges = np.hypot(positions_m[:, 0], positions_m[:, 1])
    outward = positions_m / np.maximum(ranges, 1e-9)[:, np.newaxis]
    across = np.column_stack((-outward[:, 1], outward[:, 0]))
    of_range, of_bearing = np.square(noise[0] * ranges + noise[1]), np.square(noise[2] * ranges)
    found = np.einsum("n,ni,nj->nij", of_range, outward, outward) + np.einsum(
        "n,ni,nj->nij", of_bearing, across, across
    )
    return np.ascontiguousarray(found)


def _numbers(stored: zipfile.ZipFile, name: str, shape: tuple[int | None, ...]) -> npt.NDArray[Any]:
    """An array of finite numbers."""
    if f"{name}.npy" not in stored.namelist():
        raise InputError(f"is no point set: it has no '{name}'")
    values = stored_array(stored, name, shape, MAX_BYTES)
    if values.dtype.kind not in "iufb" or not np.isfinite(values).all():
        raise InputError(f"'{name}' holds something else than finite numbers")
    return values


def _optional(stored: zipfile.ZipFile, name: str, shape: tuple[int | None, ...]) -> npt.NDArray[Any] | None:
    return _numbers(stored, name, shape) if f"{name}.npy" in stored.namelist() else None


def _point_set(
    name: str, arrays: dict[str, npt.NDArray[Any]], clutter: npt.NDArray[Any] | None, noise: tuple[float, ...]
) -> PointSet:
    points, offsets = arrays["points"].astype(np.float64), arrays["offsets"].astype(np.int64)
    count = len(offsets) - 1
    if not 1 <= count <= MAX_FRAMES or offsets[0] != 0 or offsets[-1] != len(points) or (np.diff(offsets) < 1).any():
        raise InputError(f"'offsets' does not cut the {len(points)} points into frames of at least one")
    for key in ("truth", "init", "compass"):
        if len(arrays[key]) != count:
            raise InputError(f"'{key}' has {len(arrays[key])} rows for {count} frames")
    if clutter is not None and len(clutter) != len(points):
        raise InputError(f"'is_outlier' has {len(clutter)} rows for {len(points)} points")
    if min(noise) < 0.0 or noise[1] + noise[2] == 0.0:
        raise InputError(f"'noise' of {noise} is none: share of the range, m, bearing in rad")
    covariances = polar_covariances(points, noise)
    cuts = offsets[1:-1]
    pieces = zip(np.split(points, cuts), np.split(covariances, cuts), strict=True)
    frames = tuple(
        LinePoints(
            np.ascontiguousarray(at), np.ascontiguousarray(spread), np.ones(len(at)), np.full((len(at), 2), np.nan)
        )
        for at, spread in pieces
    )
    of_frames = None if clutter is None else tuple(np.split(clutter.astype(np.bool_), cuts))
    truth, init, compass = (np.ascontiguousarray(arrays[key], np.float64) for key in ("truth", "init", "compass"))
    return PointSet(name, _field_of(name, arrays["segments"], arrays["arcs"]), frames, truth, init, compass, of_frames)


def _field_of(name: str, segments: FloatArray, arcs: FloatArray) -> FieldModel:
    """The field of segments x1, y1, x2, y2 and arcs cx, cy, radius, start, sweep (m, rad)."""
    whole = np.abs(arcs[:, 4]) > 2.0 * math.pi - 1e-5
    ends = arcs[~whole].astype(np.float64)
    ends[:, 4] += ends[:, 3]
    corners = np.concatenate((segments[:, :2], segments[:, 2:]))
    if len(corners) == 0:
        raise InputError("'segments' has no rows")
    length, width = (2.0 * float(np.abs(corners[:, axis]).max()) + LINE_WIDTH_M for axis in (0, 1))
    return FieldModel(name, length, width, LINE_WIDTH_M, segments=segments, circles=arcs[whole, :3], arcs=ends)
