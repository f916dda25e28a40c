"""The viewer: what is written for it, read back; what is refused. Without Rerun, that it says what is missing."""

from __future__ import annotations

import importlib.util
import itertools
import socket
import sys
import threading
import warnings
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fakes import STEP_NS, FakeSource, FakeSystem, true_pose, write_recording

from touchline.camera import open_camera
from touchline.cli import main
from touchline.errors import InputError
from touchline.evaluation.latency import START_FRAMES
from touchline.field import open_field
from touchline.geometry import Pose
from touchline.live.heard import Picture, Reading
from touchline.live.udp import UdpRobot
from touchline.published.nubot_mcl.system import NubotMcl
from touchline.sources import open_source
from touchline.systems import open_system
from touchline.types import Estimate, Frame, Hypothesis, Status
from touchline.view.viewer import LatestShown, RunView, open_screen
from touchline.view.viewer.run_view import covariance_ellipse
from touchline.view.viewer.watching import particles_now

COUNT = 12
WITHOUT = "pip install 'touchline\\[view\\]'"
INSTALLED = importlib.util.find_spec("rerun") is not None


def shown(folder: Path, source: FakeSource) -> Path:
    """A run of the fake system kept for the viewer: its first frame is not located, a hypothesis in the third."""
    recording = write_recording(folder / "recording", 1)
    file = folder / "run.rrd"
    screen = open_screen(None, file)
    view = RunView(
        screen.stream,
        open_field("msl-18x12"),
        open_camera(recording / "camera.yaml"),
        true_at=lambda stamp_ns: true_pose(stamp_ns // STEP_NS),
        particles=lambda estimate: np.tile([1.0, 2.0, 0.3, 0.1], (10, 1)),
        about="# twelve frames",
    )
    system = FakeSystem(np.random.default_rng(0))
    for index, frame in enumerate(source):
        estimate = system.step(frame)
        if index == 2:
            other = Hypothesis(estimate.pose.mirrored(), 0.1, 0.25, np.diag([0.1, 0.2, 0.1]))
            estimate = Estimate(
                estimate.stamp_ns, estimate.pose, estimate.covariance, estimate.status, 0.1, 2, (other,)
            )
        view.show(frame, estimate)
    screen.finish()
    screen.close()
    return file


def read_back(file: Path) -> tuple[Counter[str], dict[str, list[Any]]]:
    """Rows by entity, and all scalars of each."""
    from rerun.chunk import RrdReader

    rows: Counter[str] = Counter()
    scalars: dict[str, list[Any]] = {}
    for chunk in RrdReader(str(file)).stream():
        name = str(chunk.entity_path)
        rows[name] += chunk.num_rows
        table = chunk.to_record_batch()
        if "Scalars:scalars" in table.schema.names:
            scalars.setdefault(name, []).extend(table.column("Scalars:scalars").to_pylist())
    return rows, scalars


def test_what_is_kept_for_the_viewer_holds_image_field_path_and_curves(tmp_path: Path) -> None:
    if not INSTALLED:
        with pytest.raises(InputError, match=WITHOUT):
            open_screen(None, tmp_path / "run.rrd")
        return
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # Rerun warns of what it can't take, and leaves it out
        file = shown(tmp_path, FakeSource(COUNT, missing=(5,)))
    rows, scalars = read_back(file)
    every = ("robot", "covariance", "hypotheses", "hypotheses/probability", "particles", "points", "true_robot")
    assert {name: rows[f"/above/field/{name}"] for name in every} == dict.fromkeys(every, COUNT)
    assert rows["/above/field/lines"] == rows["/above/field/posts"] == 1
    assert rows["/camera/image"] == rows["/camera/points"] == rows["/camera/field_lines"] == COUNT - 1
    assert rows["/above/field/path"] == COUNT - 2  # from one located frame to the next
    assert rows["/above/field/truth"] == COUNT - 1
    assert rows["/status"] == 3  # its colours; searching, then tracking
    assert rows["/log"] == 1  # the broken image
    errors = np.array(scalars["/plots/x/error"])[:, 0]
    assert np.isnan(errors[0])
    assert np.abs(errors[1:]).max() < 5.0  # cm, of the 1 cm that the system errs by
    np.testing.assert_allclose(scalars["/plots/x/band"][1], [2.0, -2.0], rtol=1e-6)
    assert len(scalars["/plots/latency/perception"]) == COUNT - START_FRAMES


def test_the_command_keeps_a_run_for_the_viewer(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording, file = write_recording(tmp_path / "tiny", 3), tmp_path / "kept.rrd"
    status = main(["run", str(recording), "--rrd", str(file), "-o", str(tmp_path / "run")])
    said = capsys.readouterr()
    if not INSTALLED:
        assert status == 2
        assert "pip install 'touchline[view]'" in said.err
        return
    assert status == 1  # one white line: nobody is localised, and it can be looked at why
    assert str(file) in said.out
    assert read_back(file)[0]["/camera/image"] == 3
    assert main(["run", str(recording), "--rrd", str(tmp_path / "other.rrd"), "-o", str(tmp_path / "run")]) == 2
    assert not (tmp_path / "other.rrd").exists()  # the run was refused


def test_a_recording_is_looked_at_without_a_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording, file = write_recording(tmp_path / "tiny", 2), tmp_path / "kept.rrd"
    status = main(["view", str(recording), "--rrd", str(file)])
    said = capsys.readouterr()
    if not INSTALLED:
        assert (status, "pip install 'touchline[view]'" in said.err) == (2, True)
        return
    assert status == 0
    assert said.out.splitlines()[0] == "searching 2"
    assert str(file) in said.out
    assert read_back(file)[0]["/camera/image"] == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["kept.rrd", "tiny"]


def test_a_robot_that_runs_is_looked_at(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = open_source(write_recording(tmp_path / "tiny", 1))
    camera, file, port = tmp_path / "tiny" / "camera.yaml", tmp_path / "live.rrd", free_port()
    image, done, robot = source.image_bytes(0), threading.Event(), UdpRobot(("127.0.0.1", port))

    def send() -> None:
        for number in itertools.count():
            if done.wait(0.05):
                return
            robot.send(Reading("compass", STEP_NS * number, (0.5,)))
            robot.send(Picture(STEP_NS * number, image, None, None))

    sender = threading.Thread(target=send)
    sender.start()
    try:
        live = [
            "live",
            "udp",
            "--field",
            source.field.name,
            "--camera",
            str(camera),
            "--listen",
            str(port),
            "--seconds",
            "0.7",
        ]
        status = main([*live, "--rrd", str(file)])
    finally:
        done.set()
        sender.join()
        robot.close()
    said = capsys.readouterr()
    if not INSTALLED:
        assert (status, "pip install 'touchline[view]'" in said.err) == (2, True)
        return
    assert status == 0
    assert f"for the viewer: {file}" in said.out
    rows, _ = read_back(file)
    assert rows["/camera/image"] == rows["/above/field/robot"] > 0
    assert not rows["/log"]
    assert not rows["/plots/x/error"]  # nobody knows the truth


def test_nobody_waits_for_what_is_shown_and_the_latest_is_shown_last() -> None:
    begun, go_on, shown = threading.Event(), threading.Event(), []

    def show(frame: Frame, estimate: Estimate) -> None:
        shown.append(frame.stamp_ns)
        begun.set()
        go_on.wait()

    latest = LatestShown(show)
    estimate = Estimate(0, Pose(0.0, 0.0, 0.0), np.eye(3), Status.TRACKING)
    latest.take(Frame(0), estimate)
    assert begun.wait(10.0)
    for stamp_ns in (1, 2, 3):
        latest.take(Frame(stamp_ns), estimate)
    go_on.set()
    latest.close()
    assert shown == [0, 3]


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


@pytest.mark.parametrize(
    "given",
    [["tiny", "--frame", "0"], ["tiny", "--stages"], ["tiny", "-o", "new"], ["image"]],
)
def test_pictures_of_one_image_and_the_viewer_exclude_each_other(
    given: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    write_recording(tmp_path / "tiny", 1)
    monkeypatch.chdir(tmp_path)
    (image,) = (tmp_path / "tiny" / "images").iterdir()
    source = [str(image), "--camera", "tiny/camera.yaml"] if given == ["image"] else given
    assert main(["view", *source, "--rrd", "a.rrd"]) == 2
    assert "pictures" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["tiny"]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["--view", "--rrd", "a.rrd"], "exclude each other"),
        (["--view=paper"], "expected web"),
        (["--rrd", "a.txt"], "written as .rrd"),
        (["--rrd", "tiny/camera.yaml"], "written as .rrd"),
    ],
)
def test_other_ways_to_look_are_refused(
    given: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    write_recording(tmp_path / "tiny", 1)
    monkeypatch.chdir(tmp_path)
    assert main(["run", "tiny", *given]) == 2
    assert said in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["tiny"]


def test_without_rerun_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(InputError, match=WITHOUT):
        open_screen("web")
    with pytest.raises(InputError, match=WITHOUT):
        open_screen(None, tmp_path / "a.rrd")


def test_the_ellipse_is_that_of_two_sigma() -> None:
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])
    covariance = np.eye(3)
    covariance[:2, :2] = turn @ np.diag([0.04, 0.01]) @ turn.T
    outline = covariance_ellipse(Pose(1.0, -2.0, 0.5), covariance) - np.array([1.0, -2.0])
    inverse = np.linalg.inv(covariance[:2, :2])
    np.testing.assert_allclose(np.einsum("ni,ij,nj->n", outline, inverse, outline), 4.0)
    assert np.hypot(*outline.T).max() == pytest.approx(0.4, rel=1e-3)


def test_particles_are_shown_where_they_are_what_the_pose_comes_from(tmp_path: Path) -> None:
    source = open_source(write_recording(tmp_path / "tiny", 1))
    searching = Estimate(0, Pose(0.0, 0.0, 0.0), np.eye(3), Status.SEARCHING)
    tracking = Estimate(0, Pose(0.0, 0.0, 0.0), np.eye(3), Status.TRACKING)
    system = open_system("nubot-mcl", {"field": source.field, "camera": source.camera})
    assert isinstance(system, NubotMcl)
    found = particles_now(system, searching)
    assert found is not None
    assert found.shape == (len(system.particles.particles), 4)
    assert particles_now(system, tracking) is None
    assert particles_now(open_system("touchline", source.field), searching) is None
