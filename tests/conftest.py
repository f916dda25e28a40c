"""Fixtures that every test file may use."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of the public recordings: TOUCHLINE_DATA, or shared/data beside the checkout."""
    folder = Path(os.environ.get("TOUCHLINE_DATA", Path(__file__).parents[2] / "shared" / "data"))
    if not folder.is_dir():
        pytest.fail(f"the public recordings are not at {folder}; set TOUCHLINE_DATA to their folder")
    return folder
