"""The calibration strip: flat rectangles, black and white by turns, on a ray from the robot; finding it in an image."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from touchline.errors import InputError
from touchline.geometry import BoolArray, Float32Array, FloatArray, IntArray
from touchline.types import ImageArray

RAYS = 720
STEP_PX = 0.5
SMOOTHING_PX = 0.8
MIN_SLOPE = 0.04  # of an edge, in shares of white's tone per pixel: half of what black beside shaded green has
CANNY = (30.0, 90.0)


@dataclass(frozen=True, eq=False, slots=True)
class Strip:
    """edges_m: (E,) ascending ground ranges of the edges. signs: (E,) 1 where it gets brighter outwards, else -1.
    half_width_m: extent to each side.
    """

    edges_m: FloatArray
    signs: IntArray
    half_width_m: float


def read_strip(sequence: Mapping[str, Any], path: Path) -> Strip:
    """The strip that a sequence.yaml describes. Raises InputError naming file and key."""
    for key in ("patch_edges_m", "patch_colors", "patch_half_width_m"):
        if key not in sequence:
            raise InputError(f"{path}: '{key}' is missing: it has to describe the calibration strip")
    try:
        edges = np.array(sequence["patch_edges_m"], dtype=np.float64)
        half_width = float(sequence["patch_half_width_m"])
    except (TypeError, ValueError):
        raise InputError(f"{path}: 'patch_edges_m' and 'patch_half_width_m' must be numbers (m)") from None
    if edges.ndim != 1 or len(edges) < 5 or not np.all(np.isfinite(edges)) or edges[0] <= 0.0:
        raise InputError(f"{path}: 'patch_edges_m' needs at least five distances from the robot (m)")
    backwards = np.flatnonzero(np.diff(edges) <= 0.0)
    if len(backwards):
        k = int(backwards[0])
        raise InputError(
            f"{path}: 'patch_edges_m' is out of order: edge {k + 2} ({edges[k + 1]:g} m) must lie beyond "
            f"edge {k + 1} ({edges[k]:g} m)"
        )
    if not 0.0 < half_width < 5.0:
        raise InputError(f"{path}: 'patch_half_width_m' must be positive, found {sequence['patch_half_width_m']!r}")
    colors = sequence["patch_colors"]
    wanted = [["black", "white"][(k + (colors[:1] == ["white"])) % 2] for k in range(len(edges) - 1)]
    if colors != wanted:
        raise InputError(
            f"{path}: 'patch_colors' must name black and white by turns, one for each of the {len(edges) - 1} "
            "rectangles between the edges"
        )
    first = 1 if colors[0] == "white" else -1
    return Strip(edges, first * (-1) ** np.arange(len(edges)), half_width)


def light_of(image: ImageArray, gamma: float) -> Float32Array:
    """Linear brightness (H, W) of an image (H, W, 3), 1 = its own white: blur moves no edge in linear light."""
    levels = ((np.arange(256) / 255.0) ** gamma).astype(np.float32)
    light = cv2.transform(levels[image], np.array([[0.25, 0.5, 0.25]], dtype=np.float32))
    white = float(np.percentile(light, 99.5))
    return (light / max(white, 1e-6)).astype(np.float32)


def canny_edges(image: ImageArray) -> BoolArray:
    """(H, W) pixels on or beside an edge after Canny."""
    grey = cv2.GaussianBlur(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), (0, 0), SMOOTHING_PX)
    edges = cv2.Canny(grey, *CANNY, L2gradient=True)
    return cv2.dilate(edges, np.ones((3, 3), np.uint8)) > 0


@dataclass(frozen=True, eq=False, slots=True)
class View:
    """One image prepared for the search: linear brightness (H, W), its square root, and its Canny edges."""

    light: Float32Array
    tone: Float32Array
    edges: BoolArray

    @classmethod
    def of(cls, image: ImageArray, gamma: float) -> View:
        """Prepare an image (H, W, 3)."""
        light = light_of(image, gamma)
        return cls(light, np.sqrt(light), canny_edges(image))

    def sample(self, u: FloatArray, v: FloatArray) -> Float32Array:
        """Linear brightness, bilinear, at pixels (M, N); 0 outside."""
        return _sample(self.light, u, v)

    def sample_tone(self, u: FloatArray, v: FloatArray) -> Float32Array:
        """Its square root, in which black stands off from green as it does for the eye."""
        return _sample(self.tone, u, v)


def _sample(image: Float32Array, u: FloatArray, v: FloatArray) -> Float32Array:
    columns, rows = u.astype(np.float32), v.astype(np.float32)
    sampled = cv2.remap(image, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    return sampled.astype(np.float32, copy=False)


def find_strip(view: View, center: FloatArray, strip: Strip) -> tuple[float, FloatArray]:
    """Where the strip lies about a rough centre (2,): its angle in the image, atan2(v, u), and the edges' radii (E,).

    A first or last edge may be hidden: its radius is a guess then. Raises InputError, without the image's name, if no
    ray crosses all other edges in turn.
    """
    angles = np.arange(RAYS) * (2.0 * np.pi / RAYS)
    height, width = view.light.shape
    radii = np.arange(0.0, max(np.hypot(center[0], center[1]), width, height) * 0.75, STEP_PX)
    u = center[0] + np.outer(np.cos(angles), radii)
    v = center[1] + np.outer(np.sin(angles), radii)
    polar = cv2.GaussianBlur(view.sample_tone(u, v), (0, 0), sigmaX=SMOOTHING_PX / STEP_PX, sigmaY=0.3)
    slope = np.gradient(polar, STEP_PX, axis=1)
    inside = (u >= 0) & (u <= width - 1) & (v >= 0) & (v <= height - 1)
    on_edge = (
        inside
        & view.edges[np.clip(np.rint(v), 0, height - 1).astype(int), np.clip(np.rint(u), 0, width - 1).astype(int)]
    )
    steep = np.abs(slope)
    peak = on_edge & (steep >= MIN_SLOPE)
    peak[:, 1:-1] &= (steep[:, 1:-1] >= steep[:, :-2]) & (steep[:, 1:-1] > steep[:, 2:])
    rays = {int(k): np.flatnonzero(peak[k]) for k in np.flatnonzero(peak.sum(axis=1) >= 3)}
    for hidden in (slice(None), slice(1, None), slice(-1)):  # the robot may stand on the first edge, a goal on the last
        contrast, found, most = np.zeros(RAYS), np.full((RAYS, len(strip.signs)), np.nan), 0
        for k, peaks in rays.items():
            at = _alternating(peaks, slope[k])
            most = max(most, len(at))
            contrast[k], run = _best_window(at, slope[k], polar[k], strip.signs[hidden])
            found[k, hidden] = _tight_ends(run, peaks, slope[k])
        if contrast.max() > 0.0:
            angle, radii = _middle(angles, contrast, found * STEP_PX)
            return angle, _with_ends(radii)
    raise InputError(
        f"the strip is not found: no ray from the centre crosses its {len(strip.signs)} edges in turn "
        f"(at most {most} alternating edges on a ray)"
    )


def _with_ends(radii_px: FloatArray) -> FloatArray:
    """Radii (E,) with a hidden first or last one, NaN, as far from the next as that is from its own neighbour."""
    radii = radii_px.copy()
    for end, first, second in ((0, 1, 2), (-1, -2, -3)):
        if np.isnan(radii[end]):
            radii[end] = 2.0 * radii[first] - radii[second]
    return radii


def _alternating(peaks: IntArray, slope: Float32Array) -> IntArray:
    """Peaks of alternating sign: of neighbours of one sign the steepest."""
    kept: list[int] = []
    for index in peaks:
        if kept and (slope[kept[-1]] > 0) == (slope[index] > 0):
            if abs(slope[index]) > abs(slope[kept[-1]]):
                kept[-1] = int(index)
        else:
            kept.append(int(index))
    return np.array(kept, dtype=np.int64)


def _best_window(at: IntArray, slope: Float32Array, light: Float32Array, signs: IntArray) -> tuple[float, IntArray]:
    """Contrast between the darkest white and the brightest black of the best run of edges; 0 without one."""
    n = len(signs)
    best, where = 0.0, np.zeros(n, dtype=np.int64)
    for start in range(len(at) - n + 1):
        run = at[start : start + n]
        if np.sign(slope[run[0]]) != signs[0]:
            continue
        levels = np.array([light[(a + b) // 2] for a, b in itertools.pairwise(run)])
        bright = signs[:-1] > 0
        contrast = float(levels[bright].min() - levels[~bright].max())
        # whatever lies between two bright things is darker; white beside black differs by most of the white
        if contrast > max(best, 0.4 * float(levels[bright].max())):
            best, where = contrast, run
    return best, where


def _tight_ends(run: IntArray, peaks: IntArray, slope: Float32Array) -> IntArray:
    """The run with its first and last edge as near to the others as there is a peak of their sign: steeper ones
    further in or out are the robot's, or a field line's.
    """
    before = peaks[(peaks < run[1]) & ((slope[peaks] > 0) == (slope[run[0]] > 0))]
    after = peaks[(peaks > run[-2]) & ((slope[peaks] > 0) == (slope[run[-1]] > 0))]
    ends = run.copy()
    if len(before) and len(after):
        ends[0], ends[-1] = before[-1], after[0]
    return ends


def _middle(angles: FloatArray, contrast: FloatArray, radii: FloatArray) -> tuple[float, FloatArray]:
    """The middle of the widest bundle of neighbouring rays that cross the strip."""
    good = contrast > 0.5 * contrast.max()
    if good.all():
        raise InputError("the strip is not found: every ray crosses such edges")
    shift = int(np.flatnonzero(~good)[0])
    rolled = np.roll(good, -shift)
    starts = np.flatnonzero(rolled & ~np.roll(rolled, 1))
    ends = np.flatnonzero(rolled & ~np.roll(rolled, -1))
    widest = int(np.argmax(ends - starts))
    middle = ((starts[widest] + ends[widest]) // 2 + shift) % len(angles)
    width = (ends[widest] - starts[widest]) * (angles[1] - angles[0])
    return float(angles[(starts[widest] + shift) % len(angles)] + 0.5 * width), radii[middle]
