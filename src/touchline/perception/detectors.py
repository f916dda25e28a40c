"""The detector of our own system for each kind of camera."""

from touchline.camera import Camera, PerspectiveCamera
from touchline.field import FieldModel
from touchline.perception.detector import Detector
from touchline.perception.line_graph.patches import line_graph_detector
from touchline.perception.line_graph.settings import LineGraphSettings
from touchline.perception.self_learning import SelfLearningDetector


def detector_for(camera: Camera | None, field: FieldModel) -> Detector | None:
    """Line points in the images of a mirror, lines and features in those of any other camera; None without one."""
    if camera is None:
        return None
    if not isinstance(camera, PerspectiveCamera):
        return SelfLearningDetector(camera, line_width_m=field.line_width)
    return line_graph_detector(camera, LineGraphSettings(), field)
