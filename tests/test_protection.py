"""Protection levels against errors: what counts as misleading, and how sure a rate is."""

from __future__ import annotations

import numpy as np
import pytest
from fakes import STEP_NS, true_samples

from touchline.evaluation.metrics import error_table
from touchline.evaluation.protection import ProtectionStatistics, protection_text
from touchline.types import Samples


def test_images_without_a_level_are_unavailable_and_never_misleading() -> None:
    errors, levels = (
        np.array([0.01, -0.02, 0.2, 0.7, 0.7, 2.0, 0.1, 0.1]),
        np.array([5, 5, 10, 10, 100, 100, np.nan, 10]),
    )
    counts = ProtectionStatistics.of(errors, levels / 100.0, 0.5)
    assert (counts.images, counts.bounded, counts.misleading, counts.hazardous, counts.unavailable) == (8, 7, 3, 1, 2)
    assert counts.median == pytest.approx(0.1)
    counts = ProtectionStatistics.of(errors, np.full(8, np.nan), 0.5)
    assert (counts.images, counts.bounded, counts.misleading, np.isnan(counts.median)) == (8, 0, 0, True)


def test_the_error_table_tells_how_often_levels_are_exceeded() -> None:
    truth = true_samples(6)
    moved = Samples(truth.stamp_ns, truth.values + np.outer([0.0, 0.01, 0.2, 3.0, 0.01, 0.01], [1.0, 0.0, 0.0]))
    levels = np.column_stack((np.full(6, 0.05), np.full(6, 0.02)))
    levels[4] = np.nan
    tracked = np.array([True, True, True, False, True, True])
    table = error_table(moved, truth, located=tracked, black_ns=[(5 * STEP_NS, 5 * STEP_NS)], protection=levels)
    position, heading = table.protection_position, table.protection_heading
    assert position is not None
    assert heading is not None
    assert (position.images, position.bounded, position.misleading, heading.misleading) == (4, 3, 1, 0)
    said = "misleading: 1 of 3 images in position, 0 in heading; median protection level 5.0 cm, 1.15°; none given in 1"
    assert protection_text(position, heading) == said
    assert str(table).endswith(said)
    assert said in table._repr_html_()
    assert table.as_dict()["protection_position"]["misleading"] == 1
    without = error_table(moved, truth, located=tracked)
    assert (without.protection_position, without.protection_heading, len(without.notes())) == (None, None, 1)


def test_levels_hold_given_the_end_where_that_is_open() -> None:
    truth = true_samples(4)
    turned = Samples(truth.stamp_ns, truth.values * (-1.0, -1.0, 1.0) + (0.01, 0.0, np.pi))
    levels, is_open = np.column_stack((np.full(4, 0.05), np.full(4, 0.02))), np.array([True, True, True, False])
    table = error_table(turned, truth, protection=levels, end_open=is_open)
    assert table.protection_position is not None
    assert (table.protection_position.misleading, table.end_open) == (1, 3)
    assert table.position.mean > 0.5, "where the robot is said to stand stays an error"
    assert str(table).endswith("given the end of the field, which is open in 3")
