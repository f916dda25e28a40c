"""A system of a few lines that follows no paper: what holds of every system holds of it, and no test has to name it.

In the house it would be a file in `systems`, a line in the registry and a page in `docs`.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
import test_bounds
import test_docs_site
import test_house
import test_notebook
import test_paper_form
import test_systems
from pydantic import Field
from settings_page import settings_page

from touchline import locate
from touchline.config import Settings
from touchline.errors import NoFitError
from touchline.geometry import Pose
from touchline.motion import CompassTrackSettings, MotionHistory, OdometrySettings
from touchline.perception import LearningSettings, LinePointSettings, SelfLearningDetector, observe
from touchline.systems import SYSTEMS, RobotSetup, SystemInfo
from touchline.systems.setup import system_text
from touchline.types import Estimate, Frame, Observation, Prior, Status, as_prior


class LeanSettings(Settings):
    """One number."""

    min_points: int = Field(20, ge=8, le=10_000, description="line points without which an image tells nothing")


class Lean:
    """Every image by itself, and the odometry where it tells nothing."""

    __repr__ = system_text

    def __init__(self, setup: RobotSetup, settings: LeanSettings, rng: np.random.Generator) -> None:
        camera, width_m = setup.camera, setup.field.line_width
        self.setup, self.settings = setup, settings
        learned = (LinePointSettings(), LearningSettings(), width_m)
        self.detector = None if camera is None else SelfLearningDetector(camera, *learned)  # type: ignore[arg-type]
        self.history = MotionHistory(OdometrySettings(), CompassTrackSettings())
        self.reset()

    def reset(self, prior: Prior | None = None) -> None:
        self.history.clear()
        self.pose, self.covariance = as_prior(prior).pose or Pose(0.0, 0.0, 0.0), np.diag([9.0, 9.0, 9.0])

    def step(self, frame: Frame) -> Estimate:
        motion = self.history.take(frame)
        self.pose, self.covariance = self.pose.compose(motion.pose), self.covariance + motion.covariance  # predict
        seen = observe(frame, self.detector, self.setup.max_range_m)  # observe
        found = self._locate(seen)  # search
        status = Status.TRACKING if found else Status.SEARCHING
        return Estimate(frame.stamp_ns, self.pose, self.covariance, status, points=len(seen.points), observation=seen)

    def _locate(self, seen: Observation) -> bool:
        if len(seen.points) < self.settings.min_points:
            return False
        try:
            found = locate(seen.points, self.setup.field, self.history.at(seen.stamp_ns).heading_rad)
        except NoFitError:
            return False
        self.pose, self.covariance = found.pose, found.covariance
        return True


@pytest.fixture(autouse=True)
def registered() -> Iterator[None]:
    """As by its line in `systems/__init__.py`, the last one."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(SYSTEMS, "lean", SystemInfo("lean", "every image by itself", LeanSettings, Lean))
        yield


def test_it_is_a_system_as_any_other() -> None:
    test_systems.test_a_system_is_composed_and_inherits_nothing("lean")
    test_systems.test_a_step_is_a_list_of_at_most_fifteen_lines("lean")
    test_systems.test_poses_hold_plain_floats("lean")
    test_systems.test_a_system_takes_frames_with_points_with_images_and_with_neither("lean", "points")
    test_systems.test_a_system_takes_frames_with_points_with_images_and_with_neither("lean", "neither")


def test_its_settings_are_as_any_other_s() -> None:
    test_house.test_every_setting_says_what_it_is(LeanSettings)
    test_house.test_a_system_has_forty_settings_at_most("lean")
    test_bounds.test_every_whole_number_of_a_system_has_an_upper_bound("lean")
    test_paper_form.test_settings_come_back_as_they_were_written()
    test_docs_site.test_the_page_shows_no_setting_twice()
    assert "## lean\n\nEvery image by itself.\n1 setting with the shared ones.\n" in settings_page()


def test_python_shows_it_as_any_other() -> None:
    test_notebook.test_a_system_is_opened_from_names_and_dicts_and_says_what_it_is("lean")
