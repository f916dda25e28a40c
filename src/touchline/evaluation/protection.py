"""How well protection levels hold: counts of misleading images.

A protection level bounds an error that nobody knows while the robot plays; the alert limit is the error from which a
pose does harm. Where the truth is known each image falls in one region of Tossaint et al., "The Stanford-ESA Integrity
Diagram" (Navigation 54(2), 2007): error <= level <= limit is as promised; level > limit says itself that the pose is of
no use; error > level is misleading, and hazardously so where the limit lies between level and error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from touchline.geometry import FloatArray

ALERT_LIMIT_M, ALERT_LIMIT_RAD = 0.5, float(np.radians(15.0))


@dataclass(frozen=True, slots=True)
class ProtectionStatistics:
    """Of N tracked images: `bounded` have a protection level, whose median is `median` (NaN without any).

    In `misleading` of them the error is larger than the level; in `hazardous` of these it is beyond the alert limit
    while the level is not. `unavailable` have a level beyond the alert limit.
    """

    images: int
    bounded: int
    misleading: int
    hazardous: int
    unavailable: int
    median: float
    alert_limit: float

    @classmethod
    def of(cls, errors: FloatArray, levels: FloatArray, alert_limit: float) -> ProtectionStatistics:
        """From errors (N,) of either sign and levels (N,) in one unit (m or rad); NaN where no level was given."""
        size, bounded = np.abs(errors), np.isfinite(levels)
        misleading = bounded & (size > levels)
        hazardous = misleading & (size > alert_limit) & (levels <= alert_limit)
        return cls(
            images=len(size),
            bounded=int(bounded.sum()),
            misleading=int(misleading.sum()),
            hazardous=int(hazardous.sum()),
            unavailable=int(np.sum(bounded & (levels > alert_limit))),
            median=float(np.median(levels[bounded])) if bounded.any() else float("nan"),
            alert_limit=alert_limit,
        )


def protection_text(position: ProtectionStatistics, heading: ProtectionStatistics, end_open: int = 0) -> str:
    """How often the levels were exceeded, and how large they are, in a sentence. end_open: images in which the end of
    the field is.
    """
    none = position.images - position.bounded
    level = f"{100.0 * position.median:.1f} cm, {np.degrees(heading.median):.2f}°"
    return (
        f"misleading: {position.misleading} of {position.bounded} images in position, {heading.misleading} in heading; "
        f"median protection level {level}"
        + (f"; none given in {none}" if none else "")
        + (f"; given the end of the field, which is open in {end_open}" if end_open else "")
    )
