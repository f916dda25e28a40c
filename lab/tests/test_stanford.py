"""The Stanford diagram of errors and protection levels."""

from __future__ import annotations

import numpy as np
import pytest

from touchline_lab.stanford import stanford_diagram

ERRORS = np.array([0.01, -0.02, 0.2, 0.7, 0.7, 2.0, 0.1, 0.1])
LEVELS = np.array([0.05, 0.05, 0.1, 0.1, 1.0, 1.0, np.nan, 0.1])


def test_images_fall_in_the_regions_of_the_diagram() -> None:
    figure, counts = stanford_diagram(ERRORS, LEVELS, 0.5, title="drawn up")
    assert (counts.images, counts.bounded, counts.misleading, counts.hazardous, counts.unavailable) == (8, 7, 3, 1, 2)
    assert counts.median == pytest.approx(0.1)
    (axes,) = figure.axes
    assert [text.get_text() for text in axes.texts] == [
        "as promised: 3 of 8", "bound beyond 0.5 m: 2", "misleading\n2", "hazardously misleading\n1",
    ]  # fmt: skip
    wrong = next(line for line in axes.lines if line.get_marker() == "o")
    np.testing.assert_allclose(wrong.get_xydata(), [(0.2, 0.1), (0.7, 0.1), (2.0, 1.0)])
    assert axes.get_title() == "drawn up"


def test_without_any_level_nothing_is_bounded() -> None:
    counts = stanford_diagram(ERRORS, np.full(8, np.nan))[1]
    assert (counts.images, counts.bounded, counts.misleading, np.isnan(counts.median)) == (8, 0, 0, True)
