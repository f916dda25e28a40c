"""A search by features that is shared out among images."""

from types import SimpleNamespace
from typing import Any

import numpy as np

from touchline.localization.registration.joint import StateFit, StatePrior
from touchline.localization.search.feature_search import FeatureSearch


class Recorder:
    """Registers nothing: every pose explains the image at once. `starts`: those that were tried."""

    def __init__(self) -> None:
        self.starts: list[float] = []

    def fit_state(self, seen: Any, start: Any, prior: Any, plan: Any, response: Any) -> StateFit:
        self.starts.append(float(start[0]))
        return StateFit(start, np.eye(3), np.zeros(3), 1.0, 1.0, 1.0, 0.0, 0.0, 0.0)


def test_parts_register_every_proposed_pose_once_and_share_them_evenly() -> None:
    poses = np.column_stack((np.arange(7.0), np.zeros(7), np.zeros(7)))
    proposals: Any = SimpleNamespace(of=lambda view: SimpleNamespace(poses=poses, log_likelihoods=-np.arange(7.0)))
    nothing: Any = None
    tried = []
    for part in ((0, 3), (1, 3), (2, 3)):
        recorder: Any = Recorder()
        search = FeatureSearch(proposals, recorder, symmetric=False)
        modes = search.modes(nothing, [(np.zeros(0), nothing)], StatePrior(np.zeros(3), np.eye(3)), nothing, (), part)
        assert len(modes) == len(recorder.starts)
        tried.append(recorder.starts)
    assert tried == [[0.0, 3.0, 6.0], [1.0, 4.0], [2.0, 5.0]]
