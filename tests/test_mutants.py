"""`make mutants` can lay faults into every room, and finds tests for them."""

from __future__ import annotations

import ast

import mutants
import pytest

TEXT = """
class Shape:
    def area(self, a: float, name: str = "x") -> float:
        if not a < 1.5:
            raise ValueError(f"{a + 1.0}")
        a += -a
        return a * a
"""


def test_a_fault_is_one_change_of_a_function() -> None:
    ((name, function),) = mutants.functions(ast.parse(TEXT))
    assert name == "Shape.area"
    plain = ast.unparse(ast.parse(TEXT))
    said = []
    for place in mutants.sites(function):
        text, change = mutants.laid(mutants.Fault("shapes", name, ast.unparse(place)), TEXT) or ("", "")
        assert sum(a != b for a, b in zip(text.splitlines(), plain.splitlines(), strict=True)) == 1
        said.append(change.partition(": ")[2])
    assert said == [
        "not a < 1.5 -> a < 1.5", "a < 1.5 -> a >= 1.5", "1.5 -> 4.0", "a += -a -> a -= -a", "-a -> a", "a * a -> a / a"
    ]  # fmt: skip


def test_words_are_left_alone() -> None:
    for text in ("'a' + b", "f'{a}' + b", "[1] + b", "-x if True else 1"):
        assert mutants.with_fault(ast.parse(text, mode="eval").body) is None


@pytest.mark.slow
def test_every_room_gets_the_same_faults_for_the_same_seed() -> None:
    faults = mutants.drawn(1, 3)
    assert faults == mutants.drawn(1, 3)
    assert len({mutants.room_of(fault.module) for fault in faults}) > 0.8 * len(mutants.rooms())


@pytest.mark.slow
def test_tests_are_found_that_lead_to_a_function() -> None:
    found = mutants.tests_of(mutants.Fault("touchline.geometry", "Pose.compose", ""))
    assert found[0].startswith("tests/test_geometry.py::")
    faults = mutants.drawn(1, 3)
    assert sum(bool(mutants.tests_of(fault)) for fault in faults) > 0.9 * len(faults)
