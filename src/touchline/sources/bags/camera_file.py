"""sensor_msgs/CameraInfo as a camera.yaml, and which of a recording's cameras ROS has messages for."""

from typing import Any

import numpy as np

from touchline.camera import PerspectiveCamera, is_perspective
from touchline.errors import InputError
from touchline.geometry import Pose3
from touchline.sources.folder import Recording

_PLUMB_BOB, _FISHEYE = ("plumb_bob", ""), ("equidistant", "fisheye")


def ros_camera(recording: Recording) -> PerspectiveCamera | None:
    """The camera of a recording, where ROS has messages for its kind; None, too, where its file holds no camera."""
    if not is_perspective(recording.camera_kind):
        return None
    try:
        camera = recording.camera
    except InputError:
        return None
    return camera if isinstance(camera, PerspectiveCamera) and camera.ros_model else None


def camera_mapping(info: Any, base_from_camera: Pose3 | None) -> dict[str, Any] | str:
    """The keys of a perspective camera.yaml, or why there are none."""
    matrix = np.ravel(_either(info, "k")).astype(np.float64)
    lens = np.ravel(_either(info, "d")).astype(np.float64)
    if matrix.shape != (9,) or not (matrix[0] > 0.0 and matrix[4] > 0.0) or min(info.width, info.height) < 1:
        return "the camera is not calibrated (CameraInfo without focal lengths)"
    model = str(info.distortion_model)
    fisheye = model in _FISHEYE
    count = 4 if fisheye else 5
    if model not in _PLUMB_BOB and np.any(lens[count:]):
        return (
            f"the distortion model '{model:.40}' is not known here; plumb_bob (k1, k2, p1, p2, k3) and equidistant "
            "(k1, k2, k3, k4) are"
        )
    if base_from_camera is None:
        return "the bag holds no transforms (/tf, /tf_static) from the robot's base to the camera"
    if not base_from_camera.translation_m[2] > 0.0:
        return (
            f"the camera lies {base_from_camera.translation_m[2]:.2f} m above the base frame, expected it above the "
            "ground (--base names the frame on the ground)"
        )
    roll, pitch, yaw = base_from_camera.roll_pitch_yaw()
    x, y, z = base_from_camera.translation_m.tolist()
    return {
        "model": "fisheye" if fisheye else "pinhole",
        "width": int(info.width),
        "height": int(info.height),
        "fx": float(matrix[0]),
        "fy": float(matrix[4]),
        "cx": float(matrix[2]),
        "cy": float(matrix[5]),
        "distortion": [*lens[:count].tolist(), *[0.0] * (count - len(lens[:count]))],
        "mount": {"x": x, "y": y, "z": z, "roll": roll, "pitch": pitch, "yaw": yaw},
    }


def _either(message: Any, name: str) -> Any:
    """A field that ROS 1 writes as a capital."""
    return getattr(message, name, None) if hasattr(message, name) else getattr(message, name.upper(), ())
