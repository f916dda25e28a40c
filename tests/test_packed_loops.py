"""Loops that come compiled in a wheel: found where all fits, else left alone, and never in the way of others."""

from __future__ import annotations

import importlib
import json
import os
import platform
import re
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
import sys
from touchline import Pose
untouched = "numba" not in sys.modules
from touchline import Frame
import numba, numpy as np
from touchline.packed_loops import packed_loops_taken, take_packed_loops
taken_already = take_packed_loops.cache_info().currsize
said = take_packed_loops()
from touchline.compiling import load_loops_lean
from touchline.matrices import inverse, log_determinant
load_loops_lean()
a = np.array([[2.0, 1.0], [1.0, 3.0]])
around = numba.njit(lambda a: inverse(a)[0, 0] + 1.0)
values = inverse(a).tolist(), around(a), log_determinant(a)
expected = [[0.6, -0.2], [-0.2, 0.4]], 1.6, log_determinant.py_func(a)
print(untouched and taken_already == 1 and values == expected, end=" ")
print(*(sum(loop.stats.cache_hits.values()) for loop in (inverse, log_determinant)), packed_loops_taken(), said)
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
    """Right values?, of `inverse` and `log_determinant` how often found, how many in the wheel, and what was said."""
    environment = {**os.environ, "PYTHONPATH": str(site), "NUMBA_CACHE_DIR": str(kept), **environment}
    ran = subprocess.run([sys.executable, "-c", USED], env=environment, capture_output=True, text=True, check=True)
    return ran.stdout.split(maxsplit=4)


@pytest.mark.slow
def test_a_packed_loop_is_not_compiled_and_another_is_as_ever(site: Path, tmp_path: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in site.rglob("*")}
    right, found, other, packed, said = use(site, tmp_path)
    assert (right, found, other, packed) == ("True", "1", "0", "1")
    assert said.startswith("touchline-kernels is used: its loops are for x86-64-v3")
    kept = {path.name.split("-")[0] for path in tmp_path.rglob("*.nbc")}
    assert "matrices.log_determinant" in kept  # a signature that the wheel lacks is kept where Numba keeps it
    assert "matrices.inverse" not in kept
    assert use(site, tmp_path)[:4] == ["True", "1", "1", "1"]
    assert {path: path.stat().st_mtime_ns for path in site.rglob("*")} == before


@pytest.mark.slow
def test_a_processor_of_the_users_choice_is_left_to_numba(site: Path, tmp_path: Path) -> None:
    right, found, _, packed, said = use(site, tmp_path, NUMBA_CPU_NAME="x86-64-v2", NUMBA_CPU_FEATURES="")
    assert (right, found, packed) == ("True", "0", "0")
    assert said.strip() == "touchline-kernels is not used: NUMBA_CPU_NAME or NUMBA_CPU_FEATURES is set"


@pytest.fixture
def said_of(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[[str], str]:
    """What is said of an installed wheel with such a description. None of these is to be used in this process."""
    used: list[Path] = []
    monkeypatch.setattr("touchline.packed_loops._take_from", lambda folder, _: used.append(folder))

    def said(description: str) -> str:
        used.clear()
        (tmp_path / PACKAGE).mkdir(exist_ok=True)
        (tmp_path / PACKAGE / "__init__.py").touch()
        (tmp_path / PACKAGE / DESCRIPTION).write_text(description)
        monkeypatch.syspath_prepend(tmp_path)
        importlib.invalidate_caches()
        words = take_packed_loops.__wrapped__()
        assert bool(used) == ("is used" in words)
        return words

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
    for example in ("fault", "locate", "check"):
        monkeypatch.setattr(f"touchline.cli.compile._{example}_example", lambda: None)
    assert main(["compile", "--workers", "1"]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0] == "taken"
    assert said[-2] == "why not"
    assert said[-1].startswith("all loops are compiled; code compiled here is kept beside the package")
    monkeypatch.setattr("touchline.cli.compile.packed_loops_taken", lambda: 7)
    assert main(["compile", "--workers", "1"]) == 0
    last = capsys.readouterr().out.splitlines()[-1]
    assert last == "all loops are ready: 7 from the wheel, none compiled"
    workflow = Path(__file__).parents[1] / ".github" / "workflows" / "release.yml"
    asked = re.search(r'touchline compile .* grep "(.*)"', workflow.read_text(encoding="utf-8"))
    assert asked is not None
    assert last.endswith(asked[1])
    monkeypatch.setattr("touchline.cli.compile._check_example", lambda: numba.njit(own_loop)(1))
    monkeypatch.setattr(own_loop, "__module__", "touchline.some")
    assert main(["compile", "--workers", "1"]) == 0
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.startswith("all loops are ready: 7 from the wheel, 1 compiled; code compiled here is kept beside")


def own_loop(a: int) -> int:
    return a


@pytest.mark.slow
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
