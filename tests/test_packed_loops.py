"""Loops that come compiled in a wheel: found where all fits, else left alone, and never in the way of others."""

from __future__ import annotations

import importlib
import json
import os
import platform
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import kernel_wheels
import numba
import pytest

import touchline
from touchline.cli import main
from touchline.packed_loops import DESCRIPTION, PACKAGE, surroundings, take_packed_loops

USED = """
import sys, numba, numpy as np
from touchline import Pose
from touchline.packed_loops import take_packed_loops
taken_already = take_packed_loops.cache_info().currsize
said = take_packed_loops()
from touchline.compiling import load_loops_lean
from touchline.matrices import inverse, log_determinant
load_loops_lean()
a = np.array([[2.0, 1.0], [1.0, 3.0]])
around = numba.njit(lambda a: inverse(a)[0, 0] + 1.0)
values = inverse(a).tolist(), around(a), log_determinant(a)
expected = [[0.6, -0.2], [-0.2, 0.4]], 1.6, log_determinant.py_func(a)
print(taken_already == 1 and values == expected, end=" ")
print(*(sum(loop.stats.cache_hits.values()) for loop in (inverse, log_determinant)), said)
"""


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One small loop for x86-64-v3; the process ends with an error if it cannot run that."""
    if platform.machine() != "x86_64":
        pytest.skip("the wheels are built on x86-64")
    folder = tmp_path_factory.mktemp("compiled")
    work = "import numpy as np; from touchline.matrices import inverse; inverse(np.eye(2))"
    kernel_wheels.compiled(kernel_wheels.V3, folder, work)
    return folder


@pytest.fixture(scope="module")
def site(compiled: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    kernel_wheels.packed(compiled, kernel_wheels.V3, folder / PACKAGE)
    return folder


def use(site: Path, kept: Path, **environment: str) -> list[str]:
    """Right values?, of `inverse` and `log_determinant` how often found, and what was said."""
    environment = {**os.environ, "PYTHONPATH": str(site), "NUMBA_CACHE_DIR": str(kept), **environment}
    ran = subprocess.run([sys.executable, "-c", USED], env=environment, capture_output=True, text=True, check=True)
    return ran.stdout.split(maxsplit=3)


def test_a_packed_loop_is_not_compiled_and_another_is_as_ever(site: Path, tmp_path: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in site.rglob("*")}
    right, packed, other, said = use(site, tmp_path)
    assert (right, packed, other) == ("True", "1", "0")
    assert said.startswith("touchline-kernels is used: its loops are for x86-64-v3")
    kept = {path.name.split("-")[0] for path in tmp_path.rglob("*.nbc")}
    assert "matrices.log_determinant" in kept  # a signature that the wheel lacks is kept where Numba keeps it
    assert "matrices.inverse" not in kept
    assert use(site, tmp_path)[:3] == ["True", "1", "1"]
    assert {path: path.stat().st_mtime_ns for path in site.rglob("*")} == before


def test_a_processor_of_the_users_choice_is_left_to_numba(site: Path, tmp_path: Path) -> None:
    right, packed, _, said = use(site, tmp_path, NUMBA_CPU_NAME="x86-64-v2", NUMBA_CPU_FEATURES="")
    assert (right, packed) == ("True", "0")
    assert said.strip() == "touchline-kernels is not used: NUMBA_CPU_NAME or NUMBA_CPU_FEATURES is set"


@pytest.fixture
def said_of(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[[str], str]:
    """What is said of an installed wheel with such a description. None of these is to be used in this process."""
    monkeypatch.setattr("touchline.packed_loops._take_from", lambda *_: None)

    def said(description: str) -> str:
        (tmp_path / PACKAGE).mkdir(exist_ok=True)
        (tmp_path / PACKAGE / "__init__.py").touch()
        (tmp_path / PACKAGE / DESCRIPTION).write_text(description)
        monkeypatch.syspath_prepend(tmp_path)
        importlib.invalidate_caches()
        return take_packed_loops.__wrapped__()

    return said


FITTING: dict[str, Any] = {"processor": "some", "features": []}


@pytest.mark.parametrize("name", ["touchline", "numba", "llvmlite", "numpy", "python", "target"])
def test_another_version_is_not_taken(said_of: Callable[[str], str], name: str) -> None:
    assert "is used" in said_of(json.dumps(surroundings() | FITTING))
    said = said_of(json.dumps(surroundings() | FITTING | {name: "0.0.1"}))
    assert said == f"touchline-kernels is not used: it is for {name} 0.0.1, and here is {surroundings()[name]}"


def test_a_processor_that_lacks_something_is_told(said_of: Callable[[str], str]) -> None:
    said = said_of(json.dumps(surroundings() | FITTING | {"features": ["avx2", "warp", "time-travel"]}))
    assert said.endswith("the processor lacks warp, time-travel")


@pytest.mark.parametrize("description", ["", "[]", "{}", '{"touchline": 1', "\x00"])
def test_a_spoilt_description_is_told(said_of: Callable[[str], str], description: str) -> None:
    assert said_of(description) == "touchline-kernels is not used: its built.json cannot be read"


def test_any_changed_source_is_told(
    said_of: Callable[[str], str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    sources = tmp_path / "sources"
    (sources / "examples").mkdir(parents=True)
    (sources / "callee.py").write_text("LIMIT = 1\n")
    monkeypatch.setattr("touchline.packed_loops._SOURCES", sources)
    built = json.dumps(surroundings() | FITTING)
    (sources / "examples" / "own.py").write_text("a user's\n")
    assert "is used" in said_of(built)
    (sources / "callee.py").write_text("LIMIT = 2\n")
    assert said_of(built).endswith("touchline's sources are not those that it was compiled from")


def test_without_the_wheel_nothing_is_said_and_numba_is_as_it_was() -> None:
    search = numba.core.caching.FunctionCache._load_overload
    assert take_packed_loops.__wrapped__() == ""
    assert numba.core.caching.FunctionCache._load_overload is search


def test_a_command_takes_them_and_compile_says_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("touchline.cli.commands.take_packed_loops", lambda: print("taken"))
    monkeypatch.setattr("touchline.cli.compile.take_packed_loops", lambda: "why not")
    monkeypatch.setattr("touchline.systems.SYSTEMS", {})
    for example in ("locate", "check"):
        monkeypatch.setattr(f"touchline.cli.compile._{example}_example", lambda: None)
    assert main(["compile"]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0] == "taken"
    assert said[-2] == "why not"


def test_armv8_is_compiled_here_without_running(compiled: Path, tmp_path: Path) -> None:
    kernel_wheels.compiled_from(compiled, kernel_wheels.ARMV8, tmp_path / "compiled")
    kernel_wheels.packed(tmp_path / "compiled", kernel_wheels.ARMV8, tmp_path / PACKAGE)
    assert {path.name for path in (tmp_path / PACKAGE).rglob("*.nbc")} == {
        path.name for path in compiled.rglob("matrices.*.nbc")
    }
    code = next((tmp_path / PACKAGE).glob("matrices.inverse*.nbc")).read_bytes()
    aarch64 = (183).to_bytes(2, "little")
    assert b"\x7fELF" in code
    assert code[code.index(b"\x7fELF") + 18 :][:2] == aarch64
    assert str(Path(touchline.__file__).parent).encode() not in code  # no path of the machine that built it
    built = json.loads((tmp_path / PACKAGE / DESCRIPTION).read_text())
    assert (built["target"], built["sources"]) == ("aarch64-unknown-linux-gnu", surroundings()["sources"])
