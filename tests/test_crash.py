"""A crash, a signal, a full disk: what was written stays whole and can be evaluated."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from fakes import FakeSource, FakeSystem, true_samples, write_recording

from touchline.cli import main
from touchline.config import Settings
from touchline.errors import InputError, TouchlineError
from touchline.evaluation import Run, evaluate, write_tum
from touchline.evaluation.run_folder import RunFolder, read_summary
from touchline.evaluation.runner import run_frames
from touchline.evaluation.summary import UNFINISHED, BlackImages, RunSummary
from touchline.files.new import replace_file, write_new_file
from touchline.systems import SYSTEMS, SystemInfo
from touchline.types import Estimate, Frame

FRAMES = 40


class FakeSettings(Settings):
    pass


@contextmanager
def no_file_above(size: int) -> Iterator[None]:
    """As on a disk that fills up: a file may grow to `size` bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.fixture(autouse=True)
def _workplace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("TOUCHLINE_DEBUG", raising=False)
    info = SystemInfo("fake", "a fake system", FakeSettings, lambda setup, settings, rng: FakeSystem(rng))
    monkeypatch.setitem(SYSTEMS, "fake", info)


@pytest.fixture
def cut(tmp_path: Path) -> Path:
    """The folder of a run of four images that was killed: within its fifth row, say."""
    recording = write_recording(tmp_path / "tiny")
    folder = Path("cut")
    folder.mkdir()
    with RunFolder(folder, RunSummary(recording={"path": str(recording)})) as rows:
        tally = run_frames(FakeSource(12), FakeSystem(np.random.default_rng(0)), rows)
        rows.sync(tally.summary().updated(RunSummary(ended=UNFINISHED)))
    lines = (folder / "estimates.csv").read_text().splitlines(keepends=True)
    (folder / "estimates.csv").write_text("".join(lines[:5]) + lines[5][:40])
    return folder


@pytest.mark.slow
def test_a_killed_process_loses_no_row(tmp_path: Path) -> None:
    program = (
        "import os, signal, sys\nsys.path[:0] = sys.argv[1:2]\n"
        "import numpy as np\nfrom pathlib import Path\nfrom fakes import FakeSource, FakeSystem\n"
        "from touchline.evaluation.run_folder import RunFolder\nfrom touchline.evaluation.runner import run_frames\n"
        "from touchline.evaluation.summary import RunSummary\n"
        "def kill(frame, estimate):\n"
        "    if frame.stamp_ns == 2_900_000_000: os.kill(os.getpid(), signal.SIGKILL)\n"
        "with RunFolder(Path('.')) as folder:\n"
        "    folder.sync(RunSummary(ended='unfinished', recording={'path': 'gone'}))\n"
        "    run_frames(FakeSource(40), FakeSystem(np.random.default_rng(0)), folder, on_frame=[kill])\n"
    )
    ended = subprocess.run([sys.executable, "-c", program, str(Path(__file__).parent)], check=False)
    assert ended.returncode == -signal.SIGKILL
    assert len(Run(tmp_path).estimates) == 30
    assert Path("trajectory.tum").read_bytes().count(b"\n") == 30
    assert "cut off" in Run(tmp_path).incomplete
    write_tum(tmp_path / "truth.tum", true_samples(FRAMES))
    assert evaluate(tmp_path, tmp_path / "truth.tum").frames == 29  # without the first, in which it was searched


def test_the_summary_goes_with_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("touchline.evaluation.run_folder._BETWEEN_SYNCS_S", 0.0)
    seen = []
    with RunFolder(tmp_path, RunSummary(seed=7)) as folder:
        tell = [lambda frame, estimate: seen.append(read_summary(tmp_path)) if frame.stamp_ns > 0 else None]
        run_frames(FakeSource(5, black=(1, 2)), FakeSystem(np.random.default_rng(0)), folder, on_frame=tell)
    assert [summary.frames for summary in seen] == [1, 2, 3, 4]
    assert {(summary.seed, summary.ended) for summary in seen} == {(7, UNFINISHED)}
    assert seen[-1].black_images == BlackImages(count=2, stretches_ns=[(100_000_000, 200_000_000)])


def test_a_cut_run_is_evaluated_and_said_to_be_cut(cut: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert main(["evaluate", str(cut)]) == 0
    out, err = capsys.readouterr()
    said = "the run has not come to its end: it was cut off, or still goes on; 4 images done"
    assert err == f"warning: cut: {said}\n"
    assert "3 frames counted" in out


def test_a_row_that_the_disk_does_not_take_leaves_those_before_whole(tmp_path: Path) -> None:
    with RunFolder(tmp_path) as folder, no_file_above(2000):
        tally = run_frames(FakeSource(FRAMES), FakeSystem(np.random.default_rng(0)), folder)
    assert tally.ended == "failed"
    said = f"{tmp_path}/estimates.csv: cannot be written (File too large); the rows before are whole"
    assert str(tally.failure) == said
    assert (tmp_path / "estimates.csv").read_bytes().endswith(b"\n")
    table = Run(tmp_path).estimates
    assert len(table) == tally.frames == 11


@pytest.mark.parametrize("size", [300, 2500])
def test_a_full_disk_is_named_and_nothing_is_left_in_halves(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], size: int
) -> None:
    recording = write_recording(tmp_path / "tiny")
    main(["run", str(recording), "--system", "fake", "--output", "first"])  # compiled code is kept on the disk as well
    capsys.readouterr()
    with no_file_above(size):
        assert main(["run", str(recording), "--system", "fake", "--output", "run"]) == 1
    assert capsys.readouterr().err.splitlines()[-1].startswith("error: run/")
    files = {path.name: path.read_text() for path in Path("run").iterdir()}
    assert not {"report.html", "report.html.part", "summary.json.part"} & set(files)
    assert all(text == "" or text.endswith("\n") for text in files.values())
    if "summary.json" in files:
        json.loads(files["summary.json"])
        main(["evaluate", "run"])
        assert "unexpected" not in capsys.readouterr().err


def test_a_file_that_cannot_be_replaced_keeps_its_older_version(tmp_path: Path) -> None:
    file = tmp_path / "summary.json"
    file.write_text("as it was")
    with no_file_above(1000), pytest.raises(TouchlineError, match=r"summary\.json: cannot be written \(File too large"):
        replace_file(file, bytes(2000))
    with no_file_above(1000), pytest.raises(InputError, match=r"new\.yaml: cannot be written"):
        write_new_file(tmp_path / "new.yaml", bytes(2000))
    assert [path.name for path in tmp_path.iterdir()] == ["summary.json"]
    assert file.read_text() == "as it was"


@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_run_after_the_image_at_hand(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], kind: signal.Signals
) -> None:
    class Stopped(FakeSystem):
        def step(self, frame: Frame) -> Estimate:
            if len(self.seen) == 4:
                os.kill(os.getpid(), kind)
            return super().step(frame)

    info = SystemInfo("fake", "", FakeSettings, lambda setup, settings, rng: Stopped(rng))
    monkeypatch.setitem(SYSTEMS, "fake", info)
    handler = signal.getsignal(kind)
    assert main(["run", str(write_recording(tmp_path / "tiny")), "--system", "fake"]) == 130
    assert signal.getsignal(kind) is handler
    assert capsys.readouterr().err.splitlines()[-1] == "error: interrupted: 5 images done"
    assert (len(Run("runs/tiny-1").estimates), Run("runs/tiny-1").summary.ended) == (5, "interrupted")
    assert "was interrupted" in Path("runs/tiny-1/report.html").read_text()
