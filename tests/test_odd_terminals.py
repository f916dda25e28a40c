"""Outputs that are closed, narrow, or know no umlauts: no accident, nothing lost, no path in two."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest
from fakes import write_recording

PATHS = os.pathsep.join([str(Path(__file__).parents[1] / "src"), sysconfig.get_path("purelib")])
NAME = "Übung-auf-dem-großen-Feld-mit-einem-Namen-von-mehr-als-sechzig-Zeichen"
# Without Python's own start (-S), which fails where LC_ALL=C and a file leads to a checkout in a folder with an umlaut.
TOUCHLINE = f"{shlex.quote(sys.executable)} -S -m touchline"


def ended(command: str, folder: Path, **environment: str) -> subprocess.CompletedProcess[bytes]:
    variables = {**os.environ, "PYTHONPATH": PATHS, **environment}
    return subprocess.run(command, shell=True, cwd=folder, env=variables, capture_output=True, check=False)


@pytest.mark.parametrize(("command", "end"), [("systems", "| head -1"), ("--help", ">&-"), ("fields", ">&- 2>&-")])
def test_a_closed_output_is_no_accident(tmp_path: Path, command: str, end: str) -> None:
    done = ended(f"{TOUCHLINE} {command} {end}", tmp_path)
    assert (done.returncode, done.stderr) == (0, b"")


@pytest.mark.slow
@pytest.mark.parametrize("environment", [{"COLUMNS": "60"}, {"LC_ALL": "C", "COLUMNS": "60"}])
def test_paths_are_written_whole(tmp_path: Path, environment: dict[str, str]) -> None:
    write_recording(tmp_path / NAME)
    (tmp_path / NAME / "sequence.yaml").unlink()
    for command in ("run", "check"):
        done = ended(f"{TOUCHLINE} {command} {NAME}", tmp_path, **environment)
        assert done.returncode == 2
        assert NAME in done.stderr.decode()
    done = ended(f"{TOUCHLINE} fields new {NAME} A=18", tmp_path, **environment)
    assert (done.returncode, done.stderr) == (0, b"")
    assert f"{NAME}.yaml" in done.stdout.decode()


@pytest.mark.slow
def test_what_an_encoding_lacks_is_written_in_other_signs(tmp_path: Path) -> None:
    done = ended(f"{TOUCHLINE} fields new Übung A=18", tmp_path, PYTHONIOENCODING="ascii")
    assert (done.returncode, done.stderr) == (0, b"")
    assert rb"\xdcbung.yaml" in done.stdout


@pytest.mark.slow
def test_a_narrow_terminal_cuts_no_name_of_a_setting(tmp_path: Path) -> None:
    done = ended(f"{TOUCHLINE} systems nubot-mti", tmp_path, COLUMNS="40")
    assert "…" not in done.stdout.decode()
    assert b"matching.uncertainty.min_position_m " in done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("columns", ["0", "1"])
def test_a_terminal_without_columns_shows_tables(tmp_path: Path, columns: str) -> None:
    poses = "".join(f"{k / 10:.1f} {k} 0 0 0 0 0 1\n" for k in range(8))
    for name in ("a.tum", "b.tum"):
        (tmp_path / name).write_text(poses)
    done = ended(f"{TOUCHLINE} evaluate a.tum --truth b.tum", tmp_path, COLUMNS=columns, MPLBACKEND="nonsense")
    assert (done.returncode, done.stderr) == (0, b"")
    assert "position (cm)" in done.stdout.decode()
