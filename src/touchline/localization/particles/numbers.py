"""How many particles a filter needs (Fox 2003: Adapting the sample size in particle filters through KLD-sampling)."""

from __future__ import annotations

import math

from pydantic import Field

from touchline.config import Settings


class AdaptiveSettings(Settings):
    """Particle numbers by Kullback-Leibler distance (Fox 2003): references 8, 9, 12 of the paper, which keeps 600."""

    enabled: bool = Field(False, description="draw only as many particles as the spread asks for; the paper keeps all")
    error: float = Field(0.05, gt=0, description="largest distance (nats) between the samples and the truth: Fox's")
    quantile: float = Field(2.326, gt=0, description="standard normal quantile of keeping it: 99 %, as Fox")
    bin_m: float = Field(0.5, gt=0, description="size of a bin in x and y (m): Fox's 50 cm")
    bin_rad: float = Field(0.2618, gt=0, description="size of a bin in heading (rad): Fox's 15 degrees")
    kept_share: float = Field(
        0.5,
        gt=0,
        le=1,
        description="share of the particles that every drawing keeps at least: one good draw may agree on a look-alike "
        "place, five in a row don't. Near 0 is Fox's own, the number that is asked for at once",
    )
    least: int = Field(1, ge=1, description="fewest particles: one when certain (references 8 and 9)")


def kld_number(bins: int, settings: AdaptiveSettings) -> int:
    """Particles that keep the Kullback-Leibler distance below its limit, for so many occupied bins (Fox 2003, eq. 7).

    A single bin needs a single particle.
    """
    if bins <= 1:
        return settings.least
    a = 2.0 / (9.0 * (bins - 1))
    number = (bins - 1) / (2.0 * settings.error) * (1.0 - a + math.sqrt(a) * settings.quantile) ** 3
    return max(settings.least, math.ceil(number))
