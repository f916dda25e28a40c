"""The DDS that ROS 2 speaks by default: every message between its library and ours, both ways. `make fastdds`.

It needs a C++ compiler and Fast DDS (Debian: apt-get install g++ libfastrtps-dev), and fails where they are missing.
"""

from __future__ import annotations

import subprocess
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from touchline.geometry import Pose
from touchline.live.dds import Dds
from touchline.live.heard import Heard, Published, Reading
from touchline.live.ros_link import RosLink
from touchline.types import Estimate, Status

PEER = Path(__file__).parents[1] / "examples" / "fastdds" / "peer.cpp"
COUNT = 300
MISSING = "Fast DDS can't be compiled against here: apt-get install g++ libfastrtps-dev"


@pytest.fixture(scope="module")
def peer(tmp_path_factory: pytest.TempPathFactory) -> Path:
    program = tmp_path_factory.mktemp("fastdds") / "peer"
    compiler = ["g++", "-O1", "-o", str(program), str(PEER), "-lfastrtps", "-lfastcdr"]
    try:
        done = subprocess.run(compiler, capture_output=True, text=True, timeout=120, check=False)
    except FileNotFoundError:
        pytest.fail(MISSING)
    assert done.returncode == 0, f"{MISSING}\n{done.stderr}"
    return program


@pytest.fixture(autouse=True)
def alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "98")


def test_what_fast_dds_publishes_is_heard_though_it_starts_later(peer: Path) -> None:
    link = RosLink(Dds())
    time.sleep(2.0)
    heard: list[Heard] = []
    with subprocess.Popen([str(peer), "talk", str(COUNT)]) as talks:
        ends_s = time.monotonic() + 60.0
        while talks.poll() is None and time.monotonic() < ends_s:
            heard += link.hear(0.05)
    heard += link.hear(0.2)
    link.close()
    stamps = [each.stamp_ns for each in heard if isinstance(each, Reading)]
    assert stamps == [10_000_000 * (k + 1) for k in range(COUNT)]


def test_what_is_told_is_heard_by_fast_dds(peer: Path) -> None:
    link = RosLink(Dds())
    estimate = Estimate(0, Pose(0.0, 2.0, 0.5), np.eye(3), Status.SEARCHING)
    with subprocess.Popen([str(peer), "listen", str(COUNT)], stdout=subprocess.PIPE, text=True) as listens:
        assert listens.stdout is not None
        assert listens.stdout.readline() == "ready\n"
        time.sleep(3.0)
        for k in range(COUNT):
            link.publish(
                Published(replace(estimate, stamp_ns=(k + 1) * 10_000_000, pose=Pose(0.01 * (k + 1), 2.0, 0.5)))
            )
            time.sleep(0.01)
        lines = listens.communicate(timeout=60.0)[0].splitlines()
    link.close()
    assert len(lines) == COUNT
    assert lines[-1].split() == ["3.000000000", "3.000000", "2.000000", "map"]
