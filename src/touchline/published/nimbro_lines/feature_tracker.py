"""The pose that the particles of Schulz and Behnke 2012 have come to.

A pose is followed by least squares on the features (ours) or by the mean of the particles' main mode (the paper's).
Whether it is believed is judged beside it (feature_belief), and so is at which end of the field it is (field_ends); a
mode elsewhere that explains more for some time takes its place, and so does a twin that colours speak for.
"""

from touchline.geometry import FloatArray, Pose, mirrored_covariance
from touchline.localization.registration.covariance import UncertaintySettings
from touchline.localization.registration.feature_model import FeatureModel, FeatureView
from touchline.motion.odometry import Motion
from touchline.published.nimbro_lines.feature_belief import BeliefSettings, FeatureBelief, is_narrow
from touchline.published.nimbro_lines.feature_filter import FeatureFilter
from touchline.published.nimbro_lines.field_ends import FieldEnds
from touchline.published.nimbro_lines.particles import MODE_M, MODE_RAD, ParticleMode
from touchline.types import Hypothesis, Prior, Status

SURE_WEIGHT = 0.8  # share of the particles' weight in one mode from which there is a pose at all
# how far another place may be away for the robot to be still at the end that it was at: it slipped. Of all places that
# a robot may be carried to, the twins of less than one in a hundred are so near
SLIP_M, SLIP_RAD = 1.0, 0.5


class FeatureTracker:
    """`filter`: the pose and its covariance; `belief`: its status; `ends`: at which end of the field it is.

    `turned`: whether the last frame made the twin of the pose the pose.
    """

    def __init__(
        self,
        feature_filter: FeatureFilter,
        symmetric: bool,
        settings: BeliefSettings | None = None,
        refine: bool = True,
        colours: FeatureModel | None = None,
    ) -> None:
        """symmetric: nothing tells both ends of the field apart. refine: by least squares; else the mode's mean.

        colours: the model of the features, where their colours alone tell the ends apart.
        """
        self.filter, self.refine = feature_filter, refine
        self.belief = FeatureBelief(settings)
        self.ends = FieldEnds(symmetric, refine, colours)
        self.unknown = UncertaintySettings().unknown
        self.reset()

    def reset(self, prior: Prior | None = None) -> None:
        """Forget everything but the prior."""
        prior = prior or Prior()
        start_known = prior.pose is not None
        covariance = self.belief.settings.start_covariance if prior.covariance is None else prior.covariance
        self.filter.forget_lean()
        self.filter.start(prior.pose or Pose(0.0, 0.0, 0.0), covariance)
        self.belief.reset(start_known)
        self.ends.reset(start_known, prior.own_half)
        self.has_pose = start_known
        self.turned = False

    @property
    def status(self) -> Status:
        """Whether the pose is believed."""
        return self.belief.status

    @property
    def pose(self) -> Pose:
        """The best guess."""
        return self.filter.pose

    @property
    def covariance(self) -> FloatArray:
        """(3, 3) of the pose. One that is not believed is the best guess, but the robot may be anywhere."""
        return self.filter.covariance + (0.0 if self.status is Status.TRACKING else self.unknown)

    @property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """The twin at the other end, where nothing tells, or has told yet, at which end the robot is."""
        if self.ends.known and not self.ends.in_doubt:
            return ()
        covariance = mirrored_covariance(self.covariance)
        return (Hypothesis(self.pose.mirrored(), self.belief.residual_m, covariance=covariance),)

    def predict(self, motion: Motion, deviations: FloatArray) -> None:
        """The odometry carries the pose on; deviations (3,) of the motion, robot frame."""
        self.filter.predict(motion, deviations)

    def update(self, view: FeatureView, mode: ParticleMode, stamp_ns: int) -> None:
        """Follow the pose with what is seen, or take that of the particles, and judge it."""
        if not self.has_pose:
            self._take(mode)
            self.belief.take_anew(stamp_ns)
        elif self.refine:
            self._follow(view, self.ends.nearer(mode, self.pose))
        else:
            self._follow_mode(view, mode)
        self.turned = self.has_pose and self.ends.compare(view, self.pose)
        if self.turned:
            self.filter.start(self.pose.mirrored(), mirrored_covariance(self.filter.covariance))
        doubted = not is_narrow(self.filter.covariance) or self.ends.in_doubt
        self.belief.judge(stamp_ns, self.pose if self.has_pose else None, doubted)

    @property
    def is_lost(self) -> bool:
        """Whether the particles should start anew: the pose explains too little, and so do they."""
        return self.belief.is_lost

    def lose(self) -> None:
        """There is no pose any more."""
        self.has_pose = False
        self.belief.lose()
        self.ends.lose()

    def _follow(self, view: FeatureView, mode: ParticleMode) -> None:
        """Least squares on the features, beside a mode of the particles that may be elsewhere."""
        elsewhere = mode.weight >= SURE_WEIGHT and not mode.pose.is_near(self.pose, MODE_M, MODE_RAD)
        rival = self.filter.explained(view, mode.pose) if elsewhere else None
        near = None if elsewhere or mode.weight < SURE_WEIGHT else mode.pose
        explained = self.filter.update(view, near)
        self.belief.count(explained, rival, self.pose)
        if self.belief.is_refuted:
            if not self._is_slip(mode.pose):
                self.ends.jump()
            self._take(mode)

    def _follow_mode(self, view: FeatureView, mode: ParticleMode) -> None:
        """The mean of the particles' main mode, wherever that is: the paper's form."""
        explained = self.filter.explained(view, mode.pose)
        if not self._is_slip(mode.pose):
            self.ends.jump()
            self.belief.start_anew()
        self.filter.start(mode.pose, mode.covariance)
        self.belief.count(explained, None, self.pose)

    def _take(self, mode: ParticleMode) -> None:
        """The particles' mode is the pose from now on, to be confirmed."""
        if not self._is_slip(mode.pose):
            self.ends.forget_twin()
        self.filter.start(mode.pose, mode.covariance)
        self.belief.doubt()
        weight = mode.weight + (mode.twin_weight if self.ends.alike else 0.0)
        if weight >= SURE_WEIGHT and is_narrow(mode.covariance):
            self.has_pose = True
            self.belief.start_counting()

    def _is_slip(self, pose: Pose) -> bool:
        """Whether a jump to another pose is no farther than a robot slips."""
        return pose.is_near(self.pose, SLIP_M, SLIP_RAD)
