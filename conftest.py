"""Where tests find their data, and fixtures that every test file may use.

The repository carries what its tests need in tests/data. The full recordings are laid out alike; they are looked for in
the folder that TOUCHLINE_DATA names, else in shared/data beside the checkout. No other file looks outside the checkout.
"""

from __future__ import annotations

import gc
import os
from pathlib import Path

import pytest

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command does; before NumPy is imported

SMALL_DATA = Path(__file__).parent / "tests" / "data"
NAMED = os.environ.get("TOUCHLINE_DATA")
FULL_DATA = Path(NAMED) if NAMED else Path(__file__).parents[1] / "shared" / "data"
RECORDINGS = sorted(file.parent.name for file in SMALL_DATA.glob("*/sequence.yaml"))
MISSING = [name for name in RECORDINGS if not (FULL_DATA / name / "sequence.yaml").is_file()]


@pytest.fixture(scope="session")
def small_data() -> Path:
    """Recordings cut short and small real data: always there."""
    return SMALL_DATA


@pytest.fixture(
    scope="module",  # pytest would take a file apart for one of the session, and set its own fixtures up for each part
    params=[pytest.param(SMALL_DATA, id="short"), *([] if MISSING else [pytest.param(FULL_DATA, id="full")])],
)
def shared_data(request: pytest.FixtureRequest) -> Path:
    """A folder of recordings: a test that takes it runs on those cut short and, where found, on the full ones."""
    return Path(request.param)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--every", type=int, default=1, metavar="N", help="run every Nth test only")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    items[:] = items[:: config.getoption("--every")]


def pytest_collection_finish() -> None:
    """What is there by now stays to the end: the garbage collector need not walk over it again and again."""
    gc.collect()
    gc.freeze()


def pytest_configure() -> None:
    if NAMED and MISSING:
        raise pytest.UsageError(
            f"TOUCHLINE_DATA names {NAMED}, which lacks {', '.join(MISSING)}: "
            "name the folder of the full recordings, or unset it to run on those cut short only"
        )


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    if MISSING:
        terminalreporter.write_line(
            "Recordings: those cut short, in tests/data; the full ones were not found and did not run "
            "(TOUCHLINE_DATA names their folder)."
        )
    else:
        terminalreporter.write_line(f"Recordings: those cut short, in tests/data, and the full ones, in {FULL_DATA}.")
