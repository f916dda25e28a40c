"""sensor_msgs/PointCloud2 as an array of places."""

from __future__ import annotations

from typing import Any

import numpy as np

from touchline.geometry import FloatArray

_TYPES = {7: "f4", 8: "f8"}
_MAX_POINTS = 2_000_000


def cloud_points(message: Any) -> FloatArray | str:
    """(N, 3) the finite ones of its points x, y, z, in its frame, or why there are none."""
    fields = {field.name: field for field in message.fields}
    missing = [name for name in "xyz" if name not in fields or fields[name].datatype not in _TYPES]
    if missing:
        return f"has no number {' and '.join(missing)} of its points"
    width, height, step = int(message.width), int(message.height), int(message.point_step)
    data = np.asarray(message.data, dtype=np.uint8)
    line = int(message.row_step) if height > 1 else width * step
    if width * height > _MAX_POINTS or line < width * step or len(data) < line * (height - 1) + width * step:
        return f"holds {len(data)} bytes, not those of {width}×{height} points"
    order = ">" if message.is_bigendian else "<"
    formats = [f"{order}{_TYPES[fields[name].datatype]}" for name in "xyz"]
    offsets = [int(fields[name].offset) for name in "xyz"]
    if not width * height:
        return np.zeros((0, 3))
    if any(offset + int(kind[-1]) > step for offset, kind in zip(offsets, formats, strict=True)):
        return "has fields beyond the end of a point"
    each = np.dtype({"names": list("xyz"), "formats": formats, "offsets": offsets, "itemsize": step})
    rows = [data[row * line : row * line + width * step].view(each) for row in range(height)]
    points = np.concatenate([np.column_stack([row[name] for name in "xyz"]) for row in rows]).astype(np.float64)
    finite: FloatArray = points[np.isfinite(points).all(axis=1)]
    return finite
