"""Same seed, same bytes: in every process, whatever its memory held before and however it hashes."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

PROGRAM = """
import hashlib, sys
import numpy as np
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

level, names = sys.argv[1], sys.argv[2:]
digest = hashlib.sha256()
for name in names:
    simulation = Simulation(open_scenario(name, 3, 6.0 if level == "points" else 0.3, ["ideal=true"]), level)
    for index in range(0, len(simulation), 3):
        frame = simulation.frame(index)
        arrays = [s.values for s in (frame.odometry, frame.wheels, frame.gyro, frame.compass, frame.tilt) if s]
        if level == "points":
            p = frame.observation.points
            arrays += [p.positions_m, p.covariances_m2, p.confidences, p.pixels]
            arrays.append(simulation.features(index).crossings.positions_m)
        else:
            arrays.append(frame.image)
        for array in arrays:
            digest.update(np.ascontiguousarray(array).tobytes())
print(digest.hexdigest())
"""


@pytest.mark.parametrize(
    ("level", "names"),
    [("points", ("straight-tracks", "occlusion-50", "humanoid-walk")), ("images", ("occlusion-50", "humanoid-walk"))],
)
def test_another_process_with_other_memory_and_hashes_makes_the_same_run(level: str, names: tuple[str, ...]) -> None:
    """MALLOC_PERTURB_ fills fresh memory with a byte of its own: what reads it before writing gives itself away."""
    runs = []
    for fill, hashing in (("85", "1"), ("170", "2")):
        environment = {**os.environ, "MALLOC_PERTURB_": fill, "PYTHONHASHSEED": hashing}
        command = [sys.executable, "-c", PROGRAM, level, *names]
        runs.append(subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True))
    digests = [run.communicate(timeout=300)[0] for run in runs]
    assert [run.returncode for run in runs] == [0, 0]
    assert len(digests[0]) == 65
    assert len(set(digests)) == 1
