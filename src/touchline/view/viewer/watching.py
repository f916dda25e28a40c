"""A run of a recording, and a robot that runs, as the viewer shows them."""

import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from touchline.camera import Camera
from touchline.evaluation.metrics import associate
from touchline.field import FieldModel
from touchline.geometry import FloatArray, Pose
from touchline.published.iris_fusion.system import IrisFusion
from touchline.published.nimbro_lines.system import NimbroLines
from touchline.published.nubot_mcl.alone import NubotMclAlone
from touchline.published.nubot_mcl.system import NubotMcl
from touchline.sources import Recording
from touchline.sources.description import NO_CAMERA
from touchline.systems import LocalizationSystem
from touchline.types import Estimate, Frame, Status
from touchline.view.viewer.run_view import RunView, TrueAt

_WITH_PARTICLES = NimbroLines | IrisFusion | NubotMcl | NubotMclAlone
_COLOURS = """\
**Image**: blue points lie on a line of the field, orange ones do not; magenta are the field's lines at the pose found.

**Field**: path and robot in the colour of the status (blue tracking, orange searching, vermillion lost), with the 2σ
ellipse; black is the truth; purple are other hypotheses, green the particles.

**Errors** are shown where the robot is tracked; grey is ± 2σ as the system states it."""


def watch_robot(
    stream: Any, field: FieldModel, camera: Camera | None, system: LocalizationSystem, name: str
) -> RunView:
    """What shows a robot that runs, whose true pose nobody knows. camera: None where a detector of its own sees."""
    about = ["# Live", f"System **{name}**, field {field.name}.", _COLOURS]
    return RunView(
        stream, field, camera, particles=lambda estimate: particles_now(system, estimate), about="\n\n".join(about)
    )


def watch(stream: Any, source: Recording, system: LocalizationSystem, name: str) -> RunView:
    """What shows a system's run over a recording on a Rerun stream. name: the system's."""
    description = str(source.sequence.get("description", ""))
    about = [f"# {source.name}", description, f"System **{name}**, field {source.field.name}.", _COLOURS]
    camera = None if source.camera_kind == NO_CAMERA else source.camera
    return RunView(
        stream,
        source.field,
        camera,
        true_at=_truth_of(source),
        particles=lambda estimate: particles_now(system, estimate),
        about="\n\n".join(about),
    )


def particles_now(system: LocalizationSystem, estimate: Estimate) -> FloatArray | None:
    """(N, 4) a system's particles: x, y (m), heading (rad), weight; None where it has none, or follows without them."""
    if not isinstance(system, _WITH_PARTICLES):
        return None
    if isinstance(system, NubotMcl) and estimate.status is Status.TRACKING:
        return None
    particles = system.particles.particles
    return np.column_stack((particles.poses, particles.weights))


def _truth_of(source: Recording) -> TrueAt | None:
    """The true pose at the stamps of the images that have one."""
    truth = source.truth
    if truth is None:
        return None
    stamps = source.image_stamps
    known = dict(zip(stamps.tolist(), associate(stamps, truth.stamp_ns).tolist(), strict=True))

    def true_at(stamp_ns: int) -> Pose | None:
        index = known.get(stamp_ns, -1)
        return truth[index] if index >= 0 else None

    return true_at


class LatestShown:
    """Hands frames to what shows them. While it is busy with one, only the latest of those that come waits."""

    def __init__(self, show: Callable[[Frame, Estimate], None]) -> None:
        self._show = show
        self._waiting: tuple[Frame, Estimate] | None = None
        self._ended = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._work, name="show", daemon=True)
        self._thread.start()

    def take(self, frame: Frame, estimate: Estimate) -> None:
        """Show it as soon as there is time, unless another one comes before."""
        with self._changed:
            self._waiting = frame, estimate
            self._changed.notify()

    def close(self) -> None:
        """Show what waits, and end."""
        with self._changed:
            self._ended = True
            self._changed.notify()
        self._thread.join()

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._ended or self._waiting is not None)
                taken, self._waiting = self._waiting, None
            if taken is None:
                return
            self._show(*taken)
