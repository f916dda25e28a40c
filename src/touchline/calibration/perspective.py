"""`touchline calibrate camera`: a perspective camera from a chessboard and from marks of known place on the ground.

The lens comes from images of a chessboard (Zhang's method, by OpenCV) or from a camera.yaml. The plane-to-plane
homography of at least four marks (Schulz and Behnke 2012, section 4.4; Criminisi, Reid, Zisserman 1999) places the
camera; without a lens it also tells the focal length, with the principal point in the middle of the image.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import yaml

from touchline.calibration.marks import Marks
from touchline.camera import PerspectiveCamera, PinholeCamera
from touchline.errors import InputError
from touchline.files.images import MAX_SIDE_PX
from touchline.geometry import FloatArray, Pose3
from touchline.sources import Recording

MIN_BOARDS = 5  # images of a chessboard; fewer leave the lens open
MIN_MARKS = 4
OPTICAL_FROM_BODY = np.array([(0.0, -1.0, 0.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0)])
_PARALLEL_DEG = 8.0  # between the boards' normals; a robot that sways tilts them by less
_BOARD_CORNERS = (3, 50)  # fewest and most of a side
_IN_ONE_LINE = 1e-3  # ratio of the marks' extents across and along


class Lens(NamedTuple):
    """What a camera does to rays: image size, focal lengths and principal point (px), distortion (5,).

    origin: where it is known from, in words.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: FloatArray
    origin: str

    @property
    def matrix(self) -> FloatArray:
        """(3, 3) of OpenCV."""
        return np.array([(self.fx, 0.0, self.cx), (0.0, self.fy, self.cy), (0.0, 0.0, 1.0)])


@dataclass(frozen=True, eq=False, slots=True)
class PerspectiveCalibration:
    """camera: what was found. homography: (3, 3) undistorted pixel -> ground. residuals_px: (N,) of the marks.

    residuals_m: (N,) distance on the ground between the marks and where the camera puts them; NaN above its horizon.
    """

    camera: PinholeCamera
    homography: FloatArray
    residuals_px: FloatArray
    residuals_m: FloatArray
    lens_origin: str


def chessboard_lens(recording: Recording) -> Lens:
    """The lens from images of the chessboard that sequence.yaml describes. Raises InputError for too few boards."""
    described = recording.sequence.get("chessboard")
    columns, rows, square_m = _board(described, recording)
    corners, size = [], None
    for index in range(len(recording)):
        image = recording.image(index)
        if image is None:
            continue
        size = (image.shape[1], image.shape[0])
        found, seen = cv2.findChessboardCornersSB(
            cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), (columns, rows), flags=cv2.CALIB_CB_ACCURACY
        )
        if found:
            corners.append(seen.reshape(-1, 1, 2).astype(np.float32))
    if len(corners) < MIN_BOARDS or size is None:
        raise InputError(
            f"{recording.folder}: the chessboard of {columns} x {rows} inner corners is found in {len(corners)} of "
            f"{len(recording)} images; at least {MIN_BOARDS} are needed, from different places"
        )
    y, x = np.mgrid[0:rows, 0:columns]
    board = (np.column_stack((x.ravel(), y.ravel(), np.zeros(x.size))) * square_m).astype(np.float32)
    origin = f"a chessboard in {len(corners)} of {len(recording)} images"
    lens, normals = _zhang(board, corners, size, 0, origin)
    if np.degrees(np.arccos(np.clip(normals @ normals.mean(axis=0), -1.0, 1.0))).max() < _PARALLEL_DEG:
        # boards that all lie on the ground, seen under one tilt, don't tell the principal point
        lens, _ = _zhang(board, corners, size, cv2.CALIB_FIX_PRINCIPAL_POINT, f"{origin}, all seen under one tilt")
    return lens


def _zhang(
    board: FloatArray, corners: list[FloatArray], size: tuple[int, int], flags: int, origin: str
) -> tuple[Lens, FloatArray]:
    """The lens, with square pixels and without k3, and the boards' normals (N, 3) in the optical frame."""
    flags |= cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_FIX_K3 | cv2.CALIB_USE_INTRINSIC_GUESS
    guess = np.array([(size[0], 0.0, 0.5 * (size[0] - 1)), (0.0, size[0], 0.5 * (size[1] - 1)), (0.0, 0.0, 1.0)])
    error_px, matrix, distortion, turns, _ = cv2.calibrateCamera(
        [board] * len(corners), corners, size, guess, np.zeros(5), flags=flags
    )
    fx, fy, cx, cy = (float(matrix[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2)))
    normals = np.array([cv2.Rodrigues(turn)[0][:, 2] for turn in turns])
    flat = np.asarray(distortion, dtype=np.float64).ravel()[:5]
    return Lens(*size, fx, fy, cx, cy, flat, f"{origin}, to {error_px:.2f} px"), normals


def lens_of(tree: Mapping[str, Any], path: Path) -> Lens:
    """The lens of a camera.yaml, which needs no mount yet. Raises InputError for what is no perspective camera."""
    if tree.get("model") != "pinhole":
        raise InputError(f"{path}: has 'model: {tree.get('model')}'; a perspective camera, 'model: pinhole', is needed")
    upright = dict.fromkeys(("x", "y", "z", "roll", "pitch", "yaw"), 0.0) | {"z": 1.0}
    of = PinholeCamera.from_mapping({**tree, "mount": upright}, path)
    if not 1.0 <= min(of.fx, of.fy) <= max(of.fx, of.fy) < MAX_SIDE_PX:
        raise InputError(f"{path}: 'fx' and 'fy' must be 1 to {MAX_SIDE_PX} px, found {of.fx:g} and {of.fy:g}")
    return Lens(of.width, of.height, of.fx, of.fy, of.cx, of.cy, of.distortion, path.name)


def lens_of_marks(marks: Marks, size: tuple[int, int]) -> Lens:
    """The lens that marks of one image tell: no distortion, the principal point in the middle of the image."""
    width, height = size
    centre = (0.5 * (width - 1.0), 0.5 * (height - 1.0))
    shown = _of_one_image(marks)
    # of the homography ground -> image about the centre both columns are orthogonal and of one length
    h = _homography(marks.places_m[shown], marks.pixels[shown] - centre, marks.path)
    a, b = h[:, 0], h[:, 1]
    squares = []
    if abs(a[2] * b[2]) > 1e-9:
        squares.append(-(a[0] * b[0] + a[1] * b[1]) / (a[2] * b[2]))
    if abs(b[2] ** 2 - a[2] ** 2) > 1e-9:
        squares.append((a[0] ** 2 + a[1] ** 2 - b[0] ** 2 - b[1] ** 2) / (b[2] ** 2 - a[2] ** 2))
    weights = [abs(a[2] * b[2]), abs(b[2] ** 2 - a[2] ** 2)][: len(squares)]
    square = float(np.average(squares, weights=weights)) if squares else -1.0
    if not square > 0.0:
        raise InputError(f"{marks.path}: these marks don't tell the focal length; give it with --camera FILE")
    focal = float(np.sqrt(square))
    return Lens(width, height, focal, focal, centre[0], centre[1], np.zeros(5), "the marks (no distortion)")


def calibrate_camera(marks: Marks, lens: Lens) -> PerspectiveCalibration:
    """The camera from marks of known place. Raises InputError for too few of them, or all in one line."""
    known = np.isfinite(marks.places_m).all(axis=1)
    pixels, places = marks.pixels[known], marks.places_m[known]
    if len(pixels) < MIN_MARKS:
        raise InputError(f"{marks.path}: {len(pixels)} marks have a known place (x_m, y_m); at least 4 are needed")
    extents = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    if extents[1] < _IN_ONE_LINE * extents[0]:
        raise InputError(f"{marks.path}: all marks lie in one line; a homography needs four of which no three do")
    flat = np.asarray(cv2.undistortPoints(pixels[:, np.newaxis], lens.matrix, lens.distortion), np.float64)[:, 0]
    homography = _homography(flat, places, marks.path)
    rotation, start = _placed(_homography(places, flat, marks.path), places.mean(axis=0))
    ground = np.column_stack((places, np.zeros(len(places))))
    turn, offset = cv2.solvePnPRefineLM(
        ground, pixels, lens.matrix, lens.distortion, cv2.Rodrigues(rotation)[0], start.reshape(3, 1)
    )
    optical_from_base = np.asarray(cv2.Rodrigues(turn)[0], np.float64)
    base_from_optical = optical_from_base.T
    mount = Pose3(base_from_optical @ OPTICAL_FROM_BODY, -(base_from_optical @ np.asarray(offset, np.float64)).ravel())
    if not mount.translation_m[2] > 0.0:
        raise InputError(f"{marks.path}: the marks put the camera below the ground: is y_m positive to the left?")
    camera = PinholeCamera(*lens[:6], lens.distortion, mount)
    gaps_px = np.hypot(*(camera.image_from_ground(places) - pixels).T)
    gaps_m = np.hypot(*(camera.ground_from_image(pixels) - places).T)
    pixel_scale = homography @ np.linalg.inv(lens.matrix)
    return PerspectiveCalibration(camera, pixel_scale / pixel_scale[2, 2], gaps_px, gaps_m, lens.origin)


def perspective_yaml(camera: PerspectiveCamera, words: str) -> str:
    """The text of a camera.yaml, under what was found."""
    tree = {k: round(v, 4) if k in ("fx", "fy", "cx", "cy") else v for k, v in camera.mapping().items()}
    tree["distortion"] = [round(value, 6) for value in tree["distortion"]]
    head = "".join(f"# {line}\n" for line in words.splitlines())
    return head + yaml.safe_dump(tree, sort_keys=False, default_flow_style=None, width=118)


def _board(described: Any, recording: Recording) -> tuple[int, int, float]:
    try:
        (columns, rows), square_m = described["inner_corners"], described["square_m"]
    except (KeyError, TypeError, ValueError):
        columns, rows, square_m = 0, 0, 0.0
    whole = all(isinstance(side, int) and _BOARD_CORNERS[0] <= side <= _BOARD_CORNERS[1] for side in (columns, rows))
    if not whole or not isinstance(square_m, int | float) or not 0.001 <= square_m <= 10.0:
        raise InputError(
            f"{recording.folder}: sequence.yaml needs chessboard: {{inner_corners: [7, 5], square_m: 0.12}}, with "
            f"{_BOARD_CORNERS[0]} to {_BOARD_CORNERS[1]} corners a side and squares in metres"
        )
    return columns, rows, float(square_m)


def _of_one_image(marks: Marks) -> FloatArray:
    """Of the image with most marks of known place: which they are."""
    known = np.isfinite(marks.places_m).all(axis=1)
    names = np.array(marks.files)
    counts = {str(name): int((known & (names == name)).sum()) for name in dict.fromkeys(marks.files)}
    best = max(counts, key=lambda name: counts[name], default="")
    if counts.get(best, 0) < MIN_MARKS:
        raise InputError(f"{marks.path}: no image has {MIN_MARKS} marks of known place (x_m, y_m)")
    return np.asarray(np.flatnonzero(known & (names == best)))


def _homography(source: FloatArray, target: FloatArray, path: Path) -> FloatArray:
    """(3, 3) that maps points (N, 2) to points (N, 2): exact for four, least squares for more."""
    found, _ = cv2.findHomography(source, target)
    if found is None or not 0.0 < np.linalg.norm(found[:, 0]) + np.linalg.norm(found[:, 1]) < np.inf:
        raise InputError(f"{path}: the marks make no homography: are three of four in one line, or two swapped?")
    return np.asarray(found, dtype=np.float64)


def _placed(image_from_ground: FloatArray, mark_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rotation (3, 3) and translation (3,) `optical_from_base` of a homography ground -> unit depth.

    mark_m: (2,) a ground point before the camera.
    """
    h = image_from_ground / (0.5 * (np.linalg.norm(image_from_ground[:, 0]) + np.linalg.norm(image_from_ground[:, 1])))
    if h[2] @ (*mark_m, 1.0) < 0.0:  # its depth
        h = -h
    u, _, vt = np.linalg.svd(np.column_stack((h[:, 0], h[:, 1], np.cross(h[:, 0], h[:, 1]))))
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt, h[:, 2]
