"""Lines, crossings and landmarks of a perspective camera, by the line structure graph of Schulz and Behnke (2012)."""

from touchline.perception.line_graph.detector import LineGraphDetector
from touchline.perception.line_graph.settings import LineGraphPaper, LineGraphSettings

__all__ = ["LineGraphDetector", "LineGraphPaper", "LineGraphSettings"]
