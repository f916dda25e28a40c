"""`touchline compile`, and what a first start says while it waits for the compiler."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from touchline.camera import OmniCamera
from touchline.cli.console import announce_compiling
from touchline.compiling import load_loops_lean
from touchline.evaluation.workers import open_workers
from touchline.packed_loops import take_packed_loops
from touchline.systems import SYSTEMS

RUN = [sys.executable, "-m", "touchline"]


WATCHED = """
import json, sys
from numba.core import event
class Listener(event.Listener):
    def on_start(self, event):
        function = event.data["dispatcher"].py_func
        if function.__module__.startswith("touchline"):
            print("COMPILED", function.__module__, function.__qualname__, event.data["args"], file=sys.stderr)
    def on_end(self, event): ...
with event.install_listener("numba:compile", Listener()):
    from touchline.cli import main
    for command in json.loads(sys.argv[1]):
        print("RUNS", *command, file=sys.stderr)
        assert main(command) == 0, command
    from touchline.evaluation.runner import robot_setup
    from touchline.sources import open_source
    from touchline.systems import open_system
    print("RUNS where a head should look, and what comes late", file=sys.stderr)
    source = open_source(sys.argv[2])
    system = open_system("touchline", robot_setup(source))
    for frame in source:
        system.delay.take(0.1, 0.01)
        look = system.step(frame).look
"""
EXAMPLE = Path(__file__).parents[1] / "examples" / "omni_msl_track_short"


@pytest.mark.slow
def test_after_compile_nothing_is_left_to_compile(tmp_path: Path, small_data: Path) -> None:
    done = subprocess.run([*RUN, "compile"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert [name for name in SYSTEMS if f"{name}: ready after" not in done.stdout] == []
    walk, points = small_data / "humanoid_9x6_walk", small_data / "omni_9x6_points"
    image = next((EXAMPLE / "images").iterdir())
    carried, paper = small_data / "omni_msl_kidnap", ("--preset", "paper")
    runs = [(name, EXAMPLE if OmniCamera in info.cameras else walk) for name, info in SYSTEMS.items()]
    runs += [("touchline", walk), ("touchline", points), ("touchline", carried)]
    runs += [("iris-fusion", carried)]
    commands = [["check", str(EXAMPLE)], ["check", str(walk)]]
    commands += [["locate", str(image), "--camera", str(EXAMPLE / "camera.yaml"), "--field", "msl-18x12"]]
    for number, (system, recording) in enumerate(runs):
        commands += [["run", str(recording), "--system", system, "-o", str(tmp_path / str(number))]]
    commands += [["run", str(EXAMPLE), "--system", "nubot-mti", *paper, "-o", str(tmp_path / "paper")]]
    ran = subprocess.run(
        [sys.executable, "-c", WATCHED, json.dumps(commands), str(EXAMPLE)], capture_output=True, text=True
    )
    assert ran.returncode == 0, ran.stderr
    told = [line for line in ran.stderr.splitlines() if line.startswith(("RUNS", "COMPILED"))]
    assert [line for line in told if line.startswith("COMPILED")] == []
    assert len(told) == len(commands) + 1


def test_a_first_start_says_once_what_it_waits_for() -> None:
    said: list[str] = []
    twice = numba.njit(lambda x: x + x)
    with announce_compiling(said.append):
        twice(1)
        twice(1.5)
    assert len(said) == 1
    assert "touchline compile" in said[0]
    assert not any("@cfunc." in code for code in twice.inspect_llvm().values())  # a wrapper that nobody calls
    with announce_compiling(said.append):
        twice(2)
    assert len(said) == 1


@pytest.mark.slow
def test_a_read_only_package_folder_is_no_obstacle(tmp_path: Path) -> None:
    """Numba then keeps its cache in a folder of the user's, or in NUMBA_CACHE_DIR."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    code = "from touchline.field import open_field; open_field('indoor-9x6').distance_map(0.2)"
    subprocess.run([sys.executable, "-c", code], env=environment, check=True)
    assert list((tmp_path / "cache").rglob("*.nbi"))


@pytest.mark.slow
def test_a_loop_from_the_cache_is_called_by_one_that_is_compiled_later(tmp_path: Path) -> None:
    (tmp_path / "loops.py").write_text(
        "from numba import njit\n\n@njit(cache=True)\ndef twice(x):\n    return 2.0 * x\n"
    )
    code = (
        "import numba, loops\nfrom touchline.compiling import load_loops_lean\n"
        "load_loops_lean()\nprint(loops.twice(1.0), sum(loops.twice.stats.cache_hits.values()))\n"
        "kept = next(iter(loops.twice.overloads.values())).library._shared_module\n"
        "print(kept is None, numba.njit(lambda x: 1.0 + loops.twice(x))(3.0))"
    )
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    said = [
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment
        ).stdout.split()
        for _ in range(2)
    ]
    assert said == [["2.0", "0", "False", "7.0"], ["2.0", "1", "True", "7.0"]]


def test_loops_kept_in_another_shape_are_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    class Library:
        _shared_module: str | None = "parsed"

        @classmethod
        def _unserialize(cls, codegen: object, state: object) -> Library:
            return cls()

        def _get_module_for_linking(self) -> str | None:
            return self._shared_module

    monkeypatch.setattr("llvmlite.binding.parse_bitcode", lambda code: f"parsed {code.decode()}")
    monkeypatch.setattr("numba.core.codegen.CPUCodeLibrary", Library)
    load_loops_lean.__wrapped__()
    for state in (("f", "object", b"code"), ("f", "object", ("code", "text")), ("f", "bitcode", b"code"), b"all"):
        assert Library._unserialize(None, state)._get_module_for_linking() == "parsed"
    kept = Library._unserialize(None, ("f", "object", (b"code", b"again")))
    assert kept._shared_module is None
    assert kept._get_module_for_linking() == "parsed again"
    monkeypatch.setattr("numba.core.codegen.CPUCodeLibrary", None)
    load_loops_lean.__wrapped__()


def numba_is_set(task: int) -> tuple[bool, str, bool]:
    from numba.core.codegen import CPUCodeLibrary
    from numba.core.compiler import Flags

    looked_for = take_packed_loops.cache_info().currsize == 1
    return Flags.options["no_cfunc_wrapper"]._default, CPUCodeLibrary._unserialize.__module__, looked_for


def test_numba_is_set_in_workers_and_not_where_they_are_asked_for() -> None:
    before = numba_is_set(0)
    with open_workers(2) as workers:
        assert list(workers.map(numba_is_set, range(1))) == [(True, "touchline.compiling", True)]
    assert numba_is_set(0) == before
