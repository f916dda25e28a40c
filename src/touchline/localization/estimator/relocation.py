"""What moves a robot unseen, until images show where it stands: the referee's penalties, pick-ups, falls, restarts."""

from collections.abc import Sequence

from touchline.field import FieldModel
from touchline.localization.estimator.bank import Bank, Member
from touchline.localization.estimator.believed import Believed
from touchline.localization.estimator.field_end import FieldEnd
from touchline.localization.estimator.game_states import Referee
from touchline.localization.estimator.whereabouts import FALL, LYING, Posture, Whereabouts, joined
from touchline.localization.search.pose_search import Mode
from touchline.motion.delayed import Delayed
from touchline.types import Frame, Prior

# of a prediction (m, m, rad) from which registration may take other lines for those seen: seconds unseen, no odometry
LOST_M2, LOST_RAD2 = 0.36, 1.0
OPEN_LOG_ODDS = 1.0  # of an end that is likelier and open
OUTSIDE_M = 1.0  # by so much the area where a robot may stand is longer and wider than the field


class Relocation:
    """`whereabouts`: where the robot may stand since something moved it unseen; None: nothing has, or it was found."""

    def __init__(self, field: FieldModel) -> None:
        self._area_m2 = (field.length + OUTSIDE_M) * (field.width + OUTSIDE_M)
        self._referee, self._posture = Referee(field), Posture()
        self.reset()

    def reset(self) -> None:
        """Nothing has happened."""
        self._referee.reset()
        self._posture.reset()
        self.whereabouts: Whereabouts | None = None
        self.end_was_open = False  # before it

    @property
    def refereed(self) -> bool:
        """Whether a referee says what happens to the robot."""
        return self._referee.speaks

    @property
    def lies(self) -> bool:
        """Whether the robot lies: what it sees and measures then is not believed."""
        return self._posture.lies

    def events(self, frame: Frame) -> list[Prior]:
        """What the referee says and the body feels, as priors that join what is believed, in their order."""
        priors = [prior for said in frame.game for prior in self._referee.update(said)]
        self._posture.update(frame.stamp_ns, None if frame.tilt is None else frame.tilt.values)
        return [*priors, FALL] if self._posture.fell else priors

    def join(self, bank: Bank, end: FieldEnd, prior: Prior) -> None:
        """Take what has happened to the robot: it may stand elsewhere by now."""
        if self.whereabouts is None:
            self.end_was_open = bool(bank.members) and end.is_open and not end.undecided
        self.whereabouts = joined(bank, end.probability, self.whereabouts, prior, self._area_m2)

    def loses(self, bank: Bank) -> bool:
        """Whether the pose that was followed is predicted too widely for images to be registered from it."""
        if self.whereabouts is not None or not bank.confirmed or bank.best is None:
            return False
        (x, _, _), (_, y, _), (_, _, heading) = bank.best.filter.covariance.tolist()
        return bool(max(x, y) > LOST_M2 or heading > LOST_RAD2)

    def lie(self, seconds: float) -> None:
        """It lies for so long, and may be moved."""
        if self.whereabouts is not None:
            self.whereabouts.loosen(seconds * LYING)

    def predict(self, moved: Delayed, seconds: float, bank: Bank) -> None:
        """Propagate by the odometry, with the noise of the bank's steps."""
        if self.whereabouts is not None:
            self.whereabouts.predict(moved, seconds, bank.steps.of(moved.motion))

    def weigh(self, modes: Sequence[Mode], bank: Bank, carried_log_odds: float) -> list[float]:
        """Log-odds that the robot was moved unfelt to poses that were found; else as usual."""
        if self.whereabouts is None:
            return len(modes) * [carried_log_odds]
        return self.whereabouts.gains(modes, bank.best)

    def end_log_odds(self, bank: Bank, followed: Member | None) -> float | None:
        """Of the likeliest pose, against its twin; None: nothing new. followed: what was, before the image. Without
        odometry the way since tells nothing of the end, and on wheels, which are fast, a pose that takes the place of
        another leaves it open.
        """
        best = bank.best
        if self.whereabouts is None or best is None:
            return None
        if bank.guessed and best is followed:
            return None
        log_odds = self.whereabouts.log_odds(best.filter.pose)
        if not bank.guessed or not bank.trust.free_fit or followed is None or self.whereabouts.is_fresh:
            return log_odds
        return min(max(log_odds, -OPEN_LOG_ODDS), OPEN_LOG_ODDS)

    def settle(self, bank: Bank, shown: bool, tracked: bool) -> None:
        """Take what an image made of the likeliest pose. shown: whether it showed anything."""
        where = self.whereabouts
        if where is not None and shown and where.settles(bank.best, tracked and not self._referee.penalty):
            self.whereabouts = None

    def instead_of(self, found: Believed) -> Believed:
        """The likeliest of where it may stand, for a bank that follows nothing."""
        best = None if self.whereabouts is None else self.whereabouts.best
        return found if best is None else found._replace(pose=best.pose, covariance=best.covariance)

    def reason(self, end_undecided: bool) -> str:
        """Why images have not confirmed yet where the robot stands."""
        if self.lies:
            return "the robot lies"
        if self._referee.penalty:
            return f"penalised: {self._referee.penalty}"
        if self.whereabouts is None:
            return ""
        return "which end of the field is open" if end_undecided else "moved: not yet confirmed by images"
