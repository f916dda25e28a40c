"""photographs: what is found in public photographs of real fields, one by one, and what `locate` says of each.

No figure of a paper. Mirrors of two MSL teams, a humanoid on an SPL field with three labelled lines a picture, and
frames of humanoid competitions, which nobody calibrated. Overlays go to the run's folder.
"""

import csv
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from touchline.camera import Camera, GroundView, OmniCamera, PinholeCamera, open_camera
from touchline.errors import NoFitError
from touchline.field import FieldModel, open_field
from touchline.files.images import read_image
from touchline.files.opened import read_text
from touchline.geometry import FloatArray, Pose, Pose3, wrap_angle
from touchline.localization.one_shot.locate import locate, locate_points
from touchline.perception.detectors import detector_for
from touchline.types import Frame, ImageArray, Observation
from touchline.view.learned_view import seen_through
from touchline.view.overlay import overlay_image
from touchline_lab.experiments.harness import NONE, ExperimentResult, Headline, Row, follow, rate
from touchline_lab.experiments.scenes import DATA_VARIABLE, image_figure, public_data

LABELS = ("border_line", "goal_box_line", "connecting_line")
RIGHT_M, RIGHT_RAD, WRONG_M = 0.15, math.radians(4.0), 0.25
_MAX_BYTES = 1_000_000  # of a table
_NEAR_PX = 8.0  # of both ends of a labelled line, and of a mark
# Pitch and height (m) of cameras that nobody calibrated: a robot's, by its horizon; the one on a stand, by its circle.
_NOMINAL = {"frame": (0.2, 0.8), "circle": (0.45, 1.05)}
_NOMINAL_FOCAL = 0.8  # of an image's width
_LABEL_PX = 0.9  # error of SPL's labels, as all of them together miss the field's lines
KNOWN_M = 0.05  # standard deviation up to which a reference judges
COLUMNS = (
    "photograph", "licence", "marked lines found", "line points", "`locate`", "off (cm)", "off (°)", "reference ± (cm)",
)  # fmt: skip


@dataclass(frozen=True, eq=False, slots=True)
class Photograph:
    """lines (N, 2, 2), marks (M, 2): pixels of labelled lines and points on lines; pose: of a reference, either end;
    reference_m: its standard deviation, NaN where nobody knows.
    """

    name: str
    licence: str
    image: ImageArray
    camera: Camera
    field: FieldModel
    lines: FloatArray
    marks: FloatArray
    pose: Pose | None
    calibrated: bool = True
    reference_m: float = math.nan


@dataclass(frozen=True, eq=False, slots=True)
class Seen:
    """found, marked: of what people marked. said: right, doubted, close, wrong, refused, open where it is not right
    by a reference that can't tell; empty without one.
    """

    photograph: Photograph
    observation: Observation
    found: int
    marked: int
    said: str
    off_m: float
    off_rad: float
    overlay: ImageArray


def photographs(seeds: int) -> ExperimentResult:
    """Every photograph that is there. seeds: of nothing."""
    del seeds
    seen, missing = list[Seen](), list[str]()
    for name, read in follow(list(GROUPS.items()), "groups of photographs"):
        folder = public_data(f"real/{name}")
        if folder is None:
            missing.append(name)
        else:
            seen += [look_at(one) for one in read(folder)]
    known = [one for one in seen if one.said == "refused" or not one.photograph.reference_m > KNOWN_M]
    judged = [one.said for one in known if one.said]
    notes = [_NOTE, *(f"{', '.join(missing)} not found; {DATA_VARIABLE} names the folder." for _ in missing[:1])]
    lines = [one for one in seen if len(one.photograph.lines)]
    found = sum(one.found for one in lines), sum(one.marked for one in lines)
    right = sum(said.startswith("right") for said in judged)
    ours = f"{rate(right, len(judged))}; {judged.count('wrong')}; {judged.count('refused')}; {rate(*found)}"
    free = [one.overlay for one in seen if "GPL" not in one.photograph.licence and one.said]
    return ExperimentResult(
        "What is found in photographs of real fields, and what `locate` says of each",
        COLUMNS,
        [_row(one) for one in seen],
        Headline(
            "`locate` within 15 cm and 4° of a reference known to 5 cm; wrong and sure; refused; labelled lines found",
            NONE,
            ours,
        ),
        notes,
        (("overlays", image_figure(free, (7.2, 3.0))[0]),) if free else (),
        overlays=[(one.photograph.name, one.overlay) for one in seen],
        seeds=1,
    )


def look_at(one: Photograph) -> Seen:
    """What is found in a photograph that is seen for the first time."""
    detector = detector_for(one.camera, one.field)
    assert detector is not None
    mount = one.camera.base_from_camera if isinstance(one.camera, PinholeCamera) else None
    observation = detector.observe(Frame(0, image=one.image, base_from_camera=mount))
    found, marked = _found(one, observation)
    said, off_m, off_rad, pose, view = "", math.nan, math.nan, None, GroundView(one.camera)
    shown = observation
    if one.calibrated:
        try:
            location = locate(observation, one.field, camera=one.camera)
        except NoFitError:
            said = "refused"
        else:
            pose, errors = location.pose, location.camera_errors
            if errors is not None and isinstance(one.camera, PinholeCamera):
                view = GroundView(one.camera.corrected(errors, np.linspace(0.05, 0.5, 10)))
                shown = seen_through(observation, GroundView(one.camera), view)
            said, off_m, off_rad = _said(pose, one.pose, bool(location.doubts))
            if one.reference_m > KNOWN_M and not said.startswith("right"):
                said = "open"
    overlay = overlay_image(one.image, view, one.field, pose, shown)
    return Seen(one, observation, found, marked, said if one.pose is not None else "", off_m, off_rad, overlay)


def _said(pose: Pose, reference: Pose | None, doubted: bool) -> tuple[str, float, float]:
    if reference is None:
        return "", math.nan, math.nan
    ends = ((pose.distance_to(end), abs(wrap_angle(pose.heading - end.heading)))
            for end in (reference, reference.mirrored()))  # fmt: skip
    off_m, off_rad = min(ends)
    if off_m < RIGHT_M and off_rad < RIGHT_RAD:
        return "right, doubted" if doubted else "right", off_m, off_rad
    if doubted:
        return "doubted", off_m, off_rad
    return ("wrong" if off_m > WRONG_M or off_rad > RIGHT_RAD else "close"), off_m, off_rad


def _found(one: Photograph, seen: Observation) -> tuple[int, int]:
    """How many of the labelled lines, or of the marks, were found, and how many there are."""
    if len(one.lines):
        off = [[float(aside(ends, line).max()) for line in seen.lines.pixels] or [math.inf] for ends in one.lines]
        return sum(min(each) <= _NEAR_PX for each in off), len(one.lines)
    if not len(one.marks) or not len(seen.points):
        return 0, len(one.marks)
    offsets = one.marks[:, np.newaxis] - seen.points.pixels
    return int(np.count_nonzero(np.hypot(*np.moveaxis(offsets, -1, 0)).min(axis=1) <= _NEAR_PX)), len(one.marks)


def aside(points: FloatArray, line: FloatArray) -> FloatArray:
    """Distances (N,) of points (N, 2) from the straight line through both ends (2, 2)."""
    along = (line[1] - line[0]) / np.hypot(*(line[1] - line[0]))
    offset = points - line[0]
    return np.abs(offset[:, 0] * along[1] - offset[:, 1] * along[0])


def _row(one: Seen) -> Row:
    found = f"{one.found} of {one.marked}" if one.marked else NONE
    off = (f"{100.0 * one.off_m:.1f}", f"{math.degrees(one.off_rad):.1f}") if math.isfinite(one.off_m) else (NONE, NONE)
    photograph = one.photograph
    known = f"{100.0 * photograph.reference_m:.1f}" if math.isfinite(photograph.reference_m) else NONE
    return (photograph.name, photograph.licence, found, str(len(one.observation.points)), one.said or NONE, *off, known)


_NO_LINES, _NO_MARKS = np.zeros((0, 2, 2)), np.zeros((0, 2))


def spl_photographs(folder: Path) -> Iterator[Photograph]:
    """Three labelled lines each; the pose is that at which they lie on the field's, roll and pitch free."""
    spl = open_field("spl-9x6")
    for path in sorted(folder.glob("*.jpg")):
        known = json.loads(read_text(path.with_suffix(".json"), _MAX_BYTES))
        lines = np.array([[known["labels_px"][f"{name}_{k}"] for k in (0, 1)] for name in LABELS])
        camera = camera_of(known)
        pose, reference_m = pose_of_labels(camera, spl, lines.reshape(-1, 2)) or (None, math.nan)
        yield Photograph(
            path.stem, "GPL-3", read_image(path), camera, spl, lines, _NO_MARKS, pose, reference_m=reference_m
        )


def camera_of(known: Mapping[str, Any]) -> PinholeCamera:
    """The camera that a photograph's JSON describes."""
    from scipy.spatial.transform import Rotation

    mount = known["camera_to_ground"]
    pose = Pose3(Rotation.from_quat(mount["rotation"]).as_matrix(), np.array(mount["translation"]))
    (fx, fy), (cx, cy) = known["focal_length_px"], known["optical_center_px"]
    return PinholeCamera(640, 480, fx, fy, cx, cy, np.zeros(5), pose)


def pose_of_labels(camera: PinholeCamera, spl: FieldModel, labels: FloatArray) -> tuple[Pose, float] | None:
    """The pose at which the ends (6, 2) of border, goal box and what connects them, in pixels, lie on the field's
    lines, the camera's roll and pitch fitted, too, and how far it errs as labels do (m); None if they miss by 5 cm.
    """
    from scipy.optimize import least_squares

    goal_x = float(np.abs(spl.segments[:, 0]).max())
    boxes = [s for s in np.abs(spl.segments) if abs(s[1] - s[3]) < 1e-6 and max(s[0], s[2]) > goal_x - 0.05]
    front_x, side_y = max((min(s[0], s[2]), s[1]) for s in boxes if 1.0 < min(s[0], s[2]) < goal_x - 1e-3)

    def on_field(state: FloatArray, labels: FloatArray = labels) -> FloatArray:
        leaning = Pose3.from_roll_pitch_yaw(float(state[3]), float(state[4]), 0.0)
        leant = replace(camera, base_from_camera=leaning.compose(camera.base_from_camera))
        return Pose(*state[:3].tolist()).transform(GroundView(leant).ground_from_image(labels))

    found = []
    for side in (1.0, -1.0):
        lines = np.array([goal_x, goal_x, front_x, front_x, side * side_y, side * side_y])

        def off(state: FloatArray, lines: FloatArray = lines, labels: FloatArray = labels) -> FloatArray:
            placed = on_field(state, labels)
            across = np.concatenate((placed[:4, 0], placed[4:, 1])) - lines
            return np.nan_to_num(np.concatenate((across / 0.02, state[3:] / math.radians(3.0))), nan=1e3)

        for turned in (0.5 * math.pi, -0.5 * math.pi):
            ground = GroundView(camera).ground_from_image(labels)
            along = ground[1] - ground[0]
            heading = turned - math.atan2(along[1], along[0])
            seen = Pose(0.0, 0.0, heading).transform(ground)
            start = np.array([goal_x - seen[:2, 0].mean(), lines[4] - seen[4:, 1].mean(), heading, 0.0, 0.0])
            fit = least_squares(off, start)
            placed = on_field(fit.x)
            inside = side * placed[2:4, 1].mean() < side_y  # the front lies between both sides
            if start[0] < goal_x and inside and np.abs(fit.fun[:6]).max() * 0.02 < 0.05:
                found.append((fit, off))
    if not found:
        return None
    fit, off = min(found, key=lambda one: float(one[0].cost))
    usual, steps = off(fit.x), _LABEL_PX * np.eye(labels.size).reshape(-1, *labels.shape)
    moved = np.array([off(fit.x, labels=labels + step) - usual for step in steps])
    covariance = moved.T @ moved + np.diag([*np.zeros(6), 1.0, 1.0])  # and the camera's roll and pitch by themselves
    errors = np.linalg.inv(fit.jac.T @ np.linalg.solve(covariance, fit.jac))
    return Pose(*fit.x[:3].tolist()), math.sqrt(errors[0, 0] + errors[1, 1])


def _mirrors(folder: Path) -> Iterator[Photograph]:
    """Marked points on lines; the camera of a, scaled, serves b and c. The pose is that of the marks."""
    camera, field = open_camera(folder / "nubot_a.camera.yaml"), open_field("msl-18x12")
    assert isinstance(camera, OmniCamera)
    for letter in ("a", "b", "c"):
        image = read_image(folder / f"nubot_{letter}.png")
        marks = json.loads(read_text(folder / f"nubot_{letter}.json", _MAX_BYTES))
        on_line, own, pose = np.array(marks["on_line"], dtype=np.float64), camera, None
        if letter == "a":
            pose = locate_points(GroundView(own).ground_from_image(on_line), field).pose
        else:
            scale = marks["mirror_outer_radius_px"] / 220.0
            own = replace(
                camera, width=image.shape[1], height=image.shape[0], center=tuple(marks["u0v0"]),
                inner_radius_px=marks["robot_body_radius_px"] + 3.0, radius_px=camera.radius_px * scale,
                outer_radius_px=marks["mirror_outer_radius_px"] - 5.0,
            )  # fmt: skip
        yield Photograph(f"nubot_{letter}", "BSD", image, own, field, _NO_LINES, on_line, pose, letter == "a")


def _laboratory(folder: Path) -> Iterator[Photograph]:
    """A mirror whose team detected points on lines."""
    camera, field = open_camera(folder / "hawking_1.camera.yaml"), open_field(folder / "hawking_1.field.yaml")
    lines = read_text(folder / "hawking_1.pixels.csv", _MAX_BYTES).splitlines()
    marks = np.array(list(csv.reader(lines))[1:], dtype=np.float64)
    pose = locate_points(GroundView(camera).ground_from_image(marks), field).pose
    yield Photograph("hawking_1", "BSD", read_image(folder / "hawking_1.png"), camera, field, _NO_LINES, marks, pose)


def _competition(folder: Path) -> Iterator[Photograph]:
    """Frames of which neither camera nor place is known: looked at by a nominal camera."""
    for path in sorted(folder.glob("*.jpg")):
        image = read_image(path)
        height, width = image.shape[:2]
        pitch, height_m = next(one for name, one in _NOMINAL.items() if path.stem.startswith(name))
        mount = Pose3.from_roll_pitch_yaw(0.0, pitch, 0.0, (0.0, 0.0, height_m))
        focal_px = _NOMINAL_FOCAL * width
        camera = PinholeCamera(width, height, focal_px, focal_px, 0.5 * width, 0.5 * height, np.zeros(5), mount)
        field = open_field("humanoid-kid-9x6")
        yield Photograph(path.stem, "MIT", image, camera, field, _NO_LINES, _NO_MARKS, None, calibrated=False)


GROUPS = {
    "omni": _mirrors,
    "mirror_pixels": _laboratory,
    "humanoid_photos": _competition,
    "spl_photos": spl_photographs,
}
_NOTE = (
    "Each photograph is seen for the first time. Marked lines: of SPL's three labelled ones a "
    "detected line passes within 8 px of both ends; of the mirrors' marks on lines a point lies within 8 px. `locate`: "
    "right within 15 cm and 4° of the reference; close, up to 25 cm; wrong, farther without a doubt; open where it is "
    "not right by a reference that can't tell. The reference is the pose that SPL's labelled lines give with roll and "
    "pitch free where they fit to 5 cm, or that of the marks: no "
    f"independent truth. It judges where labels that err by {_LABEL_PX} px, as they all together do, leave it known to "
    "5 cm; what is refused counts in any case. Competition frames "
    "have no calibration: a nominal camera looks, as horizon and circle suggest, detection only."
)


def measured(folder: Path, every: int = 1) -> Sequence[Seen]:
    """SPL's photographs alone, one in so many."""
    return [look_at(one) for k, one in enumerate(spl_photographs(folder)) if k % every == 0]
