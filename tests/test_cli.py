"""The command line: what it prints, what it refuses, and with which exit status."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from fakes import FakeSystem, true_samples, write_recording
from syrupy.assertion import SnapshotAssertion

from touchline.cli import main
from touchline.cli.commands import app
from touchline.config import Settings
from touchline.errors import NoFitError
from touchline.evaluation import write_tum
from touchline.systems import SYSTEMS, SystemInfo
from touchline.types import Estimate, Frame

HEAVY = ("numpy", "numba", "cv2", "matplotlib", "pydantic", "scipy", "yaml")


class FakeSettings(Settings):
    noise_m: float = 0.01


class BrokenSystem(FakeSystem):
    def step(self, frame: Frame) -> Estimate:
        if len(self.seen) == 3:
            raise ZeroDivisionError("by design")
        return super().step(frame)


class RefusingSystem(FakeSystem):
    def step(self, frame: Frame) -> Estimate:
        raise NoFitError("these points fit nothing")


@pytest.fixture(autouse=True)
def _workplace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("TOUCHLINE_DEBUG", raising=False)
    for name, kind in (("fake", FakeSystem), ("broken", BrokenSystem), ("refusing", RefusingSystem)):
        info = SystemInfo(name, f"a {name} system", FakeSettings, lambda setup, s, rng, kind=kind: kind(rng, s.noise_m))
        monkeypatch.setitem(SYSTEMS, name, info)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    return write_recording(tmp_path / "tiny")


def told(capsys: pytest.CaptureFixture[str]) -> tuple[str, str]:
    captured = capsys.readouterr()
    return captured.out, captured.err


def test_nothing_heavy_is_imported_before_it_is_needed() -> None:
    code = (
        "import sys, touchline\nfrom touchline.cli import main\nstatus = main(['--help'])\n"
        f"print(status, [name for name in {HEAVY} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "0 []"


@pytest.mark.parametrize("wanted", [None, "3"])
def test_one_thread_and_a_quick_compiler_unless_told_otherwise(wanted: str | None) -> None:
    names = ("OPENBLAS_NUM_THREADS", "OPENCV_FOR_THREADS_NUM", "NUMBA_OPT")
    code = (
        "import os\nfrom touchline.cli import main\nmain(['--version'])\nimport cv2, numba\n"
        "print(os.environ['OPENBLAS_NUM_THREADS'], cv2.getNumThreads(), int(numba.config.OPT))"
    )
    given = {name: value for name, value in os.environ.items() if name not in names}
    given |= {} if wanted is None else dict.fromkeys(names, wanted)
    done = subprocess.run([sys.executable, "-c", code], env=given, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1].split() == 3 * [wanted or "1"]


@pytest.mark.parametrize("arguments", [[], ["-h"]])
def test_help_names_every_command(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 0
    out, _ = told(capsys)
    for command in ("demo", "run", "locate", "evaluate", "check", "view", "systems", "fields"):
        assert f" {command} " in out


@pytest.mark.slow
def test_a_compiled_loop_whose_file_was_cut_off_is_told(
    recording: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    source = Path("loop.py")
    source.write_text("from numba import njit\n@njit(cache=True)\ndef loop(x):\n    return x + 1\n")

    def loop() -> Any:
        spec = importlib.util.spec_from_file_location("loop", source)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module.loop

    class Looping(FakeSystem):
        def step(self, frame: Frame) -> Estimate:
            assert loop()(1) == 2
            return super().step(frame)

    monkeypatch.setitem(SYSTEMS, "fake", SystemInfo("fake", "", FakeSettings, lambda setup, s, rng: Looping(rng, 0.0)))
    assert main(["run", str(recording), "--system", "fake", "--output", "whole"]) == 0
    (kept,) = Path("__pycache__").glob("*.nbc")
    kept.write_bytes(kept.read_bytes()[:700])
    told(capsys)
    assert main(["run", str(recording), "--system", "fake", "--output", "cut"]) == 1
    assert "delete the files *.nbi and *.nbc" in told(capsys)[1]


def test_summary_says_what_was_run(recording: Path) -> None:
    assert main(["run", str(recording), "--system", "fake", "--set", "noise_m=0.02", "--seed", "3"]) == 0
    summary = json.loads(Path("runs/tiny-1/summary.json").read_text())
    assert summary["system"] == "fake"
    assert summary["settings"] == {"noise_m": 0.02}
    assert summary["seed"] == 3
    assert summary["recording"] == {
        "path": str(recording),
        "bag": None,
        "name": "tiny",
        "description": "a tiny recording",
        "field": "msl-18x12",
    }
    assert summary["ended"] == "complete"
    assert summary["frames"] == 12
    assert {"touchline", "python", "numpy", "numba"} <= set(summary["versions"])
    assert summary["errors"]["frames"] == 11
    assert 0.0 < summary["errors"]["x_m"]["mean"] < 0.06
    assert summary["latency_ms"]["total"]["median"] > 0


def test_the_same_seed_gives_the_same_trajectory(recording: Path) -> None:
    for seed in ("1", "1", "2"):
        assert main(["run", str(recording), "--system", "fake", "--seed", seed]) == 0
    first, second, other = (Path(f"runs/tiny-{n}/trajectory.tum").read_bytes() for n in (1, 2, 3))
    assert first == second
    assert first != other


def test_settings_come_from_a_file_and_the_command_line_wins(recording: Path, tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text("noise_m: 0.5\n")
    assert main(["run", str(recording), "--system", "fake", "--config", "s.yaml"]) == 0
    assert main(["run", str(recording), "--system", "fake", "--config", "s.yaml", "--set", "noise_m=0.1"]) == 0
    used = [json.loads(Path(f"runs/tiny-{n}/summary.json").read_text())["settings"]["noise_m"] for n in (1, 2)]
    assert used == [0.5, 0.1]


def test_the_start_reaches_the_system(recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[FakeSystem] = []

    def make(setup: object, settings: object, rng: np.random.Generator) -> FakeSystem:
        made.append(FakeSystem(rng))
        return made[-1]

    monkeypatch.setitem(SYSTEMS, "fake", SystemInfo("fake", "", FakeSettings, make))
    assert main(["run", str(recording), "--system", "fake", "--start=-1.5,2,0.5"]) == 0
    assert main(["run", str(recording), "--system", "fake", "--own-half"]) == 0
    first, second = (system.prior for system in made)
    assert first is not None
    assert second is not None
    assert first.pose == (-1.5, 2.0, 0.5)
    assert not first.own_half
    assert (second.pose, second.own_half) == (None, True)


def test_a_broken_image_is_survived_counted_and_told(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (recording / "images" / "000004.png").write_bytes(b"not an image")
    assert main(["run", str(recording), "--system", "fake"]) == 0
    out, _ = told(capsys)
    assert "problems of the recording: 1 × broken image" in out
    summary = json.loads(Path("runs/tiny-1/summary.json").read_text())
    assert summary["missing_images"] == 1
    assert "images/000004.png" in summary["problems"]["messages"][0]
    assert "images/000004.png" in Path("runs/tiny-1/report.html").read_text()


def test_a_run_goes_on_without_an_unusable_sensor_and_warns(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (recording / "odometry.csv").write_text("t;x;y;theta\n0;0;0;0\n")
    assert main(["run", str(recording), "--system", "fake"]) == 0
    out, err = told(capsys)
    assert "problems of the recording: 1 × unreadable sensor file" in out
    assert "warning: odometry.csv, line 1: column 't' is missing from the header (found: t;x;y;theta)" in err


def test_nothing_is_overwritten(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "out").mkdir()
    assert main(["run", str(recording), "--system", "fake", "--output", "out"]) == 2
    assert "exists already" in told(capsys)[1]
    assert not list((tmp_path / "out").iterdir())


def test_a_failed_run_has_status_1_and_keeps_what_was_done(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(recording), "--system", "broken"]) == 1
    _, err = told(capsys)
    assert "the run failed after 3 frames: ZeroDivisionError: by design (touchline --debug" in err
    assert "Traceback" not in err
    assert len(Path("runs/tiny-1/trajectory.tum").read_text().splitlines()) == 3
    assert json.loads(Path("runs/tiny-1/summary.json").read_text())["ended"] == "failed"
    assert "by design" in Path("runs/tiny-1/report.html").read_text()


def test_debug_shows_where_it_failed(recording: Path) -> None:
    with pytest.raises(ZeroDivisionError):
        main(["--debug", "run", str(recording), "--system", "broken"])


def test_what_the_system_refuses_is_told_as_it_says(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(recording), "--system", "refusing"]) == 1
    assert "error: these points fit nothing\n" in told(capsys)[1]


def test_a_full_disk_is_told_in_one_line() -> None:
    with Path("/dev/full").open("w") as file:
        done = subprocess.run(
            [sys.executable, "-m", "touchline", "systems"], stdout=file, stderr=subprocess.PIPE, text=True
        )
    assert done.returncode == 1
    assert done.stderr == "error: the output: No space left on device\n"


def test_evaluate_prints_the_table_of_a_run(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["run", str(recording), "--system", "fake"])
    printed = told(capsys)[0]
    assert main(["evaluate", "runs/tiny-1"]) == 0
    out, _ = told(capsys)
    assert out.splitlines()[:6] == printed.splitlines()[:6]
    assert main(["evaluate", "runs/tiny-1", "--skip", "5"]) == 0
    assert "7 frames counted; left out: 5 first frames, as asked" in told(capsys)[0]


def test_evaluate_takes_a_trajectory_and_a_truth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_tum(tmp_path / "a.tum", true_samples(10))
    assert main(["evaluate", "a.tum", "--truth", "a.tum"]) == 0
    out, _ = told(capsys)
    assert "10 frames counted" in out
    assert "0.00" in out


BAD_ARGUMENTS = """
run nowhere
run tiny --system fak
run tiny --system fake --set noise=1
run tiny --set motion
run tiny --system fake --set sigma=1
run tiny --system nubot-mti --set fusion.beta=1
run tiny --set particles.motion=1
run tiny --system nubot-mti --set matching=1
run tiny --system fake --set noise_m
run tiny --system fake --config none.yaml
run tiny --start 1,2
run tiny --start 1,2,nan
run tiny --start=1,2,90
run tiny --start=-12.5,2,0
run tiny --start 1,2,3 --own-half
run tiny --system fake --output tiny
run tiny --preset papr
run tiny --field msl-18x12
demo --output tiny
evaluate nowhere
evaluate tiny
evaluate tiny/ground_truth.tum
evaluate tiny/ground_truth.tum --truth tiny/images.csv
evaluate tiny/ground_truth.tum --truth tiny/ground_truth.tum --skip 99
view nowhere.png
view tiny/images/000000.png
view tiny --camera tiny/camera.yaml
view tiny/images/000000.png --camera tiny/camera.yaml --frame 1
view tiny --frame 12
view tiny/images.csv --camera tiny/camera.yaml
locate nowhere.csv
locate tiny/images/000000.png
check nowhere
fields msl
fields new a/b A=12
systems nubot
"""


def refused(arguments: str, capsys: pytest.CaptureFixture[str]) -> str:
    """The one line that a command with bad arguments prints."""
    assert main(arguments.split()) == 2, arguments
    out, err = told(capsys)
    assert out == "", arguments
    assert err.startswith("error: "), err
    assert err.count("\n") == 1, err
    return err.strip()


def test_bad_arguments_have_status_2_and_one_plain_line(
    recording: Path, capsys: pytest.CaptureFixture[str], snapshot: SnapshotAssertion
) -> None:
    said = "\n".join(f"{line}\n  {refused(line, capsys)}" for line in BAD_ARGUMENTS.strip().splitlines())
    assert said == snapshot
    assert not Path("runs").exists()


@pytest.mark.parametrize(
    "arguments", ["fly", "--wings", "run", "run tiny --wings", "run tiny --seed -1", "run tiny --seed one", "demo now"]
)
def test_what_the_command_line_s_library_refuses_is_one_line_too(
    recording: Path, capsys: pytest.CaptureFixture[str], arguments: str
) -> None:
    assert "--help" in refused(arguments, capsys) or arguments.split()[-1] in refused(arguments, capsys)


def help_of(name: str, command: Any) -> Iterator[str]:
    """Names, words and defaults, without a layout, which is Rich's."""
    yield f"{name}: {(command.help or '').splitlines()[0]}"
    for each in command.params:
        if each.name not in ("help", "install_completion", "show_completion"):
            names = " ".join((*each.opts, *each.secondary_opts)) if each.param_type_name == "option" else each.metavar
            yield f"  {names or each.name}: {each.help}{' [required]' if each.required else ''}"
    for inner, found in getattr(command, "commands", {}).items():
        yield from help_of(f"{name} {inner}", found)


def test_help_of_every_command(snapshot: SnapshotAssertion) -> None:
    assert "\n".join(help_of("touchline", typer.main.get_command(app))) == snapshot


def test_an_unexpected_error_is_told_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(*_: object) -> None:
        raise RuntimeError("a defect")

    monkeypatch.setattr("touchline.evaluation.evaluate", broken)
    assert main(["evaluate", "anything"]) == 1
    _, err = told(capsys)
    assert err == "error: unexpected RuntimeError: a defect (touchline --debug evaluate anything shows the traceback)\n"
