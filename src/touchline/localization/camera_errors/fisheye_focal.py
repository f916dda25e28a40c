"""What an error of a fisheye camera's focal length does to ground points: it scales angles to the optical axis.

A pinhole's scales their tangents. Points are from the camera's foot (m), robot frame; the camera is at a height (m)
above it and looks along `axis` (3,), a unit vector; zeros where the axis is not known. The error is the relative one of
the angles, one over that of the focal length.
"""

import math

import numba

from touchline.geometry import FloatArray

_MIN_FALL = 1e-3  # of a ray: one that does not fall meets the ground far away


@numba.njit(cache=True, error_model="numpy")
def angle_of(x: float, y: float, height: float, axis: FloatArray) -> tuple[float, float, float]:
    """Angle (rad) of a ground point's ray to the axis, the ray's length (m), and its part along the axis (m)."""
    length = math.sqrt(x * x + y * y + height * height)
    along = x * axis[0] + y * axis[1] - height * axis[2]
    return math.acos(min(max(along / length, -1.0), 1.0)), length, along


@numba.njit(cache=True, error_model="numpy")
def scaled_angle(x: float, y: float, error: float, height: float, axis: FloatArray) -> tuple[float, float]:
    """Where the ray of a ground point meets the ground if its angle to the axis is (1 + error) times as large (m)."""
    angle, length, along = angle_of(x, y, height, axis)
    aside = length * math.sin(angle)
    if not (aside > 1e-6 * length and axis[0] ** 2 + axis[1] ** 2 + axis[2] ** 2 > 0.5):
        return x, y
    outwards = math.sin((1.0 + error) * angle) / aside
    ahead = math.cos((1.0 + error) * angle) - outwards * along
    fall = max(outwards * height - ahead * axis[2], _MIN_FALL)
    return (outwards * x + ahead * axis[0]) * height / fall, (outwards * y + ahead * axis[1]) * height / fall


@numba.njit(cache=True, error_model="numpy")
def angle_stretch(x: float, y: float, height: float, axis: FloatArray) -> float:
    """angle / sin(angle) of a ray's length (m): in derivatives where a pinhole has the part along the axis."""
    angle, length, _ = angle_of(x, y, height, axis)
    return length * (angle / math.sin(angle) if angle > 1e-6 else 1.0)


@numba.njit(cache=True, error_model="numpy")
def by_angle_scale(x: float, y: float, height: float, axis: FloatArray) -> tuple[float, float]:
    """Derivative of `scaled_angle` by the error, at 0 (m)."""
    stretch = angle_stretch(x, y, height, axis)
    return -stretch * (axis[0] + x * axis[2] / height), -stretch * (axis[1] + y * axis[2] / height)
