"""Search of the whole field: every pose that explains an image, whatever it shows.

Line points are looked for on a grid of poses (`PoseSearch`), lines, crossings and landmarks propose poses by pairs
(`FeatureSearch`).
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from touchline.field import FieldModel
from touchline.field.association import FieldAssociations
from touchline.geometry import FloatArray
from touchline.localization.camera_errors.base import Response
from touchline.localization.registration.attitudes import LIKELY, likely_attitudes
from touchline.localization.registration.feature_model import FeatureModel, FeatureView, field_lines
from touchline.localization.registration.features import Features
from touchline.localization.registration.joint import Seen, StatePrior
from touchline.localization.registration.registration import Registration
from touchline.localization.search.feature_poses import PoseProposals
from touchline.localization.search.feature_search import FeatureSearch
from touchline.localization.search.pose_search import Known, Mode, PoseSearch, Wanted

WHOLE = (0, 1)  # the first of one part
MIN_POINTS = 10  # with which a grid is searched
PLACE_M = 0.01  # error of a crossing's place on the field
BEYOND_M = 1.0  # so far outside of the field a robot may stand
SAME_M, SAME_RAD = 0.3, 0.2  # modes of points and of features nearer than this are one


class Searched(NamedTuple):
    """An image to be searched for: what it shows, the same as features without errors (K,) of the camera, its line
    points (N, 2) without those that are known, and what is expected of pose and camera. all_round: whether it shows the
    whole field; pairs of the lines of a sector fit fewer places than its points, and tell how its camera leans.
    attitudes: how many are searched. wanted: None: every pose.
    """

    seen: Seen
    view_at: Callable[[FloatArray], FeatureView]
    upright_m: FloatArray
    expected: StatePrior
    response: Response
    all_round: bool
    attitudes: int = LIKELY
    wanted: Wanted | None = None


class FieldSearch:
    """Finds the poses that explain an image. `places`, `model`, `registration`: of the field, for what it shows."""

    def __init__(self, field: FieldModel) -> None:
        self.places = FieldAssociations(field)
        self.model = FeatureModel(self.places.tables, field_lines(field), polar=False)
        self.registration = Registration(field.distance_map(), self.places.tables)
        reach_m = 0.5 * np.array([field.length, field.width]) + BEYOND_M
        self.points = PoseSearch(field, self.registration)
        self.features = FeatureSearch(PoseProposals(self.model, reach_m), self.registration, field.is_symmetric)

    def features_at(self, height_m: float) -> Features:
        """Takes the features of observations by a camera at a height."""
        return Features(self.places, None, height_m, PLACE_M)

    def modes(self, searched: Searched, known: Sequence[Known] = (), part: tuple[int, int] = WHOLE) -> tuple[Mode, ...]:
        """The likeliest first. known: of the pose. part: which of so many parts, so that a search can be shared out
        among images.
        """
        seen, found = searched.seen, tuple[Mode, ...]()
        mean = searched.expected.mean[3:]
        view = searched.view_at(mean)
        if len(searched.upright_m) >= MIN_POINTS and (searched.all_round or not len(view.lines.ends_m)):
            found = self.points.everywhere(searched.upright_m, seen.covariances_m2, known, part, searched.wanted)
        if view.size:
            attitudes = self.attitudes(searched)
            views = [(each, view if np.array_equal(each, mean) else searched.view_at(each)) for each in attitudes]
            camera = searched.expected, searched.response
            more = self.features.modes(seen, views, *camera, known, part, searched.wanted)
            poses = [one.pose for one in found]
            found += tuple(one for one in more if not any(one.pose.is_near(pose, SAME_M, SAME_RAD) for pose in poses))
        return found

    def attitudes(self, searched: Searched) -> list[FloatArray]:
        """The attitudes, as errors (K,) of the camera, that are searched."""
        expected = searched.expected
        if searched.all_round:
            return [expected.mean[3:]]
        as_seen = searched.view_at(np.zeros(len(expected.mean) - 3)).lines
        return likely_attitudes(as_seen, expected, searched.response, searched.attitudes)
