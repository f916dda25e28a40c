"""What is wrong with a robot's data: a code for programs, and a sentence for people."""

from dataclasses import dataclass


class ProblemCode:
    """Every code. The first word is what is at fault. A sentence may be reworded; its code stays."""

    # the robot's odometry contradicts images and gyro
    ODOMETRY_TURN_SIGN = "odometry-turn-sign"  # it turns the wrong way: theta has the wrong sign
    ODOMETRY_X_SIGN = "odometry-x-sign"  # it drives backwards: x has the wrong sign
    ODOMETRY_Y_SIGN = "odometry-y-sign"  # it drives to the wrong side: y has the wrong sign
    ODOMETRY_WAY_SIGN = "odometry-way-sign"  # it drives the wrong way: x and y have the wrong sign
    ODOMETRY_ALL_SIGNS = "odometry-all-signs"  # x, y and theta have the wrong sign
    ODOMETRY_SCALE = "odometry-scale"  # the way is too long or too short: wheels slip, or its scale is wrong
    ODOMETRY_TURN_SCALE = "odometry-turn-scale"  # turns are too large or too small
    ODOMETRY_DRIFT = "odometry-drift"  # its heading drifts
    ODOMETRY_FROZEN = "odometry-frozen"  # it stands still while the robot moves
    ODOMETRY_AGAINST_GYRO = "odometry-against-gyro"  # images and gyro agree, the odometry differs
    # the images, or what a detector found in them
    IMAGES_MIRRORED = "images-mirrored"  # left and right, or ahead and behind, are exchanged
    IMAGES_TURNED = "images-turned"  # the camera is turned on the robot
    IMAGES_SPIN = "images-spin"  # they turn while the robot does not: a head pans, or the camera is loose
    IMAGES_REPEAT = "images-repeat"  # the same image comes again and again while the robot moves
    IMAGES_AGAINST_ODOMETRY = "images-against-odometry"  # they contradict each other, and nothing explains it
    IMAGES_GREY = "images-grey"  # without colour
    # the stamps of the images
    STAMPS_LATE = "stamps-late"  # too late, and not corrected
    STAMPS_LATE_CORRECTED = "stamps-late-corrected"  # too late by a delay that is known and taken off
    STAMPS_EARLY = "stamps-early"  # too early, or the odometry comes late
    # camera.yaml, field.yaml, or the field that was chosen
    CAMERA_DIFFERS = "camera-differs"  # from camera.yaml, by more than that states
    CAMERA_MISSING = "camera-missing"  # an image came, and no camera model
    FIELD_OFF_LINES = "field-off-lines"  # much of what is seen lies on no line: clutter, another field, or camera.yaml
    FIELD_OFF_CARPET = "field-off-carpet"  # the pose lies where no robot stands
    # which end of the field the robot is at
    END_UNDECIDED = "end-undecided"  # nothing tells the ends apart; no sensor is at fault
    END_BY_COMPASS = "end-by-compass"  # above all the compass indicates the other end
    END_BY_COLOURS = "end-by-colours"  # likewise the colours of goals and poles
    END_BY_OTHERS = "end-by-others"  # likewise team mates, or another source of evidence
    # the compass, as nubot-mti and nubot-mcl judge it
    COMPASS_WRONG = "compass-wrong"  # it contradicts lines and odometry, or did as the robot was lost
    COMPASS_TURNED = "compass-turned"  # it turned round as the robot was moved: either end is possible
    # the pose, as nubot-mti and nubot-mcl judge it
    POSE_OFF_LINES = "pose-off-lines"  # the points lie far from the lines
    POSE_AMBIGUOUS = "pose-ambiguous"  # the points fit elsewhere as well
    POSE_OFF_FIELD = "pose-off-field"  # it lies where no robot stands
    POSE_OPEN = "pose-open"  # no line fixes it
    # what a `Localizer` is given and leaves out
    SAMPLE_UNUSABLE = "sample-unusable"  # a sensor's sample is no measurement
    SAMPLE_OLD = "sample-old"  # not newer than the one before
    SAMPLE_AHEAD = "sample-ahead"  # stamped far ahead of everything else
    STAMP_UNUSABLE = "stamp-unusable"  # no whole number of nanoseconds
    IMAGE_MISSING = "image-missing"  # neither image nor points were given
    IMAGE_SHAPE = "image-shape"  # not as the camera model has it
    IMAGE_OLD = "image-old"  # older than the one before
    IMAGE_FAR = "image-far"  # stamped far from the one before; left out unless the next one is there, too
    IMAGE_CLOCK = "image-clock"  # the clock was set back
    OBSERVATION_UNUSABLE = "observation-unusable"  # what a detector found, or a part of it, is no measurement
    EVIDENCE_UNUSABLE = "evidence-unusable"  # of other sources: invalid, or too many before the next image
    GAME_STATE_UNUSABLE = "game-state-unusable"  # an unknown game state
    CAMERA_POSE_UNUSABLE = "camera-pose-unusable"  # no pose
    LOCALIZATION_FAILED = "localization-failed"  # an error of the program; the system was started again
    # what `touchline check` alone finds
    SENSORS_DISAGREE = "sensors-disagree"  # sensors and field contradict each other, and nothing is identified
    TIME_UNIT = "time-unit"  # times are not in seconds
    ANGLE_UNIT = "angle-unit"  # angles are not in radians
    LENGTH_UNIT = "length-unit"  # lengths are not in metres


@dataclass(frozen=True, slots=True)
class Problem:
    """code: one of `ProblemCode`. sentence: what is wrong, with its numbers, for people."""

    code: str
    sentence: str

    def __str__(self) -> str:
        return self.sentence

    @property
    def at_fault(self) -> str:
        """What is: the first word of the code."""
        return self.code.partition("-")[0]
