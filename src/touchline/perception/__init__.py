"""Image -> observation: colour classes, scan lines, the field's boundary, line points."""

from touchline.perception.detector import Detector, observe
from touchline.perception.detectors import detector_for
from touchline.perception.line_graph.detector import LineGraphDetector
from touchline.perception.line_graph.patches import line_graph_detector
from touchline.perception.line_graph.settings import LineGraphSettings
from touchline.perception.line_points import LinePointDetector, LinePointSettings
from touchline.perception.self_learning import LearningSettings, SelfLearningDetector

__all__ = [
    "Detector",
    "LearningSettings",
    "LineGraphDetector",
    "LineGraphSettings",
    "LinePointDetector",
    "LinePointSettings",
    "SelfLearningDetector",
    "detector_for",
    "line_graph_detector",
    "observe",
]
