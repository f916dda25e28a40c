"""What the directions in which a strip was seen say together: bearings, wrong edges, white that is too bright."""

from pathlib import Path

import numpy as np

from touchline.camera.model_free import lagrange
from touchline.errors import InputError
from touchline.geometry import BoolArray, FloatArray, IntArray, circular_mean, wrap_angles
from touchline.published.strip.axis import trimmed_lstsq
from touchline.published.strip.edges import edge_name
from touchline.published.strip.strip import Strip

MIN_DIRECTIONS = 8  # a tilted mirror is a first harmonic: cubic interpolation follows it to 0.1 % at 45°
MAX_GAP_RAD = np.radians(65.0)  # twelve directions with one missing
SAME_DIRECTION_RAD = np.radians(4.0)  # images so near are averaged: between them noise would become a slope
WRONG_BEARING_RAD = np.radians(3.0)
_HARMONICS = (6, 10, 18)  # directions that it takes to tell the first, second, ... harmonic of what a mirror does
_FAR = 3.0  # standard deviations
_NEAR = 5  # edges of an image, next to each other


def orientation(angles_rad: FloatArray, bearings_rad: FloatArray, file: Path) -> tuple[int, float]:
    """Handedness and mounting angle: bearing = mount_yaw + handedness * angle (both (S,)), whichever sign agrees.

    Raises InputError naming a file if neither does.
    """
    fits = []
    for handedness in (-1, 1):
        yaw, off = most_common(bearings_rad - handedness * angles_rad, WRONG_BEARING_RAD)
        fits.append((float(np.median(off)), handedness, yaw))
    fits.sort()
    if fits[0][0] > WRONG_BEARING_RAD:
        raise InputError(
            f"{file}: the bearings don't agree with where the strip is seen, neither in a mirrored image nor in a "
            "straight one"
        )
    return fits[0][1], fits[0][2]


def most_common(angles_rad: FloatArray, near_rad: float) -> tuple[float, FloatArray]:
    """The mean of those angles (N,) that are near to the one which most agree with, and how far all are from that."""
    off = np.abs(wrap_angles(angles_rad[:, np.newaxis] - angles_rad))
    middle: FloatArray = off[int(np.argmin(np.median(off, axis=1)))]
    return circular_mean(angles_rad[middle <= near_rad]), middle


def smooth_bearings(seen_rad: FloatArray, bearings_rad: FloatArray) -> tuple[FloatArray, dict[int, str]]:
    """Bearings (S,) without the errors of turning the robot by hand, from those given (S,) and the image's own (S,).

    A mirror turns bearings by first and second harmonics of the direction; what is left after them is the turning's.
    Also what is wrong, by index: a bearing that contradicts the others.
    """
    errors = wrap_angles(bearings_rad - seen_rad)
    agree = np.abs(errors) <= WRONG_BEARING_RAD
    fit = around(seen_rad, errors, float(np.radians(0.3)), agree)
    rest = np.where(agree, errors - fit, errors)
    wrong = {
        int(k): f"the strip is seen {np.degrees(abs(rest[k])):.1f}° away from bearing_rad {bearings_rad[k]:g} of "
        "images.csv, by what the other images say"
        for k in np.flatnonzero(np.abs(rest) > WRONG_BEARING_RAD)
    }
    return seen_rad + fit, wrong


def order_mistakes(angles_rad: FloatArray, radii_px: FloatArray, strip: Strip) -> tuple[FloatArray, dict[int, str]]:
    """Every image against all others, angles (S,), radii (S, E): what is wrong, by index, an edge at another's place.

    Also the radii with NaN for a first or last edge that is far off: there lines and walls lie close.
    """
    radii = radii_px.copy()
    gaps = np.diff(np.nanmedian(radii, axis=0))
    wrong: dict[int, str] = {}
    for k in range(radii.shape[1]):  # a mirror that leans is a smooth wave around the circle; far from it is a mistake
        fit = around(angles_rad, radii[:, k], 0.3)
        far = np.abs(radii[:, k] - fit) > 0.35 * min(gaps[max(k - 1, 0)], gaps[min(k, len(gaps) - 1)])
        if k in (0, radii.shape[1] - 1):
            radii[far, k] = np.nan
            continue
        for image in np.flatnonzero(far):
            wrong.setdefault(
                int(image),
                f"edges out of order: {edge_name(strip, k)} is seen {radii[image, k]:.1f} px from the centre, where "
                f"the other images have it at {fit[image]:.1f} px",
            )
    return radii, wrong


def groups_of_directions(bearings_rad: FloatArray) -> list[list[int]]:
    """Indices of bearings (S,) that are one direction, in the order of the directions around the circle."""
    turned = np.mod(bearings_rad, 2.0 * np.pi)
    groups: list[list[int]] = []
    for index in np.argsort(turned).tolist():
        if groups and turned[index] - turned[groups[-1][0]] < SAME_DIRECTION_RAD:
            groups[-1].append(index)
        else:
            groups.append([index])
    seam = turned[groups[0][0]] + 2.0 * np.pi - turned[groups[-1][0]]
    if len(groups) > 1 and seam < SAME_DIRECTION_RAD:
        groups[0] += groups.pop()
    return groups


def check_directions(bearings_rad: FloatArray, folder: Path) -> None:
    """Raises InputError if bearings (S,) are too few or leave too wide a gap."""
    groups = groups_of_directions(bearings_rad)
    if len(groups) < MIN_DIRECTIONS:
        raise InputError(
            f"{folder}: too few directions: the strip is seen in {len(groups)}, at least {MIN_DIRECTIONS} "
            "all around are needed (24 are usual)"
        )
    sorted_rad = np.sort(np.mod(bearings_rad, 2.0 * np.pi))
    gaps = np.diff(sorted_rad, append=sorted_rad[0] + 2.0 * np.pi)
    if gaps.max() > MAX_GAP_RAD:
        k = int(np.argmax(gaps))
        raise InputError(
            f"{folder}: too few directions: none between bearings {np.degrees(sorted_rad[k]):.0f}° and "
            f"{np.degrees(sorted_rad[(k + 1) % len(gaps)]):.0f}°; the gap must not exceed "
            f"{np.degrees(MAX_GAP_RAD):.0f}°"
        )


def around(angles_rad: FloatArray, values: FloatArray, least: float, keep: BoolArray | None = None) -> FloatArray:
    """What harmonics of the direction make of values (S,) at angles (S,): (S,). What lies far off them does not count.

    least: deviation that is never far. keep: (S,), what may count at first. NaN never counts.
    """
    orders = np.arange(1, 1 + max(1, int(np.searchsorted(_HARMONICS, np.isfinite(values).sum(), side="right"))))
    phases = angles_rad[:, np.newaxis] * orders
    waves = np.column_stack((np.ones(len(values)), np.cos(phases), np.sin(phases)))
    return waves @ trimmed_lstsq(waves, values, least, keep)[0]


def healed(
    angles_rad: FloatArray, values: FloatArray, least: FloatArray, of_its_own: bool
) -> tuple[FloatArray, BoolArray]:
    """Values (S, E) of E edges in S images, where single ones that contradict the other directions, or are NaN, are
    replaced by what those say; and which (S, E). least: (E,) deviation that is never a contradiction.

    of_its_own: whether each value was measured by itself. What the nearest edges of an image have in common is then the
    mirror's, and only what differs from them is in doubt.
    """
    fits = np.column_stack([around(angles_rad, values[:, k], float(least[k])) for k in range(values.shape[1])])
    if of_its_own:
        rest, n = values - fits, values.shape[1]
        near = [np.arange(_NEAR) + np.clip(k - _NEAR // 2, 0, n - _NEAR) for k in range(n)]
        fits = fits + np.column_stack([np.nanmedian(rest[:, chosen], axis=1) for chosen in near])
    off = np.abs(values - fits)
    spoilt = (off > np.maximum(_FAR * 1.4826 * np.nanmedian(off, axis=0), least)) | np.isnan(values)
    return np.where(spoilt, fits, values), spoilt


def white_excess(radii_px: FloatArray, ranges_m: FloatArray, signs: IntArray) -> FloatArray:
    """How far (E,) px white reaches into black at each edge, as it is seen; from edges at radii (S, E).

    Where the camera's response isn't known, or white is overexposed, every white rectangle looks too long and every
    black one too short. Smooth mirrors have no such zigzag, so it is measured as one: by how much each edge is off the
    interpolation between the two on either side. 0 unless a zigzag that changes evenly with the radius explains most.
    """
    middle, logs = np.median(radii_px, axis=0), np.log(ranges_m)
    inner = np.arange(2, len(middle) - 2)
    off, share = np.empty(len(inner)), np.empty(len(inner))
    for i, k in enumerate(inner):
        others = np.array([k - 2, k - 1, k + 1, k + 2])
        between = np.column_stack((middle[others], signs[others]))
        expected = lagrange(logs[others], between, logs[[k]])[0]
        off[i], share[i] = expected[0] - middle[k], signs[k] - expected[1]
    terms = np.column_stack((share, share * (middle[inner] - middle.mean())))
    solution = np.linalg.lstsq(terms, off, rcond=None)[0]
    if np.sum((terms @ solution - off) ** 2) > 0.25 * np.sum(off**2):
        return np.zeros(len(middle))
    excess: FloatArray = solution[0] + solution[1] * (middle - middle.mean())
    excess[[0, -1]] *= (signs[0] > 0, signs[-2] > 0)  # black beside carpet has no white
    return excess
