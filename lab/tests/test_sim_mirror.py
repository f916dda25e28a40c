"""Mirror profiles: a solved mirror shows what was wanted, by a trace that knows nothing of how it was solved."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest

from touchline.errors import InputError
from touchline_lab.simulation.cameras.mirror import (
    MirrorHead,
    MirrorProfile,
    Target,
    combined,
    horizontally_isometric,
    hyperbolic,
    solve_mirror,
    tangent_range,
    vertically_isometric,
)
from touchline_lab.simulation.cameras.mirror_rays import MirrorMount, mirror_rays
from touchline_lab.simulation.cameras.omni import SimulatedOmniCamera, omni_mapping

READY: dict[str, Callable[[], Target]] = {
    "hyperbolic": lambda: hyperbolic()[0],
    "horizontally isometric": horizontally_isometric,
    "vertically isometric": vertically_isometric,
    "combined": combined,
    "tangent": tangent_range,
}


def traced_range(profile: MirrorProfile, rho: float) -> float:
    """Ground range at a pixel radius from the profile's points alone: a polynomial through nearby points, its meeting

    with the camera's ray by bisection, its normal from the polynomial, then the law of reflection.
    """
    head = profile.head
    radii, heights = profile.radius_m, profile.height_m
    tangent = rho / head.focal_px
    nearest = int(np.argmin(np.abs(radii / heights - tangent)))
    low = min(max(nearest - 3, 0), len(radii) - 7)
    middle, scale = radii[low + 3], radii[low + 6] - radii[low]
    curve = np.polynomial.Polynomial.fit((radii[low : low + 7] - middle) / scale, heights[low : low + 7], 4)
    inner, outer = radii[low], radii[low + 6]
    for _ in range(60):
        between = 0.5 * (inner + outer)
        inner, outer = (between, outer) if between < tangent * curve((between - middle) / scale) else (inner, between)
    radius = 0.5 * (inner + outer)
    slope = curve.deriv()((radius - middle) / scale) / scale
    incoming = np.array([tangent, 1.0]) / math.hypot(tangent, 1.0)
    normal = np.array([slope, -1.0]) / math.hypot(slope, 1.0)
    outgoing = incoming - 2.0 * (incoming @ normal) * normal
    height = head.camera_height_m + radius / tangent
    return float(radius - height * outgoing[0] / outgoing[1]) if outgoing[1] < 0.0 else math.inf


def wanted_range(target: Target, profile: MirrorProfile, rho: float) -> float:
    """Ground range of the straight line from the mirror's point at a pixel radius through its target."""
    x, z, w = target(rho)
    height = float(np.interp(rho / profile.head.focal_px, profile.radius_m / profile.height_m, profile.height_m))
    radius, above = height * rho / profile.head.focal_px, profile.head.camera_height_m + height
    along, down = x - w * radius, w * above - z
    return radius + above * along / down if down > 0.0 else math.inf


@pytest.mark.parametrize("name", READY)
def test_the_solved_mirror_shows_the_wanted_range_to_a_millimetre_up_to_eight_metres(name: str) -> None:
    target = READY[name]()
    profile = solve_mirror(target)
    radii = np.linspace(2.03, 231.0, 400)
    wanted = np.array([wanted_range(target, profile, float(rho)) for rho in radii])
    near = (wanted > 0.0) & (wanted < 8.0)
    assert near.sum() > 250
    traced = np.array([traced_range(profile, float(rho)) for rho in radii[near]])
    assert np.max(np.abs(traced - wanted[near])) < 1e-3


@pytest.mark.parametrize(
    ("solve", "words"),
    [
        (lambda: solve_mirror(tangent_range(), MirrorHead(outer_px=600.0)), "no profile shows this range: at "),
        (lambda: solve_mirror(lambda rho: (math.nan, 0.0, 1.0)), "breaks down at 0.0 px"),
        (lambda: horizontally_isometric(-0.1), "shows no ground"),
        (lambda: combined(inner=(95.0, 5.0), middle=(178.0, 1.0)), "must grow outwards"),
        (lambda: MirrorHead(focal_px=0.0), "positive numbers"),
    ],
)
def test_a_mirror_that_cannot_be_solved_is_refused_in_one_sentence(solve: Callable[[], object], words: str) -> None:
    with pytest.raises(InputError, match=words):
        solve()


def test_a_mirror_mounted_askew_sees_other_ground_and_can_still_be_projected_into() -> None:
    profile = solve_mirror(tangent_range())
    ideal, askew = (
        SimulatedOmniCamera.from_mirror(profile, mount)
        for mount in (MirrorMount(), MirrorMount(tilt_x=0.02, tilt_y=-0.015, shift_x=0.001, shift_y=-0.002))
    )
    points: npt.NDArray[np.float64] = np.array([[1.0, 2.0], [3.0, -1.0], [-4.0, 2.0], [0.9, 0.0], [5.0, 5.0]])
    assert np.max(np.abs(ideal.ground_from_image(ideal.project(points)) - points)) < 1e-3
    assert np.max(np.abs(askew.ground_from_image(askew.project(points)) - points)) < 1e-6
    shift = np.hypot(*(askew.project(points) - ideal.project(points)).T)
    assert shift.min() > 1.0
    assert omni_mapping(askew.design) == omni_mapping(ideal.design), "camera.yaml is the head as designed"


def test_tilts_turn_by_the_right_hand_and_a_curved_mirror_set_forward_looks_back() -> None:
    head = MirrorHead(apex_m=0.2)
    flat = MirrorProfile(head, np.linspace(0.0, 0.1, 400), np.full(400, 0.2), np.zeros(400))
    angle = 0.03

    def straight_up(profile: MirrorProfile, mount: MirrorMount) -> npt.NDArray[np.float64]:
        return mirror_rays(profile, mount, np.array([0.0]), np.array([0.0]))[0, 3:]

    down = math.cos(2.0 * angle)
    np.testing.assert_allclose(
        straight_up(flat, MirrorMount(tilt_x=angle)), [0.0, math.sin(2 * angle), -down], atol=1e-9
    )
    np.testing.assert_allclose(
        straight_up(flat, MirrorMount(tilt_y=angle)), [-math.sin(2 * angle), 0.0, -down], atol=1e-9
    )
    curved = solve_mirror(tangent_range())
    shift = 0.0005
    bend = math.atan(float(curved.surface(np.array([shift]))[1][0]))
    turned = straight_up(curved, MirrorMount(shift_x=shift))
    assert turned[0] == pytest.approx(-math.sin(2.0 * bend), abs=1e-6)
    assert math.degrees(2.0 * bend) == pytest.approx(2.2, abs=0.1), "as docs/simulation.md says"
    np.testing.assert_allclose(straight_up(curved, MirrorMount(shift_y=shift)), turned[[1, 0, 2]], atol=1e-9)
