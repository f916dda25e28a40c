"""Global localization by particles, and when their pose is believed (Lu et al. 2013, section 4 and figure 3)."""

from dataclasses import replace

from pydantic import Field

from touchline.config import Settings, added
from touchline.field.region import Region
from touchline.geometry import Pose, as_pose
from touchline.localization.registration.covariance import is_one_line
from touchline.motion import Motion
from touchline.published.nubot.doubt import stands_alone
from touchline.published.nubot.failure import MAX_HEADING_ERROR_RAD
from touchline.published.nubot.global_localizer import Localization, Prediction
from touchline.published.nubot.global_search import GlobalSearch
from touchline.published.nubot.match_input import MatchInput, refine_with_tilt
from touchline.published.nubot.matcher import Match
from touchline.published.nubot_mcl.particles import NubotParticles, NubotParticleSettings

# times in a row that a new start must come back to a pose until it is believed though it was not accepted, as nubot-
# mti's global search: real calibrations may leave more than accepted_error everywhere
CONFIRMATIONS = 3
# distance within which two poses are the same, the odometry's motion between them taken off: less than that of two
# clusters
SAME_M = 0.5


class ParticleSearchPaper(Settings):
    """Switches to the paper's exact form."""

    keep_unless_better: bool = added(
        True,
        paper=False,
        description="start the particles after bad frames only if some other place explains the points far better: "
        "near a goal that hidden sectors cut in two, clutter makes frames bad at the right pose, too. The paper starts "
        "them in any case",
    )
    widening: float = added(
        2.0,
        paper=1.0,
        ge=1,
        description="factor by which every new start widens the first headings about the compass, which may err by "
        "more than thought; 1 as in the paper",
    )
    judged: bool = added(
        True,
        paper=False,
        description="converged particles are believed once the match that they lead to fits (accepted_error), or they "
        "come to it again; false as in the paper: as soon as they have converged",
    )
    given_up: bool = added(
        True,
        paper=False,
        description="particles that have not converged within max_cycles start anew; false as in the paper: they go on",
    )


class ParticleSearchSettings(Settings):
    """When particles start anew, and when the pose that they agree on is believed."""

    particles: NubotParticleSettings = NubotParticleSettings()
    accepted_error: float = Field(
        0.1,
        gt=0,
        le=1,
        description="weighted mean error with matching's c, at the match that their mean leads to, below which the "
        "converged particles are believed, as nubot-mti's global search; above it they start anew",
    )
    max_cycles: int = Field(
        15,
        ge=1,
        le=10_000,
        description="cycles after which particles that have not converged start anew: they converge within 5",
    )
    paper: ParticleSearchPaper = ParticleSearchPaper()


class ParticleSearch:
    """Particles over the frames of a search: when they start, a cycle per frame, when they have come to a pose.

    `cycles` since the last start, 0 while the particles rest; `starts` of this search.
    """

    def __init__(self, particles: NubotParticles, settings: ParticleSearchSettings) -> None:
        self.particles = particles
        self.settings = settings
        self.reset()

    def reset(self) -> None:
        """The next search is the first."""
        self.cycles = self.starts = self.confirmations = 0
        self.unconfirmed_pose: Pose | None = None

    def predict(self, motion: Motion) -> None:
        """The odometry carries every particle on while they are in use, and the pose that is to be confirmed."""
        if self.cycles:
            self.particles.predict(motion)
        if self.unconfirmed_pose is not None:
            self.unconfirmed_pose = self.unconfirmed_pose.compose(motion.pose)

    def start_if_due(self, view: MatchInput, prediction: Prediction, region: Region | None) -> None:
        """A new search spreads the particles over the field, and so does one that has gone on for too long."""
        if prediction.lost or not self.cycles:
            self.reset()
        elif self.cycles < self.settings.max_cycles or not self.settings.paper.given_up:
            return
        self._start(view, prediction if prediction.lost or self.starts > 0 else None, region)

    def start_around(self, view: MatchInput, prediction: Prediction, region: Region | None) -> None:
        """All particles start about the prediction, unless the compass contradicts it."""
        self._start(view, prediction, region, everything_near=True)

    def cycle(self, view: MatchInput) -> Localization:
        """Weights, mean, resampling; the odometry has moved the particles before. The mean is the best guess."""
        self.cycles += 1
        positions_m, matcher = view.positions_m, self.particles.matcher
        mean = self.particles.update(positions_m, view.weights, view.heading_rad)
        pose = mean.pose.as_array()
        match = matcher.assess(positions_m, view.weights, pose, matcher.error(positions_m, view.weights, pose))
        return Localization(mean.pose, mean.covariance, match, confirmed=False, has_pose=False)

    @property
    def converged(self) -> bool:
        """Whether the particles agree on a pose."""
        return self.particles.converged

    def confirms(self, match: Match) -> bool:
        """Whether the pose that the particles agree on is believed: it fits, or they came to it several times in a row.

        If it is not, they start anew with the next frame.
        """
        fits = match.error < self.settings.accepted_error or not self.settings.paper.judged
        if fits or self._came_again(match.pose):
            return True
        self.cycles = self.settings.max_cycles
        return False

    def rest(self) -> None:
        """The search is over, until the next one starts anew."""
        self.cycles = 0

    def give_up(self) -> None:
        """The particles start anew with this frame, if they are in use."""
        if self.cycles:
            self.cycles = self.settings.max_cycles

    def _came_again(self, pose: Pose) -> bool:
        last = self.unconfirmed_pose
        same = last is not None and pose.distance_to(last) < SAME_M
        self.confirmations = self.confirmations + 1 if same else 0
        self.unconfirmed_pose = pose
        return self.confirmations >= CONFIRMATIONS

    def _start(
        self,
        view: MatchInput,
        near: Prediction | None,
        region: Region | None,
        everything_near: bool = False,
    ) -> None:
        """Spread the particles over the field, and some of them, or all, about a pose that is plausible."""
        about = None
        if near is not None and view.heading_is_plausible(near.pose.heading, MAX_HEADING_ERROR_RAD):
            about = near.pose, near.covariance
        widening = self.settings.paper.widening**self.starts
        heading_rad = view.heading_rad
        if heading_rad is None and self.starts % 2 == 0:  # every other time: the jump may have been another error
            heading_rad = view.heading_without_jump_rad
        self.particles.restart(heading_rad, region, about, widening=widening, everything_near=everything_near)
        self.cycles = 0
        self.starts += 1


class ParticleLocalizer:
    """Monte Carlo localization until the particles agree on a pose that fits; matching goes on from there."""

    def __init__(self, search: ParticleSearch, whole_field: GlobalSearch | None = None) -> None:
        """whole_field: which must know no other place that explains the points as well; the paper has no such test."""
        self.search = search
        self.whole_field = whole_field
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.search.reset()
        self._seen_one_line = False

    def localize(self, view: MatchInput, prediction: Prediction, region: Region | None = None) -> Localization:
        """One cycle; once the particles have converged, the match that their mean leads to."""
        one_line = self.whole_field is not None and is_one_line(view.positions_m)
        if self._seen_one_line and not one_line:
            self.search.give_up()  # the line may have been none, and all particles have gathered along it
        self._seen_one_line = one_line
        self.search.start_if_due(view, prediction, region)
        found = self.search.cycle(view)
        if not self.search.converged:
            return found
        matcher = self.search.particles.matcher
        pose, error, _ = matcher.descend(view.positions_m, view.weights, found.pose.as_array())
        match = refine_with_tilt(matcher, view, as_pose(pose).as_array(), error)
        confirmed = self.search.confirms(match) and self._stands_alone(view, match)
        if confirmed:
            self.search.rest()
        return Localization(match.pose, match.covariance, match, confirmed, has_pose=confirmed)

    def _stands_alone(self, view: MatchInput, match: Match) -> bool:
        """Whether no other place explains the points as well as this match."""
        if self.whole_field is None:
            return True
        fix = self.whole_field.locate_any_heading(view.positions_m, view.weights, view.heading_rad)
        held = match.error >= self.search.settings.accepted_error
        return stands_alone(self.whole_field, fix, match, match.covariance, held)


class ParticleFollower:
    """Particles that find the robot and go on to follow it, a cycle per frame."""

    def __init__(self, search: ParticleSearch) -> None:
        self.search = search

    def localize(self, view: MatchInput, prediction: Prediction, region: Region | None = None) -> Localization:
        """One cycle of a search; what the particles have converged to is judged at the match nearby."""
        self.search.start_if_due(view, prediction, region)
        found = self.search.cycle(view)
        if not self.search.converged:
            return found
        confirmed = self.search.confirms(self.match_nearby(view, found.pose))
        return replace(found, confirmed=confirmed, has_pose=confirmed)

    def follow(self, view: MatchInput, prediction: Prediction, region: Region | None = None) -> Localization:
        """One more cycle; particles that rest start about the prediction."""
        if not self.search.cycles:
            self.search.start_around(view, prediction, region)
        return replace(self.search.cycle(view), has_pose=True)

    def match_nearby(self, view: MatchInput, mean: Pose) -> Match:
        """The match that a mean leads to, or the mean itself if that is far away: it says nothing of the mean then."""
        matcher, positions_m = self.search.particles.matcher, view.positions_m
        pose, error, _ = matcher.descend(positions_m, view.weights, mean.as_array())
        if mean.distance_to(as_pose(pose)) > SAME_M:
            pose, error = mean.as_array(), matcher.error(positions_m, view.weights, mean.as_array())
        return matcher.assess(positions_m, view.weights, pose, error)
