"""When the whole field is searched, and which of the poses that are found become hypotheses."""

import math
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

from touchline.geometry import FloatArray, Pose
from touchline.localization.camera_errors.base import placed_points
from touchline.localization.estimator.bank import Bank, Image
from touchline.localization.estimator.field_end import OwnHalf
from touchline.localization.registration.feature_model import FeatureView
from touchline.localization.registration.seen import POINT_SHARE, evenly_counted
from touchline.localization.search.field_search import WHOLE, FieldSearch, Searched
from touchline.localization.search.pose_search import Known, Mode, Wanted

PARTS = 5  # of the headings: a fifth of them, in a third of the images, delays none by a whole search
# so many while a sector's pose is watched: each proposes all poses anew, and two more of fifteen images are free
SECTOR_PARTS = 3
HOPELESS = 40.0  # logarithm of odds, of line points or of all, against the pose that is followed: none is tried beyond
NEAR_M, NEAR_RAD = 0.5, 0.5  # poses nearer than this are the same place


class Ends(NamedTuple):
    """What is known of the ends of the field: whether it is symmetric, and whether the robot was in its own half."""

    symmetric: bool
    own_half: OwnHalf | None


class FieldWatch:
    """Searches the whole field in doubt, and part after part of it now and then. `left`: parts of a search in
    doubt that no image has had time for; `finds_first`: whether it began without a pose and goes on in this image.
    """

    def __init__(self, search: FieldSearch, every: int, budget_ms: float | None = None) -> None:
        """every: images in which the whole field is searched once though nothing is wrong. budget_ms: that a search in
        doubt may take of an image, one part at least; None: it is done at once.
        """
        self.search, self.every, self.budget_ms = search, every, budget_ms
        self.watched_parts = PARTS
        self.reset()

    def reset(self) -> None:
        """No image has been searched."""
        self._due, self._part, self._in_doubt = 0, 0, False
        self.left, self.finds_first = 0, False

    def part(self, in_doubt: bool, follows: bool) -> tuple[int, int] | None:
        """Which of so many parts is searched in this image, within a budget the first of them; None: nothing. follows:
        whether there is a pose.
        """
        begins, self._in_doubt = in_doubt and not self.left, in_doubt
        if in_doubt and self.budget_ms is None:
            self._due = 0
            return WHOLE
        self.left = PARTS if begins else self.left
        self.finds_first = self.left > 0 and (not follows if begins else self.finds_first)
        if in_doubt or self.left:
            self._due = 0
            return self._next(PARTS)
        parts = min(self.watched_parts, self.every)
        self._due += parts
        if self._due < self.every:
            return None
        self._due -= self.every
        return self._next(parts)

    def _next(self, parts: int) -> tuple[int, int]:
        self._part = (self._part + 1) % parts
        return self._part, parts

    def modes(
        self,
        image: Image,
        view_at: Callable[[FloatArray], FeatureView],
        bank: Bank,
        known: Sequence[Known],
        part: tuple[int, int],
        ends: Ends,
    ) -> tuple[Mode, ...]:
        """Poses that explain an image; on a symmetric field one of each pair of twins. view_at: its features without
        errors (K,) of the camera; known: of the pose.
        """
        begun_s, best, knowing, trust = time.perf_counter(), bank.best, bank.knowing, bank.trust
        seen = evenly_counted(image.seen)
        upright = placed_points(seen.positions_m, knowing.errors, image.response)
        expected = knowing.prior(bank.statistics.per_image)
        wanted, watches = None, part != WHOLE and not (self._in_doubt or self.left)
        if watches and best is not None and best.fit is not None:
            of_points = best.fit.log_likelihood / POINT_SHARE - HOPELESS if trust.free_fit else -math.inf
            of_all = -math.inf if seen.crude else best.fit.log_likelihood - HOPELESS
            wanted = Wanted(best.fit.state[:3], of_points, of_all)
        searched = Searched(seen, view_at, upright, expected, image.response, trust.free_fit, wanted=wanted)
        modes = self.search.modes(searched, known, part)
        if part != WHOLE and not watches:
            modes = self._continued(modes, searched, known, begun_s)
        if not ends.symmetric:
            return tuple(mode for mode in modes if mode.pose.x <= 0.0 or best is not None or ends.own_half is None)
        followed, half = [one.filter.pose for one in bank.members], ends.own_half
        if half is not None:
            modes = tuple(
                mode if half.log_odds(mode.pose) >= 0.0 or _is_near(mode, followed) else mode.mirrored()
                for mode in modes
            )
        return at_one_end(modes, followed, aligned=not known and half is None)

    def _continued(
        self, modes: tuple[Mode, ...], searched: Searched, known: Sequence[Known], begun_s: float
    ) -> tuple[Mode, ...]:
        """The modes of a first part and of those for which there is time, if each takes as long as those before."""
        assert self.budget_ms is not None
        done, self.left = 1, max(self.left - 1, 0)
        while done < PARTS and 1e3 * (time.perf_counter() - begun_s) * (done + 1) / done < self.budget_ms:
            modes += self.search.modes(searched, known, self._next(PARTS))
            done, self.left = done + 1, max(self.left - 1, 0)
        return tuple(sorted(modes, key=lambda mode: -mode.log_likelihood))


def _is_near(mode: Mode, poses: Sequence[Pose]) -> int:
    """How many poses it is near to."""
    return sum(mode.pose.is_near(pose, NEAR_M, NEAR_RAD) for pose in poses)


def at_one_end(modes: Sequence[Mode], followed: Sequence[Pose], aligned: bool) -> tuple[Mode, ...]:
    """Of each pair of twins the likelier one, or that which is nearer to a pose that is followed, the likeliest first.
    aligned: nothing distinguishes them, and the heading of the likeliest decides.
    """
    kept: list[Mode] = []
    for mode in sorted(modes, key=lambda one: -_is_near(one, followed)):
        ends = mode.pose, mode.pose.mirrored()
        if any(end.is_near(one.pose, NEAR_M, NEAR_RAD) for one in kept for end in ends):
            continue
        turned = bool(followed) and math.cos(mode.pose.heading - followed[0].heading) < 0.0
        kept.append(mode.mirrored() if aligned and turned else mode)
    return tuple(kept)
