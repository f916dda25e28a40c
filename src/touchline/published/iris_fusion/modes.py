"""Fusion of odometry and particle filter in three modes (Ismail et al. 2021, section II.D, equations 15 to 19).

Figure 11, the algorithm, is a picture that cannot be read; the rule here is designed from the text: competitive
fusion takes one of the two, complementary fusion both. docs/method.md states it.
"""

import math

import numpy as np
from pydantic import Field

from touchline.config import Settings, added
from touchline.geometry import FloatArray, Pose, deviation_m, deviation_rad, wrap_angle
from touchline.localization.registration.covariance import widest_m
from touchline.motion.driven import EXACT_SCALES, driven
from touchline.motion.odometry import Motion
from touchline.published.iris_fusion.image_doubt import ImageDoubt, shared_out
from touchline.published.particles.particle_set import ParticleEstimate
from touchline.types import Mode

_QUARTER_TURN = 0.5 * math.pi  # beyond it lines are mistaken for others


MAX_BIAS_RAD_S = 0.05  # largest bias that is learned: 3 degrees per second, several times the usual
ENOUGH_POINTS = 15  # line points from which an image is used again
MIN_POINTS = 10  # line points below which it no longer is: fewer fit anywhere
# how much less is asked of found_ratio after every search that ended without it, down to accepted_ratio: a poor
# calibration leaves more points beside the lines
DOUBT = 0.05
MIN_RATIO = 0.6  # share of points on lines below which it no longer is
NARROW_M = 0.15  # standard deviation of the particles below which an image is used again: 5 times usual
MAX_SPREAD_M = 0.25  # the same above which it no longer is: a lone line, two places
NARROW_RAD = 0.05  # as NARROW_M, of the headings
MAX_SPREAD_RAD = 0.08  # as MAX_SPREAD_M, of the headings
# distance of odometry and particles within which they agree, beside three standard deviations of the odometry since it
# was last corrected; never more than lost_m, beside what may have been driven while wheels and gyro said nothing
AGREEMENT_M = 0.1
AGREEMENT_RAD = 0.06  # the same of the heading; never more than TURNED_RAD
# difference of the headings from which an image contradicts the odometry, however unsure it is: far from the quarter
# turn at which lines can be mistaken
TURNED_RAD = 0.5
# images in a row that must contradict the odometry in one and the same way until the particles are believed alone, and
# that must agree until the odometry is believed again: 0.3 s after a slip
FRAMES = 3
# what an image with fewer points on lines than found_ratio, but accepted_ratio, counts where the robot has moved since
# the last one: five of them in a row, all in one way, say as much as FRAMES. Clutter about a right pose leaves 0.7 to
# 0.9; to a robot that stands a wrong one that leaves as much shows the same again and again
FEWER_ON_LINES = 0.6
MOVED_M, MOVED_RAD = 0.05, 0.05  # see FEWER_ON_LINES: a walking pace
NOTHING_NEW_RATIO = 0.5  # share of points on lines from which an image that is not good leaves the count as it was


class SensorFusionPaper(Settings):
    """Switches to the paper's exact form."""

    beta_period_s: float | None = added(
        0.1,
        paper=None,
        gt=0,
        description="time between corrections of the odometry (s) that β is meant for: after a longer one its share is "
        "β to the power of their ratio, since its errors have grown; none is the paper's constant",
    )
    camera_errors: bool = added(
        True,
        paper=False,
        description="learn from the lines how far the mirror is tilted and the ranges are too long, and take it off; "
        "false as in the paper, whose particles are off by what the calibration leaves",
    )
    displacement: bool = added(
        True,
        paper=False,
        description="of these errors, look for a displaced mirror, too; without it a mirror 0.3 mm off costs 4 cm",
    )
    bias_gain_per_s: float = added(
        0.2,
        paper=0.0,
        ge=0,
        description="how much of the difference of both headings corrects the gyro's bias (rad/s per rad), at which "
        "the odometry's heading runs away: settles within some seconds; 0 is the paper's form",
    )


class SensorFusionSettings(Settings):
    """The paper gives equations (15) to (19) and the three modes, no number.

    Of each pair of limits the stricter one lets an image be used, the looser one lets it go on: hysteresis.
    """

    beta: float = Field(
        0.5,
        ge=0,
        le=1,
        description="the odometry's share, β of equations (15) to (19): averages the particles' noise over some "
        "images, yet lets them correct what measuring wheels err by in them",
    )
    found_ratio: float = Field(
        0.85,
        ge=0,
        le=1,
        description="share of points on lines from which an image may contradict the odometry, or find a robot that "
        "has no pose yet: on a small field wrong poses come to 0.8",
    )
    accepted_ratio: float = Field(
        0.7,
        ge=0,
        le=1,
        description="share of points on lines from which an image that agrees is used again: a right pose has 0.9, "
        "robots and goals spoil some",
    )
    lost_m: float = Field(
        0.6,
        gt=0,
        description="standard deviation of the position (m) above which odometry alone is lost, and distance (m) from "
        "which an image contradicts it, however unsure it is: a shove, twice",
    )
    paper: SensorFusionPaper = SensorFusionPaper()


class SensorFusion:
    """`pose` [x_R y_R θ_R] and its `covariance` (3, 3) in (m, m, rad), field frame; `mode`.

    `bias_rad_s`: how fast the odometry's heading was seen to run away from the particles'.

    `covariance` is what the pose's error is expected to be, `bound` (3, 3) a bound of it that holds however the errors
    depend on each other: those of odometry do, from step to step, and the particles are moved by it. The bound alone
    judges what an image may contradict, and when the odometry is lost.
    """

    def __init__(self, settings: SensorFusionSettings | None = None) -> None:
        self.settings = settings or SensorFusionSettings()
        self.forget()

    def forget(self) -> None:
        """No pose is known."""
        self.pose = Pose(0.0, 0.0, 0.0)
        self.covariance: FloatArray = np.eye(3) * 100.0
        self.bound: FloatArray = self.covariance
        self.dispute: FloatArray = np.zeros(3)
        self.mode = Mode.ODOMETRY
        self.has_pose = False
        self.bias_rad_s = 0.0
        self._failed_searches = 0
        self._uncorrected_s = 0.0
        self._turned_by_gyro = True
        self._forget_images()

    def place(self, pose: Pose, covariance: FloatArray) -> None:
        """A start pose with its covariance (3, 3)."""
        self.pose, self.covariance, self.bound, self.has_pose = pose, covariance, covariance, True

    def search_anew(self, failed: int, displaced: bool) -> None:
        """The particles start anew over the field, after so many searches that failed.

        displaced: the pose known so far is at the wrong end of the field.
        """
        self._failed_searches = failed
        self.has_pose = self.has_pose and not displaced
        self._forget_images()

    def _forget_images(self) -> None:
        """Images have to follow each other anew."""
        self.agreeing = 0
        self.contradicting = 0.0
        self._unused = 0
        self._seen: Pose | None = None

    def update(
        self,
        odometry: Pose,
        motion: Motion,
        vision: ParticleEstimate | None,
        duration_s: float,
        by_gyro: bool = True,
        image: ImageDoubt | None = None,
    ) -> Mode:
        """Fuse one frame. odometry: [x_o y_o θ_o], corrected after the last frame; motion: since then, in duration_s.

        vision: None without usable points. by_gyro: whether the turn is the gyro's, all of it. image: how unsure the
        pose is that the particles say, camera included; none: as wide as the particles are spread.
        """
        self._spread_by(motion)
        self.dispute = np.zeros(3)
        self._uncorrected_s += duration_s
        self._turned_by_gyro &= by_gyro
        if vision is None or not self._is_good(vision):
            if vision is not None:
                self._pass_over(motion, vision)
            elif self._seen is not None:  # nothing was seen that speaks against the images before
                self._seen = self._seen.compose(motion.pose)
            self.mode, self.pose = Mode.ODOMETRY, odometry
            return self.mode
        fixed = image is None or widest_m(image.covariance) < NARROW_M
        self._compare(odometry, motion, vision, fixed)
        self.mode = self._next_mode(trusted=motion.missing_s == 0.0)
        self._unused = self._unused + 1 if self.mode is Mode.ODOMETRY else 0
        self._take(odometry, vision, image)
        return self.mode

    def _pass_over(self, motion: Motion, vision: ParticleEstimate) -> None:
        """An image that is not good. One with half its points on lines, where the last was, says nothing new."""
        unused = self._unused + (vision.inlier_ratio < MIN_RATIO)
        goes_on = vision.inlier_ratio >= NOTHING_NEW_RATIO and self._is_steady(motion, vision)
        contradicting, seen = self.contradicting, vision.pose
        self._forget_images()
        self._unused = unused
        if goes_on:
            self.contradicting, self._seen = contradicting, seen

    def _is_steady(self, motion: Motion, vision: ParticleEstimate) -> bool:
        """Whether an image shows the robot where it has come from what the last one showed."""
        expected = None if self._seen is None else self._seen.compose(motion.pose)
        blind_m, blind_rad = _unseen(motion)
        reach_rad = min(AGREEMENT_RAD + blind_rad, _QUARTER_TURN)
        return expected is not None and expected.is_near(vision.pose, AGREEMENT_M + blind_m, reach_rad)

    @property
    def lost(self) -> bool:
        """Whether the odometry has been alone for too long."""
        return deviation_m(self.bound) > self.settings.lost_m

    @property
    def doubtful(self) -> bool:
        """Whether images speak against the odometry, in one way or another, and none has agreed since."""
        return self._unused >= FRAMES

    @property
    def heading_deviation_rad(self) -> float:
        """Standard deviation of the pose's heading (rad)."""
        return deviation_rad(self.bound)

    @property
    def confirmed(self) -> bool:
        """Whether the last images agreed with the odometry, one after the other."""
        return self.agreeing >= FRAMES

    def _is_good(self, vision: ParticleEstimate) -> bool:
        """Whether an image may be used: enough points, most of them on lines, particles that agree."""
        s, used = self.settings, self.mode is not Mode.ODOMETRY
        if used:
            limits = (MIN_POINTS, MIN_RATIO, MAX_SPREAD_M, MAX_SPREAD_RAD)
        else:
            limits = (ENOUGH_POINTS, s.accepted_ratio, NARROW_M, NARROW_RAD)
        points, ratio, max_m, max_rad = limits
        agree = vision.deviation_m <= max_m and vision.deviation_rad <= max_rad
        return vision.points >= points and vision.inlier_ratio >= ratio and agree

    def _compare(self, odometry: Pose, motion: Motion, vision: ParticleEstimate, fixed: bool) -> None:
        """Count the images in a row that agree with the odometry, and those that contradict it in one way.

        fixed: whether the image's lines leave a pose at all; a lone line, where the particles agree by chance, does not
        contradict.
        """
        s = self.settings
        blind_m, blind_rad = _unseen(motion)
        reach_m = min(AGREEMENT_M + 3.0 * deviation_m(self.bound), s.lost_m + blind_m)
        reach_rad = min(AGREEMENT_RAD + 3.0 * deviation_rad(self.bound), TURNED_RAD + blind_rad, _QUARTER_TURN)
        agrees = self.has_pose and odometry.is_near(vision.pose, reach_m, reach_rad)
        steady = self._is_steady(motion, vision)
        self.agreeing = self.agreeing + 1 if agrees else 0
        if agrees or not fixed or vision.inlier_ratio < s.accepted_ratio:
            self.contradicting = 0.0
        else:
            found_ratio = max(s.found_ratio - DOUBT * self._failed_searches, s.accepted_ratio)
            moved = abs(motion.pose.heading) > MOVED_RAD or math.hypot(motion.pose.x, motion.pose.y) > MOVED_M
            says = 1.0 if vision.inlier_ratio >= found_ratio else FEWER_ON_LINES if moved else 0.0
            self.contradicting = self.contradicting + says if steady else says
        self._seen = vision.pose

    @property
    def moved(self) -> bool:
        """Whether the image that was used last showed a move that the odometry had not felt."""
        return self.agreeing <= 1 or math.hypot(*self.dispute[:2]) > 0.5 * AGREEMENT_M

    @property
    def believed_covariance(self) -> FloatArray:
        """(3, 3) of the pose, with what odometry and image differ by: whichever of both is wrong."""
        return self.covariance + shared_out(self.dispute)

    def _next_mode(self, trusted: bool) -> Mode:
        """The mode for an image that may be used; trusted: the odometry has not missed anything."""
        alone = self.mode is Mode.OMNIVISION
        if not self.agreeing:
            return Mode.OMNIVISION if self.contradicting >= FRAMES else Mode.ODOMETRY
        if not trusted or (alone and self.agreeing < FRAMES):
            return Mode.OMNIVISION
        return Mode.BOTH

    def _take(self, odometry: Pose, vision: ParticleEstimate, image: ImageDoubt | None) -> None:
        """Equations (15) to (19), or one of the two alone."""
        self.dispute = vision.pose.minus(odometry)
        if self.mode is Mode.ODOMETRY:
            self.pose = odometry
            return
        self.has_pose, self._failed_searches = True, 0
        s = self.settings
        if self.mode is Mode.BOTH and self._turned_by_gyro:
            self._learn_bias(odometry, vision.pose)
        beta = s.beta if self.mode is Mode.BOTH else 0.0
        if s.paper.beta_period_s is not None:
            beta **= max(self._uncorrected_s / s.paper.beta_period_s, 1.0)
        self.pose = blended(odometry, vision.pose, beta)
        said = vision.covariance if image is None else image.covariance
        if image is not None and self.mode is Mode.BOTH:
            said = image.after(self.covariance, self.bound)
        self.bound = beta * self.bound + (1.0 - beta) * vision.covariance
        self.covariance = beta * self.covariance + (1.0 - beta) * said
        self.dispute *= math.sqrt(beta * (1.0 - beta))
        self._uncorrected_s, self._turned_by_gyro = 0.0, True

    def _learn_bias(self, odometry: Pose, particles: Pose) -> None:
        s = self.settings
        gain = min(s.paper.bias_gain_per_s, 0.5 / max(self._uncorrected_s, 1e-3))
        learned = self.bias_rad_s - gain * wrap_angle(particles.heading - odometry.heading)
        self.bias_rad_s = min(max(learned, -MAX_BIAS_RAD_S), MAX_BIAS_RAD_S)

    def _spread_by(self, motion: Motion) -> None:
        """The odometry's errors add up: the covariance of a sum is at most (1 + a) P + (1 + 1/a) Q, for any a > 0.

        From one image to the next they are new; while it goes on alone they are the same errors again and again.
        """
        self.bound = self._moved(self.bound, motion, dependent=True)
        self.covariance = self._moved(self.covariance, motion, dependent=self.mode is Mode.ODOMETRY)

    def _moved(self, covariance: FloatArray, motion: Motion, dependent: bool) -> FloatArray:
        """A covariance (3, 3) of the pose after a motion."""
        step = driven(self.pose, EXACT_SCALES, motion.pose)
        p, q = step.by_pose @ covariance @ step.by_pose.T, step.by_motion @ motion.covariance @ step.by_motion.T
        if not (dependent and p.any() and q.any()):
            return p + q
        a = math.sqrt(np.trace(q) / np.trace(p))
        return (1.0 + a) * p + (1.0 + 1.0 / a) * q


def blended(odometry: Pose, particles: Pose, beta: float) -> Pose:
    """Equations (15) to (19): β of the odometry and 1 - β of the particles; f of equation (13) is the arc tangent."""
    sine = beta * math.sin(odometry.heading) + (1.0 - beta) * math.sin(particles.heading)
    cosine = beta * math.cos(odometry.heading) + (1.0 - beta) * math.cos(particles.heading)
    return Pose(
        beta * odometry.x + (1.0 - beta) * particles.x,
        beta * odometry.y + (1.0 - beta) * particles.y,
        wrap_angle(math.atan2(sine, cosine)),
    )


def _unseen(motion: Motion) -> tuple[float, float]:
    """What may have been driven (m) and turned (rad) while nothing was felt."""
    if not motion.missing_s:
        return 0.0, 0.0
    return 3.0 * deviation_m(motion.covariance), 3.0 * deviation_rad(motion.covariance)
