"""Image -> observation: colour classes, scan lines, the field's boundary, line points."""

from touchline.perception.line_points import LinePointDetector, LinePointSettings

__all__ = ["LinePointDetector", "LinePointSettings"]
