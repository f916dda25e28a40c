"""Two thousand hostile files: each is read or refused, never a foreign exception, a hang or much memory.

`make fuzz N=20000` reads any number of them.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest
from fuzz_readers import Reader, all_readers
from fuzzing import hostile, outcome, turns

INPUTS = 2000
PARTS = 4


@pytest.fixture(scope="module")
def readers(tmp_path_factory: pytest.TempPathFactory) -> list[Reader]:
    made = all_readers(tmp_path_factory.mktemp("fuzz"))
    for reader in made:
        reader.try_one(reader.seeds[0])  # as it is; what it needs is loaded before anything is measured
    return made


@pytest.mark.slow
@pytest.mark.parametrize("part", range(PARTS))
def test_hostile_files_are_read_or_refused(
    readers: list[Reader], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, part: int
) -> None:
    monkeypatch.chdir(tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = [outcome(one, k, hostile(one, 0, k)) for one, k in turns(readers, INPUTS)[part::PARTS]]
    assert [one for one in found if one.fault] == []


def test_faults_are_noticed(tmp_path: Path) -> None:
    def foreign(path: Path) -> None:
        raise OverflowError("by design")

    found = outcome(Reader("foreign", tmp_path / "a", [b"a"], foreign), 0, b"a")
    assert (found.end, found.fault.strip()) == ("OverflowError", "OverflowError: by design")
    large = outcome(Reader("large", tmp_path / "a", [b"a"], lambda path: bytearray(200_000_000)), 0, b"a")
    assert large.fault.startswith("took ")
    assert large.megabytes == pytest.approx(200.0, rel=0.1)
