"""The pictures of a report: some images with what was seen in them, and the field with belief and particles."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import cv2

from touchline.camera import Camera
from touchline.evaluation.report import Picture
from touchline.evaluation.runner import KeptFrame, RunTally, Thumbnail, robot_setup
from touchline.evaluation.tum import pose_text
from touchline.field import FieldModel
from touchline.messages import counted
from touchline.motion import LeanFilter
from touchline.perception.detector import observe
from touchline.sources import Recording
from touchline.systems import SYSTEMS, LocalizationSystem, open_system
from touchline.types import Estimate, Frame, ImageArray, Status
from touchline.view.belief import belief_of, belief_picture
from touchline.view.learned_view import as_learned
from touchline.view.overlay import overlay_image


def run_pictures(source: Recording, tally: RunTally, system: LocalizationSystem) -> Iterator[Picture]:
    """Two of each frame that was kept where the system has particles weighed by features, else one; drawn as they are
    taken, since all of them at once are 30 MB."""
    for kept in [] if tally.pictures is None else tally.pictures.kept():
        if kept.frame.image is not None:
            yield from _of_frame(source, kept, kept.frame.image, system)


def _of_frame(source: Recording, kept: KeptFrame, image: ImageArray, system: LocalizationSystem) -> list[Picture]:
    estimate = kept.estimate
    title = f"Image {kept.index} at {kept.frame.stamp_ns / 1e9:.2f} s"
    residual = "" if math.isnan(estimate.residual_m) else f", residual {100 * estimate.residual_m:.1f} cm"
    caption = f"{estimate.status.value}: {pose_text(estimate.pose)}{residual}"
    caption += f" ({kept.reason})" if kept.reason != "evenly chosen" else ""
    located = estimate.status is Status.TRACKING  # field lines at a guessed pose would mislead
    caption += "" if located else "; not located, so no field lines are drawn"
    field, (view, seen) = source.field if located else None, as_learned(source.camera, kept.frame, kept.lean, estimate)
    pictures = [Picture(title, caption, overlay_image(image, view, field, estimate.pose, seen))]
    belief = None if estimate.observation is None else belief_of(system, source.field, estimate.observation)
    if belief is None or kept.particles is None:
        return pictures
    title = f"The field at {kept.frame.stamp_ns / 1e9:.2f} s"
    caption = f"{counted(len(kept.particles), 'particle')}; discs: what this image alone says, larger where likelier"
    drawn = belief_picture(source.field, belief, kept.particles, estimate)
    return [*pictures, Picture(title, caption, drawn)]


_WIDTH_PX, _WIDE_PX, _JPEG_QUALITY = 320, 640, 70


def thumbnails(source: Recording, tally: RunTally) -> list[Thumbnail]:
    """Small pictures throughout a run: the image, what was seen, field lines where tracked."""
    found = []
    for kept in [] if tally.pictures is None else tally.pictures.small:
        frame = replace(kept.frame, image=source.image(kept.index))
        jpeg = thumbnail(source.camera, source.field, frame, kept.estimate, kept.lean)
        if jpeg is not None:
            found.append(Thumbnail(frame.stamp_ns, jpeg))
    return found


def looks(source: Recording, system: str) -> Callable[[Frame, Estimate], tuple[Estimate, bytes | None]]:
    """An estimate with what was seen in its image, by its own detector or the system's, and where to look next; and a
    picture of that image. Called frame by frame.
    """
    setup = robot_setup(source)
    opened = None if system not in SYSTEMS else open_system(system, setup)
    detector, gaze = getattr(opened, "detector", None), getattr(opened, "gaze", None)
    leaning = LeanFilter()

    def look(frame: Frame, estimate: Estimate) -> tuple[Estimate, bytes | None]:
        leaning.add(frame)
        shown = replace(estimate, observation=observe(frame, detector), gaze=gaze)
        if setup.camera is None:
            return shown, None
        lean = leaning.lean(frame.stamp_ns)
        return shown, thumbnail(setup.camera, source.field, frame, shown, lean, _WIDE_PX)

    return look


def thumbnail(
    camera: Camera,
    field: FieldModel | None,
    frame: Frame,
    estimate: Estimate,
    lean: tuple[float, float] | None,
    width_px: int = _WIDTH_PX,
) -> bytes | None:
    """A JPEG of an image, at most so wide, with what was seen, and field lines where tracked; None without an image."""
    if frame.image is None:
        return None
    shown = field if estimate.status is Status.TRACKING else None
    view, seen = as_learned(camera, frame, lean, estimate)
    drawn = overlay_image(frame.image, view, shown, estimate.pose, seen, 1)
    height, width = frame.image.shape[:2]
    scale = min(1.0, width_px / width)
    size = (max(1, round(scale * width)), max(1, round(scale * height)))
    small = cv2.resize(drawn[:height], size, interpolation=cv2.INTER_AREA)  # without the legend below
    done, code = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return code.tobytes() if done else None
