"""The compiled joint fit and both camera-error models against finite differences and plain NumPy."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest
from drives import open_drive
from numba import njit

from touchline.field import open_field
from touchline.field.association import FieldAssociations
from touchline.field.offset_map import CHUNK, OFFSETS, look_up_offsets, lookup_of
from touchline.geometry import FloatArray, Pose
from touchline.localization.camera_errors import camera_errors
from touchline.localization.camera_errors.base import (
    COLUMNS,
    NORMAL,
    PLACED,
    Response,
    chunks_of,
    fill_all,
    place_all,
    placed_points,
    prepare,
    terms_at,
)
from touchline.localization.camera_errors.perspective import PerspectiveResponse
from touchline.localization.registration.features import Features
from touchline.localization.registration.joint import Seen, StatePrior
from touchline.localization.registration.kernels import Plan
from touchline.localization.registration.registration import Registration
from touchline.localization.registration.seen import seen_of, seen_points
from touchline.types import Crossings, LandmarkKind, Landmarks, LinePoints, Observation

FIELD = open_field("msl-18x12")
PLACES = FieldAssociations(FIELD)
AXIS = np.array([math.cos(0.42), 0.0, -math.sin(0.42)])
EYE = np.array([0.05, 0.02, 1.1])
PLAN = Plan(np.array([0.3, 0.1, 0.0]), 16.0, 1e-4, 0.1)


class Kind(NamedTuple):
    """A kind of camera: its response, and errors (K,) of a usual size."""

    response: Response
    errors: FloatArray


@pytest.fixture(scope="module", params=["mirror", "perspective", "no axis", "fisheye"])
def kind(request: pytest.FixtureRequest) -> Kind:
    """Of each kind of camera."""
    if request.param == "mirror":
        return Kind(
            camera_errors(open_drive("tracks").setup.camera).response(), np.array([0.006, -0.004, 0.6, -0.3, 0.008])
        )
    axis = np.zeros(3) if request.param == "no axis" else AXIS
    response = PerspectiveResponse(EYE, axis, fisheye=request.param == "fisheye")
    return Kind(response, np.array([0.012, -0.015, 0.01, 0.012]))


def ground() -> FloatArray:
    """Points (N, 2) all about the robot, those ahead of it in the view of every camera."""
    ranges, bearings = np.meshgrid([0.8, 1.5, 2.5, 4.0], np.linspace(-0.7, 0.7, 5))
    return np.column_stack((ranges.ravel() * np.cos(bearings.ravel()), ranges.ravel() * np.sin(bearings.ravel())))


@njit
def compiled_places(points, errors, began, response):  # type: ignore[no-untyped-def]
    """Points (N, 2) as `place_all` puts them, prepared at the errors (K,) with which a fit began."""
    terms, prepared, room = terms_at(errors, response), prepare(points, began, response), np.zeros(20 * CHUNK)
    out, rows = np.empty_like(points), chunks_of(points)
    for i in range(len(points)):
        place_all(rows[i // CHUNK], room, terms, prepared[i // CHUNK])
        out[i, 0], out[i, 1] = room[PLACED + i % CHUNK], room[PLACED + CHUNK + i % CHUNK]
    return out


@njit
def compiled_columns(points, placed, normals, errors, began, response):  # type: ignore[no-untyped-def]
    """Derivatives (K, N) by the errors of where points, a chunk at most, lie along normals (N, 2)."""
    terms, prepared, room = terms_at(errors, response), prepare(points, began, response), np.zeros(20 * CHUNK)
    for i in range(len(points)):
        room[PLACED + i], room[PLACED + CHUNK + i] = placed[i, 0], placed[i, 1]
        room[NORMAL + i], room[NORMAL + CHUNK + i] = normals[i, 0], normals[i, 1]
    fill_all(chunks_of(points)[0], room, terms, prepared[0])
    columns = np.zeros((len(errors), len(points)))
    for k in range(len(errors)):
        for i in range(len(points)):
            columns[k, i] = room[COLUMNS + (3 + k) * CHUNK + i]
    return columns


@njit
def offset_at(table, x, y):  # type: ignore[no-untyped-def]
    """The offset (2,) at one place."""
    places = np.zeros(4 * CHUNK)
    places[0], places[CHUNK] = x, y
    look_up_offsets(lookup_of(table), places)
    return np.array((places[OFFSETS], places[OFFSETS + CHUNK]))


def differences(points: FloatArray, normals: FloatArray, errors: FloatArray, response: Response) -> FloatArray:
    """(K, N) of `placed_points`, central."""
    steps = 1e-6 * np.eye(len(errors))
    moved = [placed_points(points, errors + e, response) - placed_points(points, errors - e, response) for e in steps]
    return np.array([(normals * each).sum(axis=1) for each in moved]) / 2e-6


@pytest.mark.parametrize("turn", [0.0, 1.1])
def test_columns_are_the_derivatives_of_where_points_are_placed(kind: Kind, turn: float) -> None:
    """Exactly at no errors, by which they were linearised; at usual ones to a seventh."""
    points, angles = ground(), turn + np.linspace(0.0, 0.5, 20)
    normals = np.column_stack((np.cos(angles), np.sin(angles)))
    for errors, tolerance in ((np.zeros_like(kind.errors), 1e-5), (kind.errors, 0.14)):
        placed = placed_points(points, errors, kind.response)
        found = compiled_columns(points, placed, normals, errors, errors, kind.response)
        expected = differences(points, normals, errors, kind.response)
        scale = np.abs(expected).max(axis=1, keepdims=True) + 1e-6
        assert np.abs((found - expected) / scale).max() < tolerance


# --- the fit ----------------------------------------------------------------------------------------------------------


def observation(pose: Pose, kind: Kind) -> Observation:
    """Noisy line points ahead, two of them clutter, the crossings and posts there, as a camera with the kind's errors
    sees them.
    """
    rng = np.random.default_rng(3)

    def ahead(exact: FloatArray) -> tuple[FloatArray, list[int]]:
        true = pose.inverse().transform(exact)
        kept = np.flatnonzero((true[:, 0] > 0.5) & (np.abs(true[:, 1]) < true[:, 0]) & (np.hypot(*true.T) < 4.5))
        found = true[kept].copy()
        for _ in range(60):
            found += 0.7 * (true[kept] - placed_points(found, kind.errors, kind.response))
        return found + rng.normal(0.0, 0.015, found.shape), kept.tolist()

    crossings = [c for c in FIELD.crossings if not c.curved]
    lines = np.vstack((ahead(np.vstack(FIELD.polylines(0.2)))[0], [[2.0, 0.5], [3.0, -1.0]]))
    corners, which = ahead(np.array([[c.x, c.y] for c in crossings]))
    posts, _ = ahead(np.array([[post.x, post.y] for post in FIELD.posts]))
    n, m, k = len(lines), len(corners), len(posts)
    assert min(n - 30, m, k) > 0
    return Observation(
        0,
        LinePoints(lines, np.tile([[4e-4, 1e-4], [1e-4, 3e-4]], (n, 1, 1)), np.linspace(0.5, 1.0, n), nan(n)),
        crossings=Crossings(
            np.array([crossings[i].kind.value for i in which]),
            corners,
            np.array([crossings[i].orientation_rad - pose.heading for i in which]),
            np.tile([[9e-4, 2e-4], [2e-4, 6e-4]], (m, 1, 1)),
            np.full(m, 0.9),
            nan(m),
        ),
        landmarks=Landmarks(
            np.full(k, LandmarkKind.POST.value),
            posts,
            np.tile(1e-3 * np.eye(2), (k, 1, 1)),
            np.full(k, 0.8),
            ((),) * k,
            nan(k),
        ),
    )


def nan(count: int) -> FloatArray:
    return np.full((count, 2), np.nan)


def nearest_place(seen: Seen, i: int, at: FloatArray, pose: FloatArray) -> tuple[FloatArray | None, float, float]:
    """Where feature i belongs, robot frame, of all places of its kind and orientation; half its squared distance; and
    the sum of the densities of all that are tried. at (2,): where it is placed.
    """
    points, (x, y, heading) = seen.features, pose.tolist()
    table, sets, first, end = points.sets[i].tolist()
    robot = Pose(x, y, heading).inverse()
    candidates = robot.transform(PLACES.tables.places_m[points.candidates[first:end]])
    if table >= 0:
        quarter = math.floor((heading + points.turns_rad[i]) / (0.5 * math.pi)) % sets if sets > 1 else 0
        of_kind = np.setdiff1d(np.unique(PLACES.tables.nearest[table + quarter]), [-1])
        places = robot.transform(PLACES.tables.places_m[of_kind])
        closest = places[[np.argmin(np.hypot(*(places - at).T))]] if len(places) else places
        candidates = np.vstack((closest, candidates))
    if not len(candidates):
        return None, math.inf, 0.0
    exponents = 0.5 * np.einsum("ci,ij,cj->c", candidates - at, points.information[i], candidates - at)
    best = int(np.argmin(exponents))
    return candidates[best], float(exponents[best]), float(np.exp(-exponents).sum())


class Sums(NamedTuple):
    """As of `StateFit`: information (S, S), gradient (S,), and the counts of the last look."""

    information: FloatArray
    gradient: FloatArray
    explained: float
    of: float
    distance: float
    log_likelihood: float


def looked_at(seen: Seen, state: FloatArray, began: FloatArray, width_m: float, kind: Kind) -> Sums:
    """All that is seen at a state (S,), in plain NumPy but for the camera's columns, which are tested above."""
    pose, errors, offsets = state[:3], state[3:], Registration(FIELD.distance_map()).table
    rows: list[tuple[FloatArray, float, float]] = []
    explained = of = distance = log_likelihood = 0.0

    def row(normal: FloatArray, raw: FloatArray, at: FloatArray) -> FloatArray:
        turned = Pose(0.0, 0.0, pose[2]).transform(normal[np.newaxis])[0]
        by_errors = compiled_columns(raw[None], at[None], normal[None], errors, began, kind.response)[:, 0]
        return np.array([*turned, at[0] * normal[1] - at[1] * normal[0], *by_errors])

    placed = compiled_places(seen.positions_m, errors, began, kind.response)
    for i, (raw, at) in enumerate(zip(seen.positions_m, placed, strict=True)):
        offset = offset_at(offsets, *Pose(*pose.tolist()).transform(at[None])[0].tolist())
        d = float(np.hypot(*offset))
        normal = Pose(0.0, 0.0, -pose[2]).transform(offset[None] / d)[0]
        foot = at - d * normal
        ratio = np.clip((foot @ foot + 0.01) / (raw @ raw + 0.01), 0.5, 2.0)
        variance = ratio * (normal @ seen.covariances_m2[i] @ normal) + PLAN.floor_m2
        reach = width_m**2 + PLAN.gate2 * variance
        weight = seen.shares[i] * (reach / (reach + d * d)) ** 2 / (seen.noise * variance)
        rows.append((row(normal, raw, foot), d, weight))
        density = math.exp(-0.5 * d * d / variance) / math.sqrt(2.0 * math.pi * variance)
        log_likelihood += seen.shares[i] * math.log(PLAN.clutter_per_m + density)
        explained += seen.shares[i] * (d * d < 9.0 * variance)
        of += seen.shares[i]
        distance += seen.shares[i] * d
    points = seen.features
    placed = compiled_places(seen.raw_m, errors, began, kind.response)
    for i, (raw, at) in enumerate(zip(seen.raw_m, placed, strict=True)):
        place_m, exponent, total = nearest_place(seen, i, at, pose)
        own = points.own_information[i]
        soft = 1.0 + 0.5 * width_m**2 * np.trace(own)
        likely = 0.0 if place_m is None else points.peaks[i] * math.exp(-exponent / soft)
        other = points.peaks[i] * max(total - math.exp(-exponent), 0.0)
        weight = seen.feature_share * likely / (likely + other + points.floors[i]) / soft
        off = np.zeros(2) if place_m is None else at - place_m
        rows += [(row(normal, raw, at - off), float(normal @ off), weight) for normal in np.linalg.cholesky(own).T]
        right = points.trust[i] * likely / (likely + points.floors[i])
        log_likelihood += seen.feature_share * math.log(points.floors[i] + likely)
        explained, of = explained + right, of + points.trust[i]
        distance += right * math.hypot(*off)
    u, d, w = (np.array(column) for column in zip(*rows, strict=True))
    return Sums((u.T * w) @ u, -u.T @ (w * d), explained, of, distance, log_likelihood)


def test_the_fit_is_that_of_plain_numpy(kind: Kind) -> None:
    """Line points with clutter, crossings and posts, from a start some centimetres off and with errors unknown."""
    truth = Pose(6.3, 0.8, 0.3)
    seen = seen_of(observation(truth, kind), Features(PLACES, None, 1.0), 1.3)
    start = np.array([truth.x + 0.06, truth.y - 0.05, truth.heading + 0.02, *np.zeros_like(kind.errors)])
    deviations = np.array([0.1, 0.1, 0.05, *3.0 * np.abs(kind.errors)])
    prior = StatePrior(start, np.diag(deviations**-2.0))
    found = Registration(FIELD.distance_map(), PLACES.tables).fit_state(seen, start, prior, PLAN, kind.response)
    state = start.copy()
    for width_m in PLAN.widths_m.tolist():
        sums = looked_at(seen, state, start[3:], width_m, kind)
        pull = sums.gradient + prior.information @ (prior.mean - state)
        state = state + np.linalg.solve(sums.information + prior.information, pull)
    last = looked_at(seen, state, start[3:], 0.0, kind)
    scale = 1.0 / np.sqrt(np.diag(last.information + prior.information))
    np.testing.assert_allclose((found.state - state) / scale, 0.0, atol=1e-3)
    np.testing.assert_allclose(
        found.information * np.outer(scale, scale), last.information * np.outer(scale, scale), atol=1e-3
    )
    np.testing.assert_allclose(found.gradient * scale, last.gradient * scale, atol=1e-2)
    assert found.of == pytest.approx(last.of)
    assert found.explained == pytest.approx(last.explained / last.of, abs=1e-4)
    assert found.residual_m == pytest.approx(last.distance / last.of, rel=1e-3)
    assert found.log_likelihood == pytest.approx(last.log_likelihood, abs=1e-2)
    off, after = state - prior.mean, prior.information + last.information
    narrowed = np.linalg.slogdet(after)[1] - np.linalg.slogdet(prior.information)[1]
    assert found.contradiction == pytest.approx(0.5 * (off @ prior.information @ off + narrowed), abs=1e-2)
    assert Pose(*found.state[:3].tolist()).distance_to(truth) < 0.04


def test_the_noise_of_two_lines_tells_nothing_of_the_attitude() -> None:
    """A corner gives four numbers: of x, y, heading, roll and pitch one combination stays as unknown as it was."""
    rng = np.random.default_rng(2)
    response = PerspectiveResponse(np.array([0.0, 0.0, 0.5]), AXIS, fisheye=False)
    truth = Pose(7.0, 4.0, 0.9)
    along = np.linspace(1.0, 2.5, 60)[:, np.newaxis]
    half = np.abs(FIELD.segments[:, :2]).max(axis=0)
    corner = np.concatenate((half - along * (1.0, 0.0), half - along * (0.0, 1.0)))
    points = truth.inverse().transform(corner + rng.normal(0.0, 0.02, corner.shape))
    spread = np.tile(0.02**2 * np.eye(2), (len(points), 1, 1))
    seen = seen_points(LinePoints(points, spread, np.ones(len(points)), np.full_like(points, np.nan)), 0.25)
    deviations = np.array([0.3, 0.3, 0.15, 0.05, 0.05, 1e-4, 1e-4])
    prior = StatePrior(np.array([*truth, 0.0, 0.0, 0.0, 0.0]), np.diag(deviations**-2.0))
    found = Registration(FIELD.distance_map()).fit_state(seen, prior.mean, prior, PLAN, response)
    told = np.linalg.eigvalsh(found.information * np.outer(deviations, deviations)[:7, :7])[2:]
    assert told[0] < 0.1  # 0.37 with derivatives at the points
    assert told[1] > 30.0
