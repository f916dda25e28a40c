"""Whether each image alone shows the mirror that all show together: those of two robots may seem to show one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from touchline.calibration.lines.certainty import certainty_of
from touchline.calibration.lines.equations import BEND_X, Lines, Seen
from touchline.calibration.lines.joint import HELD, fit_in_steps
from touchline.calibration.lines.mirror_shape import MirrorShape
from touchline.calibration.lines.range_curve import CurveFit
from touchline.calibration.lines.search import WIDTHS
from touchline.geometry import FloatArray

# how far an image may be off beside SURELY standard deviations: a head that shakes by 0.3 degrees moves the centre by a
# pixel or two
APART_PX, APART_RATIO = 2.0, 0.03
SURELY = 4.0


class Alone(NamedTuple):
    """How far an image alone has the centre (2,) from where all have it (px) and, as a share, the range in the middle
    of its points; with standard deviations.
    """

    offset_px: FloatArray
    sigma_px: FloatArray
    range_ratio: float
    range_sigma: float

    def __str__(self) -> str:
        off_px, sigma_px = float(np.hypot(*self.offset_px)), float(self.sigma_px.max())
        return (
            f"alone has the mirror's centre {off_px:.1f} px (± {sigma_px:.1f}) from where all images have it, and its "
            f"ranges {100 * self.range_ratio:+.1f} % (± {100 * self.range_sigma:.1f})"
        )

    @property
    def is_another(self) -> bool:
        """Whether that is more than chance, and than one robot's head does from image to image."""
        off_px = np.abs(self.offset_px) > np.maximum(SURELY * self.sigma_px, APART_PX)
        return bool(off_px.any()) or abs(self.range_ratio) > max(SURELY * self.range_sigma, APART_RATIO)


def each_alone(found: CurveFit, seen: Sequence[Seen], lines: Lines) -> tuple[Alone, ...]:
    """Each image's own centre and ranges beside those of a fit to all, which bend and curve are taken from."""
    return tuple(_alone(found, k, one, lines) for k, one in enumerate(seen)) if len(seen) > 1 else ()


def _alone(found: CurveFit, k: int, one: Seen, lines: Lines) -> Alone:
    together = found.fit
    held = np.diag(np.where(np.arange(len(together.mirror)) >= BEND_X, HELD, 0.0))
    expected = found.expected._replace(mean=together.mirror, information=held, wider=None)
    fit = fit_in_steps([one], together._replace(poses=together.poses[k : k + 1]), expected, lines)
    certainty = certainty_of(CurveFit(fit, expected, found.curvature), [one], lines)
    own, all_of_them = (MirrorShape(each.mirror, 1, one.knot_px, np.zeros(2)) for each in (fit, together))
    radii, good = np.hypot(*(one.pixels - own.axis).T), certainty.residuals < WIDTHS[-1]
    middle = np.array([np.median(radii[good] if good.any() else radii)])
    ratio = float(own.range_m(middle)[0] / all_of_them.range_m(middle)[0]) - 1.0
    sigma = float(certainty.range_ratio(own, middle)[0])
    return Alone(own.axis - all_of_them.axis, certainty.center_px, ratio, sigma)
