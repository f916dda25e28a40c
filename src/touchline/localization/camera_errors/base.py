"""What a built camera differs by from its camera.yaml: errors that all its images share, states of the filter.

One record for every kind of camera, one file for each. What compiled loops need of a kind stands there: it overloads
`prepare`, `terms_at`, `place_all` and `fill_all` for its types, and the loops of `registration` are compiled once for
each kind.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from touchline.field.offset_map import CHUNK
from touchline.geometry import FloatArray

# where in the room (15 CHUNK,) of a chunk what is known of its points begins, number by number: place in the field and
# offset from the line there (`look_up_offsets`), where they belong, normals of the lines, derivatives
PLACED, NORMAL, COLUMNS = 4 * CHUNK, 6 * CHUNK, 8 * CHUNK
MAX_STATES = 8
Response = Any  # a NamedTuple of arrays and numbers, of a type of its own for each kind of camera


class ImageTrust(NamedTuple):
    """Limits of one image's evidence, by how much of the field it shows.

    max_gain: largest log-odds that one image takes from a pose. found_gain: the same for a pose
    that was found in it, against the poses that are followed. confirming_images: beside the one in which a pose was
    found, until it is tracked. looks_away_s: for so long it may show nothing. memory: share of an image in how much
    is explained of late. tracked_ratio: of `min_explained`, what is enough while a pose is tracked. good: share that a
    right pose explains; the whole field is searched where it is less; None: `min_explained`. unseen: how much a
    crossing of a ray with a line counts where no point was seen, beside a point that was. min_noise: of points, as a
    share of the variances that they state, however small their residuals: neighbours err together. free_fit: whether
    line points have a pose by themselves; those of a sector may slide along a line. excused: share of what is
    not explained that may be clutter.
    """

    max_gain: float
    found_gain: float
    confirming_images: int
    looks_away_s: float
    memory: float
    tracked_ratio: float
    good: float | None
    unseen: float
    min_noise: float
    free_fit: bool
    excused: float = 0.0

    def of(self, crude: bool) -> ImageTrust:
        """That of an image, with limits of its own if it shows a crude cloud of points."""
        if not crude:
            return self
        return self._replace(
            max_gain=min(CRUDE_GAIN, self.max_gain),
            found_gain=min(0.0, self.found_gain),
            tracked_ratio=min(CRUDE_TRACKED, self.tracked_ratio),
            excused=CRUDE_EXCUSED,
        )

    def share(self, explained: float) -> float:
        """The share that a pose explains of what is seen, without what may be clutter."""
        return 1.0 - (1.0 - self.excused) * (1.0 - explained)


# what a crude cloud shows beside lines it shows in every image, and some wrong pose lays it on lines: that one has to
# be better for seconds; the right one need not explain it
CRUDE_GAIN, CRUDE_TRACKED, CRUDE_EXCUSED = 0.5, 0.5, 0.5
# a mirror shows the field all round: a wrong pose is contradicted by a hundred points at once
ALL_ROUND = ImageTrust(math.inf, math.inf, 0, 0.0, 1.0, 0.5, None, 0.25, 0.2, True)
# a sector shows a few things, which err together, and what it was found in was fitted best of all places; a robot that
# looks at the ball may see no line for seconds
SECTOR = ImageTrust(4.0, 0.0, 1, 4.0, 0.4, 1.0, 0.85, 0.0, 0.5, False)


class Lean(NamedTuple):
    """By how much the first two errors differ in each image from those of the camera: a standard deviation.

    first: before anything is known; min, max: limits of what is learned. per_m: what one unit of it is as the tangent
    of an angle over the camera's height (1/m).
    """

    first: float
    min: float
    max: float
    per_m: float


@dataclass(frozen=True, eq=False)
class CameraErrors:
    """The K errors of one kind of camera.

    names: of each, with its unit. height_m: of the camera above the ground. prior (K, K): their covariance before the
    first image. drift (K,): standard deviation of how they change in the root of a second. learned: share of its step
    by an image that they take (`Filter`). lean: of each image, beside the errors that all share. trust: limits of one
    image's evidence. response: what the errors do to what is seen, at the image of a frame, for the compiled loops.
    floor: standard deviations (m, m, rad) of the pose that no image lowers. misfit: standard deviation of the position
    by what each error does beyond this model, per unit (m). seeming (K,): standard deviations of what an exact camera
    still seems to differ by. exact: inverse covariance (K, K) of the errors if camera.yaml is exact, as one without a
    stated uncertainty may be; None with one.
    """

    names: tuple[str, ...]
    height_m: float
    prior: FloatArray
    drift: FloatArray
    learned: float
    lean: Lean
    trust: ImageTrust
    response: Callable[..., Response]
    floor: tuple[float, float, float]
    misfit: tuple[float, ...]
    seeming: tuple[float, ...]
    exact: FloatArray | None = None


def prepare(points: Any, errors: Any, response: Any) -> Any:
    """(P, N): what of points (N, 2), robot frame, is the same in every step of a fit that begins at errors (K,)."""


def terms_at(errors: Any, response: Any) -> Any:
    """What all points have in common at errors (K,): a NamedTuple of numbers, which stay in registers."""


def place_all(row: Any, room: Any, terms: Any, prepared: Any) -> None:
    """Into room[PLACED:] where a chunk's points belong, robot frame (m), as a camera without errors would see them.

    row: x, y as seen (2 CHUNK,). prepared: the chunk's row of `prepare`.
    """


def fill_all(row: Any, room: Any, terms: Any, prepared: Any) -> None:
    """Derivatives by the errors of where a chunk's points lie along the normals in room[NORMAL:], robot frame, into
    room[COLUMNS + 3 CHUNK:]. They are as seen in `row`, and belong where room[PLACED:] says.
    """


@njit(cache=True, error_model="numpy")
def chunks_of(points):  # type: ignore[no-untyped-def]
    """Points (N, 2) as rows (C, 2 CHUNK), a chunk each, x before y; the last one is filled up with zeros."""
    rows = np.zeros(((points.shape[0] + CHUNK - 1) // CHUNK, 2 * CHUNK))
    for i in range(points.shape[0]):
        rows[i // CHUNK, i % CHUNK], rows[i // CHUNK, CHUNK + i % CHUNK] = points[i, 0], points[i, 1]
    return rows


@njit(cache=True, error_model="numpy")
def placed_points(points, errors, response):  # type: ignore[no-untyped-def]
    """Points (N, 2) as a camera without errors (K,) would have seen them, robot frame (m)."""
    terms, prepared, out = terms_at(errors, response), prepare(points, errors, response), np.empty_like(points)
    rows, room = chunks_of(points), np.empty(COLUMNS)
    for i in range(points.shape[0]):
        k = i % CHUNK
        if k == 0:
            place_all(rows[i // CHUNK], room, terms, prepared[i // CHUNK])
        out[i, 0], out[i, 1] = room[PLACED + k], room[PLACED + CHUNK + k]
    return out
