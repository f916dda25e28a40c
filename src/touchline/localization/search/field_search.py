"""Search of the whole field: every pose that explains an image, whatever it shows.

Line points are looked for on a grid of poses (`PoseSearch`), lines, crossings and landmarks propose poses by pairs
(`FeatureSearch`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from touchline.field import FieldModel
from touchline.geometry import FloatArray, Pose
from touchline.localization.camera_errors.base import Response
from touchline.localization.registration.feature_model import FeatureModel, FeatureView
from touchline.localization.registration.joint import Seen, StatePrior
from touchline.localization.registration.registration import Registration
from touchline.localization.search.feature_poses import PoseProposals
from touchline.localization.search.feature_search import FeatureSearch
from touchline.localization.search.pose_search import Known, Mode, PoseSearch

WHOLE = (0, 1)  # the first of one part
MIN_POINTS = 10  # with which a grid is searched


class Searched(NamedTuple):
    """An image to be searched for: what it shows, the same as features without the lean that is known, its line points
    (N, 2) without the camera's errors that are known, and what is expected of pose and camera. all_round: whether it
    shows the whole field; pairs of the lines of a sector fit fewer places than its points.
    """

    seen: Seen
    view: FeatureView
    upright_m: FloatArray
    expected: StatePrior
    response: Response
    all_round: bool


class FieldSearch:
    """Finds the poses that explain an image. reach_m (2,): how far from the centre a robot may stand."""

    def __init__(self, field: FieldModel, registration: Registration, model: FeatureModel, reach_m: FloatArray) -> None:
        self.points = PoseSearch(field, registration)
        self.features = FeatureSearch(PoseProposals(model, reach_m), registration, field.is_symmetric)

    def modes(self, searched: Searched, known: Sequence[Known] = (), part: tuple[int, int] = WHOLE) -> tuple[Mode, ...]:
        """The likeliest first. known: of the pose. part: which of so many parts, so that a search can be shared out
        among images; features are searched for in the first one.
        """
        seen, found = searched.seen, tuple[Mode, ...]()
        if len(searched.upright_m) >= MIN_POINTS and (searched.all_round or not len(searched.view.lines.ends_m)):
            found = self.points.everywhere(searched.upright_m, seen.covariances_m2, known, part)
        if searched.view.size and part[0] == 0:
            more = self.features.modes(seen, searched.view, searched.expected, searched.response, known)
            found = (*found, *(one for one in more if not any(_is_near(one.pose, other.pose) for other in found)))
        return found


def _is_near(one: Pose, other: Pose) -> bool:
    return one.distance_to(other) < 0.3 and abs(one.inverse().compose(other).heading) < 0.2
