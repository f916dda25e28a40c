"""The picture of a calibrated mirror: the edges that were found (figure 2 of Lu et al., 2013), and the image."""

import cv2
import numpy as np

from touchline.camera import GroundView
from touchline.camera.model_free import range_image
from touchline.perception.stages import enlarged, titled
from touchline.published.strip.mirror import MirrorCalibration, Sighting
from touchline.types import ImageArray
from touchline.view.birds_eye import birds_eye_image

_MIRROR_SIDE = 900
_PURPLE = (220, 60, 200)
_PALE = (190, 190, 190)
_LEVELS_M = (0.6, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.5, 9.0, 12.0)


def mirror_picture(calibration: MirrorCalibration, image: ImageArray, sighting: Sighting) -> ImageArray:
    """(S, 3 S, 3) BGR: the image of a sighting with its edges, all edges on the distance map, the image on the ground.

    image: (H, W, 3) in which the sighting was made.
    """
    reach = 1.15 * float(calibration.strip.edges_m[-1])
    view = GroundView(calibration.camera)
    ground = birds_eye_image(image, view, reach_m=reach, pixels_per_m=round(_MIRROR_SIDE / 2.0 / reach))
    _draw_true_edges(ground, calibration, sighting, reach)
    panels = {
        f"{sighting.name}: edges found": _with_edges(image, [sighting]),
        f"distance map and all {len(calibration.sightings)} directions": _distance_panel(calibration),
        "the same image laid out in metres; purple: true edges": ground,
    }
    return np.hstack([titled(panel, title, _MIRROR_SIDE) for title, panel in panels.items()])


def _with_edges(image: ImageArray, sightings: list[Sighting]) -> ImageArray:
    scale = _MIRROR_SIDE / max(image.shape[:2])
    canvas = enlarged(image, scale)
    for sighting in sightings:
        for u, v in sighting.pixels[np.isfinite(sighting.radii_px)]:
            at = (round((float(u) + 0.5) * scale), round((float(v) + 0.5) * scale))
            cv2.drawMarker(canvas, at, _PURPLE, cv2.MARKER_TILTED_CROSS, 9, 1, cv2.LINE_AA)
    return canvas


def _distance_panel(calibration: MirrorCalibration) -> ImageArray:
    """Range as colour, with lines of equal range, white where it is known from edges and not continued."""
    distance = range_image(calibration.camera)
    logs = np.log(np.nan_to_num(distance, nan=1.0))
    low, high = np.log(_LEVELS_M[0]), np.log(_LEVELS_M[-1])
    grey = (255.0 * np.clip((logs - low) / (high - low), 0.0, 1.0)).astype(np.uint8)
    colored = cv2.applyColorMap(grey, cv2.COLORMAP_VIRIDIS)
    colored[np.isnan(distance)] = 24
    canvas = _with_edges(np.asarray(colored, dtype=np.uint8), list(calibration.sightings))
    size = (canvas.shape[1], canvas.shape[0])
    known = cv2.resize(distance.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
    first, last = calibration.strip.edges_m[[0, -1]]
    for level in _LEVELS_M:
        mask = (known > level).astype(np.uint8)
        contours, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        color = (255, 255, 255) if first <= level <= last else _PALE
        for contour in contours:
            points = contour[~np.isnan(cv2.GaussianBlur(known, (5, 5), 0)[contour[:, 0, 1], contour[:, 0, 0]])]
            for point in points[:: 1 if level <= last else 3]:
                canvas[point[0, 1], point[0, 0]] = color
    return canvas


def _draw_true_edges(ground: ImageArray, calibration: MirrorCalibration, sighting: Sighting, reach_m: float) -> None:
    middle = ground.shape[0] // 2
    scale = round(_MIRROR_SIDE / 2.0 / reach_m)
    x_axis = np.array([np.cos(sighting.bearing_rad), np.sin(sighting.bearing_rad)])
    y_axis = np.array([-x_axis[1], x_axis[0]])
    half = calibration.strip.half_width_m * 1.6
    for range_m in calibration.strip.edges_m:
        ends = [range_m * x_axis + side * half * y_axis for side in (-1.0, 1.0)]
        a, b = ((middle - round(float(e[1]) * scale), middle - round(float(e[0]) * scale)) for e in ends)
        cv2.line(ground, a, b, _PURPLE, 1, cv2.LINE_AA)
