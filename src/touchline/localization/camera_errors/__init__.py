"""What a built camera differs by from its camera.yaml."""

from touchline.camera import Camera, PerspectiveCamera
from touchline.localization.camera_errors.base import CameraErrors
from touchline.localization.camera_errors.mirror import mirror_errors
from touchline.localization.camera_errors.perspective import perspective_errors


def camera_errors(camera: Camera | None, height_m: float | None = None) -> CameraErrors:
    """Those of a camera; without one of a perspective camera at a height, or of an undescribed mirror."""
    if isinstance(camera, PerspectiveCamera) or (camera is None and height_m is not None):
        return perspective_errors(camera, height_m)
    return mirror_errors(camera)


__all__ = ["CameraErrors", "camera_errors"]
