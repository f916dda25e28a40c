"""The deliberate faults of `make mutants` still fit the code."""

from __future__ import annotations

import mutants


def test_the_text_of_every_fault_is_found_once() -> None:
    assert len(mutants.FAULTS) >= 60
    assert [(fault.file, fault.text) for fault in mutants.FAULTS if mutants.found(fault) != 1] == []
    assert len({fault[:3] for fault in mutants.FAULTS}) == len(mutants.FAULTS)


def test_the_tests_of_every_fault_exist() -> None:
    tests = mutants.ROOT / "tests"
    for fault in mutants.FAULTS:
        text = (tests / fault.tests).read_text(encoding="utf-8")
        for word in fault.words.split(" or "):
            assert word in text, fault
