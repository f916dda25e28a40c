"""The colours of all pages and figures: those of Okabe and Ito (2008), which colour-blind eyes tell apart."""

BLUE, VERMILLION, GREEN, PURPLE = "#0072b2", "#d55e00", "#009e73", "#cc79a7"
ORANGE, SKY, YELLOW, BLACK = "#e69f00", "#56b4e9", "#f0e442", "#000000"
SERIES = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY)
"""Of things of one kind side by side, in this order; the pages' stylesheet has them as --run-0 to --run-5."""


def bgr(color: str) -> tuple[int, int, int]:
    """A colour #rrggbb as OpenCV draws with it."""
    red, green, blue = (int(color[place : place + 2], 16) for place in (1, 3, 5))
    return blue, green, red
