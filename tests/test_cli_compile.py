"""`touchline compile`, and what a first start says while it waits for the compiler."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numba

from touchline.cli.console import announce_compiling
from touchline.systems import SYSTEMS

RUN = [sys.executable, "-m", "touchline"]


def test_compile_names_every_system_and_leaves_nothing_to_compile(tmp_path: Path, small_data: Path) -> None:
    done = subprocess.run([*RUN, "compile"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert [name for name in SYSTEMS if f"{name}: ready after" not in done.stdout] == []
    example = Path(__file__).parents[1] / "examples" / "omni_msl_track_short"
    walk = [str(small_data / "humanoid_9x6_walk"), "--start=-2.6,-1.2,2.84"]
    for system, recording in (("nubot-mti", [str(example)]), ("nimbro-lines", walk), ("touchline", walk)):
        wanted = ["run", *recording, "--system", system, "-o", str(tmp_path / system)]
        ran = subprocess.run([*RUN, *wanted], capture_output=True, text=True)
        assert ran.returncode == 0, ran.stderr
        assert "compiling" not in ran.stderr


def test_a_first_start_says_once_what_it_waits_for() -> None:
    said: list[str] = []
    twice = numba.njit(lambda x: x + x)
    with announce_compiling(said.append):
        twice(1)
        twice(1.5)
    assert len(said) == 1
    assert "touchline compile" in said[0]
    with announce_compiling(said.append):
        twice(2)
    assert len(said) == 1


def test_a_read_only_package_folder_is_no_obstacle(tmp_path: Path) -> None:
    """Numba then keeps its cache in a folder of the user's, or in NUMBA_CACHE_DIR."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    code = "from touchline.field import open_field; open_field('indoor-9x6').distance_map(0.2)"
    subprocess.run([sys.executable, "-c", code], env=environment, check=True)
    assert list((tmp_path / "cache").rglob("*.nbi"))
