"""`touchline compile`: the compiled loops of all systems, made ahead of the first match."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from touchline.cli.console import errors_console, on_compiling, say
from touchline.cli.options import WorkerCount
from touchline.messages import counted
from touchline.packed_loops import packed_loops_taken, take_packed_loops
from touchline.plugins import entry_points_of, load

if TYPE_CHECKING:
    from touchline.camera import PinholeCamera
    from touchline.field import FieldModel
    from touchline.geometry import FloatArray, Pose
    from touchline.types import ImageArray


def compile_loops(
    everything: Annotated[
        bool, typer.Option("--all", help="Those of the calibrations and of other packages, too: a minute more.")
    ] = False,
    workers: WorkerCount = None,
) -> None:
    """Compile the inner loops of every system once, so that no later start waits for it; for installers and images.

    What is there already is not compiled again, nor what the wheel touchline-kernels brings.
    """
    from touchline.camera import OmniCamera, PerspectiveCamera
    from touchline.systems import SYSTEMS

    steps: list[tuple[str, Callable[[], None]]] = []
    for name, info in SYSTEMS.items():
        examples = [(OmniCamera, _run_example), (PerspectiveCamera, _walk_example)]
        wanted = [example for kind, example in examples if kind in info.cameras]
        wanted += [_carried_example] if OmniCamera in info.cameras else []
        steps += [(name, partial(_each, wanted, name))]
    steps += [
        ("odometry that fails, a body that sways, late images, the papers' form", _fault_example),
        ("locate", _locate_example),
        ("check", _check_example),
    ]
    if everything:
        steps += [("calibrations", _calibrate_example)]
        others = entry_points_of("touchline.loops").items()
        steps += [(name, example) for name, entry in others if (example := load(entry)) is not None]
    compiled = _compiled_side_by_side(workers)
    for number, (name, example) in enumerate(steps, 1):
        started = time.perf_counter()
        with _compiled() as names:
            example()
        compiled += len(names)
        what = f"{counted(len(names), 'loop')} compiled" if names else "nothing to compile"
        say(f"{number} of {len(steps)}, {name}: ready after {time.perf_counter() - started:.1f} s, {what}")
    if packed := take_packed_loops():
        say(packed)
    taken = packed_loops_taken()
    ready = f"ready: {taken} from the wheel, {compiled or 'none'} compiled" if taken else "compiled"
    kept = "; code compiled here is kept beside the package, or in NUMBA_CACHE_DIR if that is set"
    say(f"all loops are {ready}{kept if compiled or not taken else ''}")


def _compiled_side_by_side(workers: int | None) -> int:
    """How many loops the largest examples have compiled, each in a process of its own; what is left comes in order."""
    from touchline.evaluation.workers import open_workers

    with open_workers(workers) as processes:
        if processes.count == 1:
            return 0
        say(f"compiling in {min(processes.count, len(_LARGEST))} processes")
        return sum(processes.map(_compiled_by, list(_LARGEST)))


def _compiled_by(name: str) -> int:
    with _compiled() as names:
        _LARGEST[name]("touchline")
    return len(names)


def _each(examples: Sequence[Callable[[str], None]], system: str) -> None:
    for example in examples:
        example(system)


@contextmanager
def _compiled() -> Iterator[set[str]]:
    """Names of the loops that are compiled meanwhile, each with its types; a bar on a terminal says so."""
    from rich.status import Status

    names: set[str] = set()
    console = errors_console()
    status = Status("", console=console)

    def tell(begun: Any) -> None:
        function = begun["dispatcher"].py_func
        if function.__module__.startswith("touchline"):  # and not a part of Numba's own
            names.add(f"{function.__module__}.{function.__qualname__}{begun['args']}")
            status.update(f"{len(names)}: compiling {function.__qualname__}")

    with on_compiling(tell), status if console.is_terminal else nullcontext():
        yield names


def _run_example(system: str) -> None:
    """The bundled recording, searched from nowhere and tracked; then points without an image. One report for all."""
    import numpy as np

    from touchline.api import prepare
    from touchline.cli.run import example_recording
    from touchline.evaluation.run_folder import new_folder
    from touchline.localizer import Localizer
    from touchline.systems import DEFAULT_SYSTEM
    from touchline.types import points_at

    prepared = prepare(example_recording(), system)
    if system == DEFAULT_SYSTEM:
        with tempfile.TemporaryDirectory() as folder:
            prepared.execute(new_folder(Path(folder) / "run", system))
    else:
        for frame in prepared.source:
            prepared.system.step(frame)
    robot = Localizer("msl-18x12", system=system)
    for k in range(3):
        robot.add_odometry(k * 100_000_000, 0.0, 0.0, 0.0)
        robot.localize(k * 100_000_000, points=points_at(np.ascontiguousarray(_view())))
        robot.localize(k * 100_000_000 + 1, points=_view())


def _carried_example(system: str) -> None:
    """The bundled recording, whose robot is carried elsewhere and then shown half of what is there; where to look."""
    import numpy as np

    from touchline.api import prepare
    from touchline.cli.run import example_recording
    from touchline.types import Observation, points_at

    stepped, view = prepare(example_recording(), system), _view()
    frames = [*stepped.source][:16]
    some = np.where((np.arange(len(view)) % 2 == 0)[:, np.newaxis], view, view[:, ::-1])  # every other one on no line
    for k, frame in enumerate(frames):
        seen = None if k < 8 else Observation(frame.stamp_ns, points_at(view if k < 12 else some))
        estimate = stepped.system.step(replace(frame, observation=seen))
        _ = estimate.look


def _walk_example(system: str) -> None:
    """A humanoid that walks towards a coloured goal, and what its detector finds in drawn images; then a white goal, in
    a hall where colours do not tell paint.
    """
    import numpy as np

    from touchline.camera import PinholeCamera
    from touchline.field import open_field
    from touchline.geometry import Pose, Pose3
    from touchline.localizer import Localizer
    from touchline.perception import LineGraphDetector, LineGraphSettings
    from touchline.types import Frame, LinePoints

    field = open_field("indoor-9x6")
    mount = Pose3.from_roll_pitch_yaw(0.0, 0.35, 0.0, (0.0, 0.0, 1.1))
    camera = PinholeCamera(640, 480, 420.0, 420.0, 319.5, 239.5, np.zeros(5), mount, use_attitude=False)
    detector = LineGraphDetector(camera, LineGraphSettings(), field)
    robot = Localizer(field, system=system)
    for k in range(10):
        stamp_ns, pose = k * 100_000_000, Pose(-1.2 + 0.1 * k, 0.3, 0.3)
        seen = detector.observe(Frame(stamp_ns, image=drawn_image(field, camera, pose)))
        robot.add_odometry(stamp_ns, pose.x, pose.y, pose.heading)
        # without its points, which would be a mirror's where nobody tells of the camera
        robot.localize(stamp_ns, observation=replace(seen, points=LinePoints.none()))
    white = open_field("humanoid-kid-9x6")
    image = drawn_image(white, camera, Pose(1.5, 0.3, 0.0))
    detector = LineGraphDetector(camera, LineGraphSettings(), white)
    for stamp_ns in range(2):
        detector.observe(Frame(stamp_ns, image=image))
        assert detector.classes is not None
        detector.colours.classes = detector.classes._replace(least_contrast=0.2)


def drawn_image(field: FieldModel, camera: PinholeCamera, pose: Pose) -> ImageArray:
    """An image of carpet, and of the lines and posts before a robot."""
    import cv2
    import numpy as np

    image = np.full((camera.height, camera.width, 3), (60, 140, 50), np.uint8)
    colors = {"yellow": (20, 200, 230), "blue": (190, 80, 40)}
    seen = pose.inverse()
    shapes: list[tuple[FloatArray, tuple[int, int, int]]] = []
    for line in field.polylines(0.1):
        along = np.diff(line, axis=0)
        aside = 0.5 * field.line_width * np.column_stack((-along[:, 1], along[:, 0])) / np.hypot(*along.T)[:, None]
        corners = np.stack((line[:-1] - aside, line[1:] - aside, line[1:] + aside, line[:-1] + aside), axis=1)
        shapes += [(np.column_stack((seen.transform(four), np.zeros(4))), (235, 235, 235)) for four in corners]
    for post in field.posts:
        x, y = seen.transform(np.array([[post.x, post.y]]))[0]
        at = np.linspace(0.0, post.height, len(post.colors_from_ground) + 1)
        for low, high, color in zip(at[:-1], at[1:], post.colors_from_ground, strict=True):
            half = 0.5 * post.diameter
            four = np.array([[x, y - half, low], [x, y + half, low], [x, y + half, high], [x, y - half, high]])
            shapes.append((four, colors.get(color, (235, 235, 235))))
    for shape, paint in shapes:
        pixels = camera.image_from_base(shape)
        if np.isfinite(pixels).all() and np.abs(pixels).max() < 5000.0:
            cv2.fillConvexPoly(image, np.round(16.0 * pixels).astype(np.int32), paint, cv2.LINE_AA, 4)
    return image


def _fault_example() -> None:
    """What is asked where images and odometry tell other motions, which stands still here, where a robot sways, where
    images are stamped late, and of a mirror in the papers' exact form.
    """
    import numpy as np

    from touchline.cli.run import example_recording
    from touchline.localization.estimator.motion_relation import MotionRelation
    from touchline.localization.estimator.sway_delay import SwayDelay
    from touchline.localization.estimator.visual_motion import Sighting
    from touchline.motion import LeanFilter, MotionHistory
    from touchline.motion.delayed import until_stamp
    from touchline.sources import open_source
    from touchline.types import Frame, Samples

    history, relation = MotionHistory(), MotionRelation()
    for k in range(20):
        stamp_ns = k * 100_000_000
        history.add(Frame(stamp_ns, odometry=Samples(np.array([stamp_ns]), np.zeros((1, 3)))))
        seen = Sighting(stamp_ns, np.array([0.2 * k, 0.0, 0.0]), 1e-6 * np.eye(3), 1.0, 0.0, begun=k == 0)
        relation.update(seen, history, 0.0, jumped=False)
    SwayDelay().update(np.zeros(2), LeanFilter(), 0, 0.0)
    until_stamp(history, stamp_ns, 0.1)
    camera = open_source(example_recording()).camera
    assert camera is not None
    camera.ground_from_image([(300.0, 240.0)])


def _locate_example() -> None:
    from touchline.field import open_field
    from touchline.localization.one_shot.locate import locate_points

    locate_points(_view(), open_field("msl-18x12"))


def _check_example() -> None:
    from touchline.checks.check import check_recording
    from touchline.cli.run import example_recording
    from touchline.sources import open_source

    check_recording(open_source(example_recording()))


def _view() -> FloatArray:
    """Points (N, 2) of the lines within 5 m of a robot, robot frame."""
    import numpy as np

    from touchline.field import open_field
    from touchline.geometry import Pose

    lines = np.vstack(list(open_field("msl-18x12").polylines(0.1)))
    seen = Pose(2.0, 1.0, 0.3).inverse().transform(lines)
    return np.ascontiguousarray(seen[np.hypot(*seen.T) < 5.0])


def _calibrate_example() -> None:
    """A mirror from the lines in an image of the bundled recording, as far as it tells it."""
    from touchline.calibration.lines.images import calibrate_images
    from touchline.cli.run import example_recording
    from touchline.errors import TouchlineError
    from touchline.field import open_field
    from touchline.sources import open_source

    image = next(frame.image for frame in open_source(example_recording()) if frame.image is not None)
    with suppress(TouchlineError):
        calibrate_images([image], open_field("msl-18x12"))


_LARGEST: dict[str, Callable[[str], None]] = {"mirror": _run_example, "humanoid": _walk_example}
