"""Exposure control: entropy of known histograms, the search on closed forms, the trigger, and the linear images."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from synthetic import mirror_camera

from touchline.camera.exposure import (
    ExposureControl,
    ExposureSettings,
    Watch,
    image_entropy,
    mirror_masks,
)
from touchline.camera.exposure_search import EntropySearch, PathSettings, SearchSettings
from touchline.config import load_settings
from touchline.errors import InputError, TouchlineError
from touchline.sources.uvc_camera import UvcCamera
from touchline.types import ImageArray

# --- entropy ----------------------------------------------------------------------------------------------------------


def test_entropies_of_the_channels_add_up() -> None:
    image = np.zeros((16, 16, 3), np.uint8)
    image[..., 0] = np.arange(256).reshape(16, 16)  # all 256 levels alike
    image[:8, :, 1] = 200  # two levels alike
    image[:4, :, 2] = 9  # a quarter against three
    wanted = math.log(256) + math.log(2) - 0.25 * math.log(0.25) - 0.75 * math.log(0.75)
    assert image_entropy(image) == pytest.approx(wanted)


def test_only_masked_pixels_count() -> None:
    image = np.random.default_rng(0).integers(0, 256, (20, 20, 3), dtype=np.uint8)
    mask = np.zeros((20, 20), dtype=np.bool_)
    mask[3:5, 3:5] = True
    image[mask] = 5
    assert image_entropy(image, mask) == 0.0
    with pytest.raises(InputError, match="leaves no pixel"):
        image_entropy(image, np.zeros((20, 20), dtype=np.bool_))


# --- the path ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("a", "b"), [(1.0, 0.0), (4.0, 0.0), (2.0, 3.0), (2.0, -1.0)])
def test_the_path_is_exposure_a_gain_plus_b(a: float, b: float) -> None:
    path = PathSettings(a_ms=a, b_ms=b)
    low, high = path.stops_range
    for stops in np.linspace(low, high, 9):
        exposure_ms, gain = path.at(float(stops))
        assert exposure_ms == pytest.approx(a * gain + b)
        assert math.log2(exposure_ms * gain) == pytest.approx(stops)
    assert path.at(high + 5.0) == pytest.approx(path.at(high))


def test_the_path_stays_within_the_camera_s_limits() -> None:
    path = PathSettings(a_ms=5.0, longest_exposure_ms=40.0, least_gain=2.0)
    assert path.gain_range == pytest.approx((2.0, 8.0))
    with pytest.raises(InputError, match="no part of the path"):
        load_settings(PathSettings, overrides=["longest_exposure_ms=1", "least_gain=2"])


# --- the search on closed forms ---------------------------------------------------------------------------------------


def parabola(peak: float) -> Callable[[float], float]:
    return lambda x: 14.0 - 0.4 * (x - peak) ** 2


def tent(peak: float) -> Callable[[float], float]:
    """Even rise, steep fall, as overexposure makes it, rounded within a third of a stop."""
    return lambda x: 14.0 - (0.7 * (peak - x) if x < peak else 2.2 * (x - peak)) ** 2 / (abs(x - peak) + 0.3)


def run_search(
    curve: Callable[[float], float], start: float, first_step: float, settings: SearchSettings | None = None
) -> EntropySearch:
    search = EntropySearch(start, (0.0, 12.0), first_step, settings or SearchSettings())
    while (place := search.propose()) is not None:
        assert place not in search.tried
        search.tell(place, curve(place))
    return search


@pytest.mark.parametrize("shape", [parabola, tent])
@pytest.mark.parametrize("offset", [-3.3, -0.4, 0.0, 0.9, 3.4])
def test_the_peak_is_found_in_eight_images(shape: Callable[[float], Callable[[float], float]], offset: float) -> None:
    curve = shape(6.0)
    step = math.copysign(max(abs(offset) * 0.75, 0.9), -offset)  # the brightness tells three quarters of the way
    search = run_search(curve, 6.0 + offset, step)
    assert len(search.tried) <= 8
    assert curve(search.best) >= curve(6.0) - 0.05


@pytest.mark.parametrize(("peak", "end"), [(-2.0, 0.0), (14.0, 12.0)])
def test_the_search_stays_on_the_path(peak: float, end: float) -> None:
    search = run_search(parabola(peak), 6.0, math.copysign(2.0, peak - 6.0))
    assert min(search.tried) >= 0.0
    assert max(search.tried) <= 12.0
    assert search.best == end


@pytest.mark.parametrize("step", [0.2, 0.25, 1.0 / 3.0])
@pytest.mark.parametrize("offset", [-2.0, -0.6, 0.1, 0.8, 2.5])
def test_a_camera_with_coarse_steps_gives_the_same_image_twice_and_is_searched_all_the_same(
    step: float, offset: float
) -> None:
    curve = tent(6.0)
    noise = iter(np.random.default_rng(1).normal(0.0, 0.001, 20))

    def coarse(stops: float) -> float:
        return curve(round(stops / step) * step) + float(next(noise))

    search = run_search(coarse, 6.0 + offset, math.copysign(max(abs(offset) * 0.75, 0.9), -offset))
    assert curve(round(search.best / step) * step) >= max(curve(k * step) for k in range(49)) - 0.05


# Measured in the simulated hall with sun in patches: steps of 0.2 stops from 2 on.
TWO_PEAKS = [
    12.33, 12.5, 12.65, 12.81, 12.96, 13.12, 13.27, 13.31, 13.02, 13.04, 13.14, 13.24, 13.3, 13.36, 13.43, 13.42,
    13.02, 12.62, 12.01, 11.51, 10.01, 8.17, 7.7, 7.58, 7.35, 6.98, 6.74, 6.53, 5.9, 4.67,
]  # fmt: skip


def sun_and_shade(stops: float) -> float:
    return float(np.interp(stops, 2.0 + 0.2 * np.arange(len(TWO_PEAKS)), TWO_PEAKS))


FIRST_STEPS = np.arange(-3.6, -1.3, 0.1).round(1).tolist()


@pytest.mark.parametrize("first_step", FIRST_STEPS)
def test_of_two_peaks_of_sun_and_shade_the_higher_one_is_found(first_step: float) -> None:
    search = run_search(sun_and_shade, 5.7, first_step)
    assert len(search.tried) <= 8
    assert sun_and_shade(search.best) >= max(TWO_PEAKS) - 0.05


def test_the_paper_s_single_climb_may_end_at_the_lower_one() -> None:
    climb = SearchSettings(elsewhere_nats=None)
    ends = [sun_and_shade(run_search(sun_and_shade, 5.7, first, climb).best) for first in FIRST_STEPS]
    assert min(ends) < max(TWO_PEAKS) - 0.05


def test_impossible_searches_are_refused() -> None:
    with pytest.raises(InputError, match="no length"):
        EntropySearch(1.0, (2.0, 2.0), 0.5, SearchSettings())
    with pytest.raises(InputError, match="lead somewhere"):
        EntropySearch(1.0, (0.0, 2.0), 0.0, SearchSettings())


# --- the control ------------------------------------------------------------------------------------------------------


class FlatCamera:
    """A scene of smooth brightness under a lamp; the middle is the robot's own grey top."""

    def __init__(self, lamp: float) -> None:
        self.lamp = lamp
        self.set_to: list[tuple[float, float]] = []
        rng = np.random.default_rng(3)
        self._scene = rng.uniform(0.1, 1.0, (480, 480, 3))
        self._scene[230:250, 230:250] = 0.3

    def set(self, exposure_ms: float, gain: float) -> None:
        self.set_to.append((exposure_ms, gain))

    def grab(self) -> ImageArray:
        exposure_ms, gain = self.set_to[-1]
        value = np.clip(self._scene * self.lamp * exposure_ms * gain / 100.0, 0.0, 1.0)
        image: ImageArray = np.rint(255.0 * value ** (1.0 / 2.2)).astype(np.uint8)
        return image


def control_of(camera: FlatCamera, **settings: object) -> ExposureControl:
    chosen = ExposureSettings.model_validate({"check_every": 1} | settings)
    return ExposureControl(camera, mirror_masks(mirror_camera()), chosen)


def test_the_robot_waits_from_the_start_until_the_peak_is_found() -> None:
    camera = FlatCamera(lamp=1.0)
    control = control_of(camera)
    assert control.waiting
    steps = 0
    while control.waiting:
        control.step()
        steps += 1
    assert steps == len(control.tried) <= 8
    assert control.exposure_ms * control.gain == pytest.approx(100.0, rel=0.25)  # the brightest is white at 100
    best = max(control.tried, key=lambda tried: tried.entropy)
    assert camera.set_to[-1] == (best.exposure_ms, best.gain) == (control.exposure_ms, control.gain)


@pytest.mark.parametrize("lamp", [0.25, 5.0])
def test_changed_light_starts_a_search_in_its_direction(lamp: float) -> None:
    camera = FlatCamera(lamp=1.0)
    control = control_of(camera)
    control.optimise()
    before = control.exposure_ms * control.gain
    control.step()
    control.step()
    assert not control.waiting
    camera.lamp = lamp
    control.step()
    assert control.waiting
    control.step()
    assert (control.tried[1].stops - control.tried[0].stops) * (1.0 - lamp) > 0.0
    while control.waiting:
        control.step()
    assert len(control.tried) <= 8
    assert control.exposure_ms * control.gain == pytest.approx(before / lamp, rel=0.3)


def test_little_changes_are_left_alone_and_checked_only_now_and_then() -> None:
    camera = FlatCamera(lamp=1.0)
    control = control_of(camera, check_every=4)
    control.optimise()
    control.step()
    camera.lamp = 1.04
    for _ in range(8):
        control.step()
        assert not control.waiting
    camera.lamp = 3.0
    waited = [control.waiting for _ in range(4) if control.step() is not None]
    assert waited == [False, False, False, True]


@pytest.mark.parametrize(
    ("watch", "now", "direction"),
    [
        (Watch.CENTRE, (80.0, 150.0, 0.02), 1),
        (Watch.CENTRE, (100.0, 200.0, 0.5), 0),
        (Watch.FIELD, (60.0, 152.0, 0.02), 0),
        (Watch.FIELD, (60.0, 190.0, 0.02), -1),
        (Watch.BOTH, (80.0, 200.0, 0.02), -1),  # the top darkens in the shadow, the field brightens more
        (Watch.BOTH, (130.0, 150.0, 0.02), -1),
        (Watch.BOTH, (99.0, 152.0, 0.22), -1),  # patches of sun between shadows: only the overexposed tell
        (Watch.BOTH, (101.0, 149.0, 0.04), 0),
    ],
)
def test_what_is_watched_decides(watch: Watch, now: tuple[float, float, float], direction: int) -> None:
    control = control_of(FlatCamera(1.0), watch=watch)
    step = control.wanted_step(np.array([100.0, 150.0, 0.02]), np.array(now))
    assert np.sign(step) == direction


def test_the_paper_s_rule_has_steps_of_one_length_and_no_overexposed_pixels() -> None:
    settings = {"watch": Watch.CENTRE, "overexposed_threshold": None, "search": {"step_from_brightness": False}}
    control = control_of(FlatCamera(1.0), **settings)
    assert control.wanted_step(np.array([100.0, 150.0, 0.0]), np.array([20.0, 20.0, 0.0])) == 0.9
    assert control.wanted_step(np.array([100.0, 150.0, 0.0]), np.array([100.0, 250.0, 1.0])) == 0.0


def test_a_senseless_start_is_refused() -> None:
    with pytest.raises(InputError, match="start_ms"):
        ExposureControl(FlatCamera(1.0), mirror_masks(mirror_camera()), start_ms=0.0)


# --- a USB camera -----------------------------------------------------------------------------------------------------


class FakeCapture:
    """What OpenCV offers of a camera."""

    def __init__(self, opened: bool = True, obeys: bool = True, frames: int = 100) -> None:
        self.opened, self.obeys, self.frames = opened, obeys, frames
        self.settings: dict[int, float] = {}
        self.grabbed = 0

    def isOpened(self) -> bool:
        return self.opened

    def set(self, setting: int, value: float) -> bool:
        self.settings[setting] = value
        return self.obeys

    def grab(self) -> bool:
        self.grabbed += 1
        return True

    def read(self) -> tuple[bool, ImageArray | None]:
        self.frames -= 1
        return (True, np.zeros((4, 4, 3), np.uint8)) if self.frames >= 0 else (False, None)


def test_a_usb_camera_is_set_in_its_driver_s_units() -> None:
    import cv2

    capture = FakeCapture()
    camera = UvcCamera(0, gain_units=(16.0, 32.0), stale_images=2, capture=capture)
    camera.set(12.5, 2.0)
    assert capture.settings == {cv2.CAP_PROP_AUTO_EXPOSURE: 1.0, cv2.CAP_PROP_EXPOSURE: 125, cv2.CAP_PROP_GAIN: 48}
    assert camera.grab().shape == (4, 4, 3)
    assert capture.grabbed == 2  # the images exposed before the change are thrown away


def test_a_usb_camera_that_fails_says_so() -> None:
    with pytest.raises(InputError, match="cannot be opened"):
        UvcCamera(3, capture=FakeCapture(opened=False))
    with pytest.raises(TouchlineError, match="refuses manual exposure"):
        UvcCamera(3, capture=FakeCapture(obeys=False))
    with pytest.raises(TouchlineError, match="no image any more"):
        UvcCamera(3, capture=FakeCapture(frames=0)).grab()
    with pytest.raises(InputError, match="positive"):
        UvcCamera(3, capture=FakeCapture()).set(0.0, 1.0)
