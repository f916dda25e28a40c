"""Two thousand hostile files: each is read or refused, never a foreign exception, a hang or much memory.

`make fuzz N=20000` reads any number of them.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest
import yaml
from fuzz_readers import Reader, all_readers
from fuzzing import hostile, outcome, turns
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

INPUTS, BY_HYPOTHESIS = 1750, 250
PARTS = 4
_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=10),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4),
    max_leaves=8,
)
_TREES = _VALUES.map(lambda value: yaml.safe_dump(value, default_flow_style=True).encode())


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


@pytest.mark.slow
@pytest.mark.parametrize("part", range(PARTS))
def test_hostile_files_that_hypothesis_thinks_of(readers: list[Reader], part: int) -> None:
    quick = [reader for reader in readers if reader.share >= 0.5][part::PARTS]

    @settings(
        max_examples=BY_HYPOTHESIS // PARTS,
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(
        reader=st.sampled_from(quick),
        change=st.one_of(st.binary(max_size=60), st.text(max_size=60).map(lambda text: text.encode()), _TREES),
        first=st.floats(0.0, 1.0),
        last=st.floats(0.0, 1.0),
    )
    def read(reader: Reader, change: bytes, first: float, last: float) -> None:
        seed = reader.seeds[0]
        data = seed[: int(first * len(seed))] + change + seed[int(max(first, last) * len(seed)) :]
        found = outcome(reader, 0, data)
        assert not found.fault, found

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        read()


def test_the_same_number_makes_the_same_input(readers: list[Reader]) -> None:
    assert [hostile(one, 1, 5) for one in readers] == [hostile(one, 1, 5) for one in readers]


def test_faults_are_noticed(tmp_path: Path) -> None:
    def foreign(path: Path) -> None:
        raise OverflowError("by design")

    found = outcome(Reader("foreign", tmp_path / "a", [b"a"], foreign), 0, b"a")
    assert (found.end, found.fault.strip()) == ("OverflowError", "OverflowError: by design")
    large = outcome(Reader("large", tmp_path / "a", [b"a"], lambda path: bytearray(200_000_000)), 0, b"a")
    assert large.fault.startswith("took ")
    assert large.megabytes == pytest.approx(200.0, rel=0.1)
