"""What one observation says of the pose, as numbers, a table and a picture; and refusals of points that fit none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from touchline.errors import NoFitError
from touchline.field import FieldModel, open_field
from touchline.geometry import FloatArray, Pose
from touchline.localization.one_shot.permutation_test import PermutationTest
from touchline.localization.one_shot.points_file import points_and_weights
from touchline.localization.one_shot.thinning import different
from touchline.types import Hypothesis, ImageArray, LinePoints, Observation

if TYPE_CHECKING:
    from rich.console import Group

_POINT, _ROBOT = (255, 120, 0), (0, 0, 220)  # BGR


@dataclass(frozen=True, eq=False, slots=True)
class Location:
    """Where one observation was made.

    pose, covariance (3, 3) in (m, m, rad): field frame. error: weighted mean of the error function.
    mean_distance_m, median_distance_m: of the points to the nearest line centre, all points alike, exact distances.
    hypotheses: other poses of similar error, the better first; residual_m is their mean_distance_m.
    points: different points used. chance: the error against that of the same points rearranged. doubts: what speaks
    against the pose, a sentence each; where points don't fit, the covariance is as wide as they are off.
    camera_errors (K,): that were fitted with the pose, of an observation of more than line points.
    """

    pose: Pose
    covariance: FloatArray
    error: float
    mean_distance_m: float
    median_distance_m: float
    hypotheses: tuple[Hypothesis, ...]
    points: int
    chance: PermutationTest
    doubts: tuple[str, ...] = ()
    camera_errors: FloatArray | None = None

    def to_dict(self) -> dict[str, Any]:
        """Everything but the camera's errors, in numbers, words and lists as JSON knows them: metres and radians."""
        return {
            "pose": self.pose.to_dict(),
            "covariance": self.covariance.tolist(),
            "mean_distance_m": self.mean_distance_m,
            "median_distance_m": self.median_distance_m,
            "error": self.error,
            "points": self.points,
            "deviations_better_than_chance": self.chance.significance,
            "hypotheses": [{**other.pose.to_dict(), "mean_distance_m": other.residual_m} for other in self.hypotheses],
            "doubts": list(self.doubts),
        }

    def __rich__(self) -> Group:
        """A table of the pose with its standard deviations and of the other hypotheses, and the doubts below."""
        from rich.console import Group
        from rich.table import Table
        from rich.text import Text

        table = Table(box=None, header_style="dim", pad_edge=False, padding=(0, 2, 0, 0))
        table.add_column("")
        for title in ("x (m)", "y (m)", "heading (rad)", "heading (°)", "mean distance (cm)"):
            table.add_column(title, justify="right")
        rows = [("pose", self.pose, self.mean_distance_m)]
        rows += [(f"hypothesis {k}", other.pose, other.residual_m) for k, other in enumerate(self.hypotheses, start=1)]
        for name, (x, y, turn), distance_m in rows:
            numbers = (f"{x:.3f}", f"{y:.3f}", f"{turn:.4f}", f"{np.degrees(turn):.2f}", f"{100 * distance_m:.1f}")
            table.add_row(name, *numbers)
        x, y, turn = np.sqrt(np.diag(self.covariance))
        numbers = (f"{x:.3f}", f"{y:.3f}", f"{turn:.4f}", f"{np.degrees(turn):.2f}", "")
        table.add_row("± of the pose", *numbers, style="dim")
        alone = [] if self.hypotheses else [Text("no other pose explains the points as well", style="dim")]
        return Group(table, *alone, *(Text(f"in doubt: {doubt}", style="yellow") for doubt in self.doubts))

    def draw(
        self,
        field: str | Path | FieldModel,
        points: str | Path | FloatArray | Sequence[Sequence[float]] | LinePoints | Observation,
    ) -> ImageArray:
        """The field from above as an image (H, W, 3), BGR, with the points where the pose puts them, and the robot.

        field, points: as of `touchline.locate`. Raises InputError for what can't be read.
        """
        import cv2

        from touchline.field.drawing import draw_field, field_view

        model = field if isinstance(field, FieldModel) else open_field(field)
        canvas, view = draw_field(model), field_view(model)
        positions_m, _ = points_and_weights(points)
        pixels = np.rint(view.picture_from_field(self.pose.transform(positions_m)))
        for u, v in pixels[different(pixels)].astype(int):
            cv2.circle(canvas, (int(u), int(v)), 3, _POINT, -1, cv2.LINE_AA)
        ends = np.rint(view.picture_from_field(self.pose.transform(np.array([[0.0, 0.0], [0.6, 0.0]])))).astype(int)
        robot, ahead = ((int(u), int(v)) for u, v in ends)
        cv2.circle(canvas, robot, 12, _ROBOT, 3, cv2.LINE_AA)
        cv2.arrowedLine(canvas, robot, ahead, _ROBOT, 3, cv2.LINE_AA)
        return canvas


class PoorFitError(NoFitError):
    """Points that most of the lines miss even at the best pose: that pose nevertheless, and the test against chance."""

    def __init__(self, message: str, best: Hypothesis, chance: PermutationTest) -> None:
        super().__init__(message)
        self.best = best
        self.chance = chance


class NotSignificantError(PoorFitError):
    """Points that fit no pose better than chance: `chance` is the test that the best pose failed."""
