"""What a mirror that leans or lies aside does to the ground points, by the law of reflection.

A range table determines the shape of its mirror: at each radius the mirror sends the camera's ray to the ground at the
table's range. So it also determines where the ray goes once the mirror has moved by a little: it meets the surface
elsewhere, and at another slope. Lens and height are not in a camera.yaml, usual ones are taken; of these the answer
depends little (`MISFIT_M2` and `MISFIT_M_PER_PX` of `mirror.py` say how little).
"""

from typing import NamedTuple

import numpy as np

from touchline.camera import OmniCamera
from touchline.geometry import FloatArray

HEIGHT_M = 0.75  # of the mirror; MSL robots may be 0.8 m high
APEX_M = 0.1  # of the mirror above the lens
FOCAL_RATIO = 2.5  # focal length by the mirror's outer radius in the image
SCALE_STEP_M = 0.1  # between the rows of a table of responses
MAX_M = 20.0  # of the table of responses
_MIN_M, _MIN_PIXELS = 0.2, 3  # a table is read from there on, if so many of its pixels see ground
_SMOOTHED_M = 0.05  # to both sides of a range: tables have steps of their own
_ROUNDS = 4  # of solving for the mirror's height, on which its slope hardly depends
_PIXEL = 8  # of the camera's fine table
_X, _Y, _Z = np.eye(3)


class MirrorResponse(NamedTuple):
    """What the errors of a mirror do. height_m: of the mirror. parts (K, 4), at ranges r of SCALE_STEP_M each:

    along, across (m/px): by how much a displacement of the mirror's image by a pixel moves the ground along the
    direction of the point and across it. outwards, sideways (m²): by how much a lean of g (1/m) moves it along that
    direction and across it, beyond turning the rays (`mirror.py`).
    """

    height_m: float
    parts: FloatArray


class _Surface(NamedTuple):
    """The mirror at N radii, points and vectors in the plane of the ray: x outwards, z up; the lens is the origin.

    rays, points, normals, sent, bends (N, 3): the camera's ray, where it meets the mirror, the normal there, the ray
    after it, and the normal's change by a metre outwards. reach (N,): from the mirror to the ground along that ray.
    """

    rays: FloatArray
    points: FloatArray
    normals: FloatArray
    sent: FloatArray
    bends: FloatArray
    reach: FloatArray


def mirror_response(camera: OmniCamera | None) -> MirrorResponse:
    """That of a camera's mirror, the mean of all directions; without a mirror, or ground in it, nothing is moved."""
    count = int(MAX_M / SCALE_STEP_M) + 1
    radii_px, ranges_m = (np.zeros(0), np.zeros(0)) if camera is None else _table(camera)
    if camera is None or len(radii_px) < _MIN_PIXELS:
        return MirrorResponse(HEIGHT_M, np.zeros((count, 4)))
    focal_px = FOCAL_RATIO * max(camera.outer_radius_px, float(radii_px[-1]))
    surface = _surface(radii_px / focal_px, ranges_m)
    above = surface.points - APEX_M * _Z
    aside, lean, square = -APEX_M / focal_px, -0.5 * HEIGHT_M, HEIGHT_M**2
    columns = (
        aside * _moved(surface, _X, 0.0 * _X)[:, 0],
        aside * _moved(surface, _Y, 0.0 * _Y)[:, 1],
        lean * _moved(surface, np.cross(_Y, above), _Y)[:, 0] - ranges_m**2 - square,
        lean * _moved(surface, np.cross(-_X, above), -_X)[:, 1] - square,
    )
    inside = np.clip(SCALE_STEP_M * np.arange(count), ranges_m[0], ranges_m[-1])
    near = [inside - _SMOOTHED_M, inside, inside + _SMOOTHED_M]
    parts = np.array([np.interp(near, ranges_m, column).mean(axis=0) for column in columns])
    return MirrorResponse(HEIGHT_M, np.ascontiguousarray(parts.T))


def _table(camera: OmniCamera) -> tuple[FloatArray, FloatArray]:
    """Radii (N,) of a pixel each, and the ranges (m) that a camera shows there, the mean of all directions."""
    ranges_m = np.exp(np.log(np.maximum(camera.lookup_table[0, :, ::_PIXEL], 1e-3)).mean(axis=0))
    radii_px = camera.radius_px[0] + camera.lookup_constants[5] * _PIXEL * np.arange(len(ranges_m))
    used = (ranges_m > _MIN_M) & (ranges_m < 1.5 * MAX_M) & (radii_px >= 1.0)
    return radii_px[used], ranges_m[used]


def _surface(tangents: FloatArray, ranges_m: FloatArray) -> _Surface:
    """The mirror that shows ranges (N,) at rays of such tangents (N,) to its axis."""
    zeros = np.zeros_like(tangents)
    rays = np.column_stack((tangents, zeros, np.ones_like(tangents)))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    lens_m = HEIGHT_M - APEX_M
    heights = np.full_like(tangents, APEX_M)
    for _ in range(_ROUNDS):
        points = np.column_stack((heights * tangents, zeros, heights))
        sent = np.column_stack((ranges_m - points[:, 0], zeros, -lens_m - heights))
        reach = np.linalg.norm(sent, axis=1)
        sent /= reach[:, np.newaxis]
        normals = sent - rays
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        slopes = -normals[:, 0] / normals[:, 2]
        growth = slopes / (1.0 - slopes * tangents)
        steps = 0.5 * (growth[1:] + growth[:-1]) * np.diff(tangents)
        heights = APEX_M * np.exp(0.5 * growth[0] * tangents[0] + np.concatenate(([0.0], np.cumsum(steps))))
    bends = np.gradient(normals, points[:, 0], axis=0)
    return _Surface(rays, points, normals, sent, bends, reach)


def _moved(surface: _Surface, shift: FloatArray, turn: FloatArray) -> FloatArray:
    """(N, 2) where the ground is seen farther outwards and to the left, by the unit of a small motion of the mirror.

    shift (3,) or (N, 3): of its points; turn (3,): of its normals. To first order: a ray meets the mirror elsewhere,
    and there it leans otherwise.
    """
    rays, points, normals, sent, bends, reach = surface
    toward = (rays * normals).sum(axis=1)
    meets = ((shift * normals).sum(axis=1) / toward)[:, np.newaxis] * rays
    along = meets - shift  # over the surface
    tilted = np.cross(turn, normals) + bends * along[:, :1]
    tilted[:, 1] += normals[:, 0] / points[:, 0] * along[:, 1]
    turned = -2.0 * ((rays * tilted).sum(axis=1)[:, np.newaxis] * normals + toward[:, np.newaxis] * tilted)
    off = meets + reach[:, np.newaxis] * turned
    return (off - (off[:, 2] / sent[:, 2])[:, np.newaxis] * sent)[:, :2]
