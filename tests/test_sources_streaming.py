"""Recordings of any length run in constant memory, and no row of any file can end the reading."""

from __future__ import annotations

import gc
import tempfile
import tracemalloc
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import example, given, settings
from hypothesis import strategies as st
from small_recordings import write_recording, write_sensors

from touchline.errors import InputError
from touchline.sources import ProblemKind, ProblemLog, Recording, open_source
from touchline.sources.sensors import SensorStream, increasing_rows
from touchline.sources.tables import open_table

HEADER = "t,x,y,theta"
ROW_PROBLEMS = (ProblemKind.BROKEN_ROW, ProblemKind.NOT_A_NUMBER, ProblemKind.TIME_ORDER)


def read_odometry(content: bytes) -> tuple[np.ndarray, np.ndarray, ProblemLog]:
    """Stamps, values and problems of an odometry.csv with these bytes."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "odometry.csv"
        path.write_bytes(content)
        log = ProblemLog()
        parts = list(SensorStream(open_table(path, HEADER.split(",")), ("x", "y", "theta"), log))
    stamps = np.concatenate([np.zeros(0, dtype=np.int64), *(part.stamp_ns for part in parts)])
    values = np.concatenate([np.zeros((0, 3)), *(part.values for part in parts)])
    return stamps, values, log


cells = st.one_of(
    st.floats(width=64).map(repr),
    st.floats(0, 100).map(lambda number: f"{number:.3f}"),
    st.sampled_from(["", " ", "nan", "-inf", "1e400", "1_0", "0x1F", "#", '"', "1.5 ", "+2", "１", "１e9", "\r"]),
    st.text(max_size=5),
)
rows = st.lists(cells, min_size=1, max_size=6).map(",".join)


@settings(max_examples=60, deadline=None)
@given(lines=st.lists(rows, max_size=40))
@example(lines=["0,1,2,3", "0.02,1,2,3\r4,5,6,7", "0.04,1,2,3"])
@example(lines=["0,1,2,3", "", "0.02,1,2,3", "\xa0", "0.02,1,2,3"])
def test_every_row_is_either_used_or_reported(lines: list[str]) -> None:
    content = "\n".join([HEADER, *lines]).encode("utf-8", errors="replace")
    stamps, values, log = read_odometry(content)
    assert (np.diff(stamps) > 0).all()
    assert np.isfinite(values).all()
    written = [line for line in content.decode("latin-1").split("\n")[1:] if line.strip()]
    assert len(stamps) + sum(log.counts[kind] for kind in ROW_PROBLEMS) == len(written)
    assert all(problem.message.startswith("odometry.csv") for problem in log)


@settings(max_examples=40, deadline=None)
@given(content=st.binary(max_size=400))
def test_bytes_of_any_kind_are_survived(content: bytes) -> None:
    stamps, values, _ = read_odometry(HEADER.encode() + b"\n" + content)
    assert len(stamps) == len(values)


@settings(max_examples=25, deadline=None)
@given(
    numbers=st.lists(st.tuples(*[st.floats(-1e6, 1e6)] * 3), min_size=1, max_size=30),
    broken=st.booleans(),
)
def test_numbers_are_read_exactly(numbers: list[tuple[float, float, float]], broken: bool) -> None:
    """Well-formed blocks are parsed at once, others row by row: both give what Python reads."""
    lines = [f"{0.02 * index:.3f},{x!r},{y!r},{theta!r}" for index, (x, y, theta) in enumerate(numbers)]
    _, values, _ = read_odometry("\n".join([HEADER, *lines, *(["0,spoiled"] if broken else [])]).encode())
    np.testing.assert_array_equal(values, np.array(numbers))


def test_a_line_without_end_is_one_broken_row() -> None:
    content = f"{HEADER}\n0,1,2,3\n{'7' * 300_000}\n0.02,1,2,3\n".encode()
    stamps, _, log = read_odometry(content)
    assert stamps.tolist() == [0, 20_000_000]
    assert [(problem.kind, problem.line) for problem in log] == [(ProblemKind.BROKEN_ROW, 3)]


@settings(max_examples=40, deadline=None)
@given(stamps=st.lists(st.integers(0, 12), max_size=9), above=st.integers(-1, 5))
def test_as_many_rows_as_possible_keep_the_order(stamps: list[int], above: int) -> None:
    kept = increasing_rows(np.array(stamps, dtype=np.int64), above)
    chosen = [stamp for stamp, keep in zip(stamps, kept, strict=True) if keep]
    assert all(first < second for first, second in pairwise([above, *chosen]))
    best = 0
    for subset in range(1 << len(stamps)):  # every choice of rows there is
        picked = [above, *(stamp for bit, stamp in enumerate(stamps) if subset >> bit & 1)]
        if all(first < second for first, second in pairwise(picked)):
            best = max(best, len(picked) - 1)
    assert len(chosen) == best


values_of_any_kind = st.recursive(
    st.none() | st.booleans() | st.integers() | st.just(10**400) | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["t", "kind", "x"]), inner, max_size=3),
    max_leaves=6,
)


@pytest.fixture(scope="module")
def described(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, dict[str, object]], Path]:
    folder = write_recording(tmp_path_factory.mktemp("fuzz") / "small", frames=2)
    sound = (folder / "sequence.yaml").read_text()

    def write(name: str, tree: dict[str, object]) -> Path:
        (folder / "sequence.yaml").write_text(sound)
        (folder / "camera.yaml").write_text("model: omni\nwidth: 48\nheight: 32\n")
        known = yaml.safe_load((folder / name).read_text())
        (folder / name).write_text(yaml.safe_dump(known | tree))
        return folder

    return write


def opened_or_refused(folder: Path) -> Recording | str:
    """The recording, or the message that refused it; any other error fails the test."""
    try:
        return open_source(folder)
    except InputError as error:
        return str(error)


@settings(max_examples=60, deadline=None)
@given(
    key=st.sampled_from(["format", "name", "field", "camera", "rate_hz", "events", "sensor", "wheels", "imu"]),
    value=values_of_any_kind,
)
def test_no_value_in_sequence_yaml_ends_in_a_traceback(
    described: Callable[[str, dict[str, object]], Path], key: str, value: object
) -> None:
    opened = opened_or_refused(described("sequence.yaml", {key: value}))
    if isinstance(opened, str):
        assert "sequence.yaml" in opened
    else:
        assert len(list(opened)) == 2
        assert opened.rate_hz > 0


def repeat_images(folder: Path, frames: int) -> Path:
    """The same few images over and over, with sensors to match."""
    rows = [f"{0.1 * index + 0.1:.4f},images/{index % 4:06d}.jpg,12,1.7" for index in range(frames)]
    (folder / "images.csv").write_text("\n".join(["t,file,exposure_ms,gain", *rows]) + "\n")
    (folder / "ground_truth.tum").unlink()
    write_sensors(folder, 5 * frames + 10)
    return folder


def peak_of_reading(folder: Path) -> tuple[int, int]:
    """Bytes held by the opened recording, and the peak beyond them while all frames are read."""
    gc.collect()  # what others left behind must not be counted, nor given back in between
    tracemalloc.start()
    try:
        source = open_source(folder)
        held = tracemalloc.get_traced_memory()[0]
        tracemalloc.reset_peak()
        for frame in source:
            assert frame.image is not None
        return held, tracemalloc.get_traced_memory()[1] - held
    finally:
        tracemalloc.stop()


@pytest.mark.slow
def test_memory_does_not_grow_with_the_length(tmp_path: Path) -> None:
    short = repeat_images(write_recording(tmp_path / "short", frames=4), 1200)  # long enough to fill a block of a table
    long = repeat_images(write_recording(tmp_path / "long", frames=4), 2400)
    peak_of_reading(write_recording(tmp_path / "first", frames=4))  # what is set up once
    held_short, peak_short = peak_of_reading(short)
    held_long, peak_long = peak_of_reading(long)
    assert peak_long < peak_short + 50_000
    assert held_long - held_short < 64 * 1200  # a list of stamps, not of frames
