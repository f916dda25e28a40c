"""How sure a camera.yaml with a mirror is of what it says: its key `uncertainty`."""

from pathlib import Path
from typing import Any, NamedTuple

from touchline.camera.reading import check_inner_keys, read_number
from touchline.errors import InputError
from touchline.messages import shown

USUAL_TILT_DEG = 0.3  # of a mirror as built
USUAL_CENTER_RATIO = 0.0075  # of the outer radius: a mirror displaced by 0.3 mm, 1.5 px in an image of 480 x 480
USUAL_RANGE_RATIO = 0.02  # two marks of a strip misread by a centimetre
_MAX_STATED = {"tilt_deg": 10.0, "center_px": 1000.0, "range_ratio": 0.5}


class CameraUncertainty(NamedTuple):
    """Standard deviations of what a mirror differs by from its camera.yaml.

    tilt_deg: lean about each horizontal axis; center_px: the image's centre along u and v; range_ratio: the ranges'
    scale. All zero: the file is exact, as that of a simulated ideal robot is.
    """

    tilt_deg: float
    center_px: float
    range_ratio: float

    def mapping(self) -> dict[str, float]:
        """The value of the key `uncertainty`."""
        return {key: round(float(value), 5) for key, value in self._asdict().items()}


def usual_uncertainty(outer_radius_px: float) -> CameraUncertainty:
    """That of a file which doesn't state it: a mirror as built, and ranges that somebody has measured."""
    return CameraUncertainty(USUAL_TILT_DEG, USUAL_CENTER_RATIO * outer_radius_px, USUAL_RANGE_RATIO)


def read_uncertainty(tree: dict[str, Any], outer_radius_px: float, path: Path) -> CameraUncertainty | None:
    """The key `uncertainty` of a camera.yaml, what it leaves out as usual; None without it. Raises InputError."""
    values = tree.get("uncertainty")
    if values is None:
        return None
    if not isinstance(values, dict):
        known = ", ".join(CameraUncertainty._fields)
        raise InputError(f"{path}: 'uncertainty' must be a mapping of {known}, found {shown(values)}")
    check_inner_keys(values, CameraUncertainty._fields, path, "uncertainty")
    stated = {}
    for key, value in values.items():
        stated[key] = read_number(value, path, f"uncertainty.{key}")
        if not 0.0 <= stated[key] <= _MAX_STATED[key]:
            raise InputError(
                f"{path}: 'uncertainty.{key}' must lie between 0 and {_MAX_STATED[key]:g}, found {value:g}"
            )
    return usual_uncertainty(outer_radius_px)._replace(**stated)
