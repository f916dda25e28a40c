"""The camera as a system has learned it, and what was seen as that places it: pictures show why a pose is right."""

import dataclasses

import numpy as np

from touchline.camera import Camera, GroundView, PerspectiveCamera
from touchline.geometry import FloatArray
from touchline.motion.attitude import view_at
from touchline.types import Estimate, Frame, Observation

_ANGLES_RAD = np.linspace(0.05, 0.5, 10)  # to the optical axis, at which lines are seen


def as_learned(
    camera: Camera, frame: Frame, lean: tuple[float, float] | None, estimate: Estimate
) -> tuple[GroundView, Observation | None]:
    """A camera's view at a frame whose body leans by roll and pitch (rad), and what was seen: of a perspective camera
    without the errors that the estimate's system knows of it.
    """
    view, errors = view_at(camera, frame, lean), estimate.camera_errors
    if errors is None or not isinstance(camera, PerspectiveCamera):
        return view, estimate.observation
    mounted = dataclasses.replace(camera, base_from_camera=frame.base_from_camera or camera.base_from_camera)
    learned = view_at(mounted.corrected(errors, _ANGLES_RAD), dataclasses.replace(frame, base_from_camera=None), lean)
    return learned, None if estimate.observation is None else seen_through(estimate.observation, view, learned)


def seen_through(seen: Observation, before: GroundView, after: GroundView) -> Observation:
    """What was seen by a camera in one view on the ground, as that in another one places the same pixels; what neither
    shows stays where it is.
    """

    def moved(places: FloatArray) -> FloatArray:
        known = places.reshape(-1, 2)
        ground = after.ground_from_image(before.image_from_ground(known))
        return np.where(np.isfinite(ground).all(axis=1, keepdims=True), ground, known).reshape(places.shape)

    return dataclasses.replace(
        seen,
        points=dataclasses.replace(seen.points, positions_m=moved(seen.points.positions_m)),
        lines=dataclasses.replace(seen.lines, ends_m=moved(seen.lines.ends_m)),
        crossings=dataclasses.replace(seen.crossings, positions_m=moved(seen.crossings.positions_m)),
        landmarks=dataclasses.replace(seen.landmarks, positions_m=moved(seen.landmarks.positions_m)),
    )
