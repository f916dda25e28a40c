"""Exposure control by image entropy: camera settings that show the most, kept while the light changes.

Section 5 of Lu et al. (2013). The robot's own top is in the middle of every image: when its mean brightness moves, the
light has changed, and the settings are searched again. Meanwhile the robot has to stand: `ExposureControl.waiting`.
"""

import math
from typing import Protocol

import numpy as np
from pydantic import Field

from touchline.camera.base import Camera
from touchline.camera.exposure_search import EntropySearch, PathSettings, SearchSettings, Tried
from touchline.camera.omni import require_omni
from touchline.config import Settings, added
from touchline.enums import StrEnum
from touchline.errors import InputError
from touchline.geometry import BoolArray, FloatArray
from touchline.types import ImageArray

OVEREXPOSED = 250  # grey level from which a channel counts as overexposed


class ExposureCamera(Protocol):
    """Any camera that can be driven."""

    def set(self, exposure_ms: float, gain: float) -> None:
        """Use these settings from the next image on."""

    def grab(self) -> ImageArray:
        """An image (H, W, 3), B, G, R, taken with the settings set last."""


class Watch(StrEnum):
    """Whose mean brightness tells that the light has changed."""

    CENTRE = "centre"
    FIELD = "field"
    BOTH = "both"


class ExposureSettings(Settings):
    """When the light is believed to have changed, and how the search goes."""

    watch: Watch = added(
        Watch.BOTH,
        paper=Watch.CENTRE,
        description="whose mean brightness is watched: centre (the robot's own top, the paper), field, or both: under "
        "patches of sun the top can darken while the field gets brighter",
    )
    threshold: float = Field(
        0.15,
        gt=0,
        description="change of that mean, as a share of it, which starts a search: 0.15 is a third more light; "
        "driving over the field changes it by up to 0.1",
    )
    overexposed_threshold: float | None = added(
        0.08,
        paper=None,
        gt=0,
        description="change of the share of overexposed pixels of the field which starts a search, too, unless only "
        "the centre is watched; sun between shadows may leave every mean as it is. none: as in the paper",
    )
    whole_image: bool = added(
        False,
        paper=True,
        description="true as in the paper: entropy of the whole image; false: of the ring that shows the field, "
        "without the robot and what the mirror doesn't see",
    )
    check_every: int = Field(5, ge=1, description="images from one look at the brightness to the next")
    gamma: float = Field(2.2, ge=1, description="exponent between light and grey levels, for the first step's length")
    path: PathSettings = PathSettings()
    search: SearchSettings = SearchSettings()


def image_entropy(image: ImageArray, mask: BoolArray | None = None) -> float:
    """Entropy (nats) of an image (H, W, 3): that of its three histograms of 256 levels, added (eq. 5).

    mask: (H, W), pixels that count; all without it. Raises InputError if none counts.
    """
    pixels = image.reshape(-1, 3) if mask is None else image[mask]
    if len(pixels) == 0:
        raise InputError("image entropy: the mask leaves no pixel")
    total = 0.0
    for channel in pixels.T:
        counts = np.bincount(channel, minlength=256)
        shares = counts[counts > 0] / len(pixels)
        total -= float(shares @ np.log(shares))
    return total


def mirror_masks(camera: Camera) -> tuple[BoolArray, BoolArray]:
    """(H, W) pixels of the robot's own top, and of the field around it, as camera.yaml's radii divide them.

    Raises InputError for a camera that does not look at a mirror.
    """
    mirror = require_omni(camera, "the robot's own top is in the middle of images of")
    v, u = np.mgrid[0 : mirror.height, 0 : mirror.width]
    radius = np.hypot(u - mirror.center[0], v - mirror.center[1])
    return radius < 0.8 * mirror.inner_radius_px, (radius > mirror.inner_radius_px) & (radius < mirror.outer_radius_px)


class ExposureControl:
    """Drives a camera: `step` gives one image after the other and keeps the exposure right.

    centre, field: (H, W) masks, see `mirror_masks`; entropy is that of the field. tried: the images of the latest
    search. The first step starts a search, from `start_ms`, exposure times gain.
    """

    def __init__(
        self,
        camera: ExposureCamera,
        masks: tuple[BoolArray, BoolArray],
        settings: ExposureSettings | None = None,
        start_ms: float = 20.0,
    ) -> None:
        if not (math.isfinite(start_ms) and start_ms > 0.0):
            raise InputError(f"exposure control: start_ms must be positive, found {start_ms}")
        self.camera = camera
        self.settings = settings or ExposureSettings()
        self.tried: list[Tried] = []
        self._centre, self._field = masks
        self._reference: FloatArray | None = None
        self._since_check = 0
        self._search: EntropySearch | None = None
        self._stops = float(np.clip(math.log2(start_ms), *self.settings.path.stops_range))
        self.start_search(self.settings.search.step_stops)

    @property
    def waiting(self) -> bool:
        """Whether a search goes on: the robot has to stand still."""
        return self._search is not None

    @property
    def exposure_ms(self) -> float:
        """The exposure set now."""
        return self.settings.path.at(self._stops)[0]

    @property
    def gain(self) -> float:
        """The gain set now."""
        return self.settings.path.at(self._stops)[1]

    def start_search(self, first_step_stops: float) -> None:
        """Search from the settings of now, first in the direction of a step (stops, more than 0: more light)."""
        s = self.settings
        self._search = EntropySearch(self._stops, s.path.stops_range, first_step_stops, s.search)
        self.tried = []

    def start_at_rest(self) -> None:
        """Keep the settings of now, without a search. With the next image's brightness later ones are compared."""
        self._set(self._stops)
        self._search, self._reference, self._since_check = None, None, 0

    def step(self) -> ImageArray:
        """Take the next image: of the search while it goes on, else with the settings that it found."""
        if self._search is None:
            image = self.camera.grab()
            self._look_at(image)
            return image
        place = self._search.propose()
        if place is None:  # nothing was left to try at all
            self._finish()
            return self.step()
        image = self._try(place)
        if self._search.propose() is None:
            self._finish()
        return image

    def optimise(self) -> list[Tried]:
        """Run the search that is going on, or a new one, to its end. Returns the images it took."""
        if self._search is None:
            self.start_search(self.settings.search.step_stops)
        while self.waiting:
            self.step()
        return self.tried

    def brightness(self, image: ImageArray) -> FloatArray:
        """(3,) mean grey levels of the robot's own top and of the field, and the field's overexposed share."""
        grey = image.mean(axis=2)
        means = [float(grey[mask].mean()) if mask.any() else np.nan for mask in (self._centre, self._field)]
        return np.array([*means, float(np.mean(image[self._field].max(axis=1) >= OVEREXPOSED))])

    def _try(self, place: float) -> ImageArray:
        assert self._search is not None
        self._set(place)
        image = self.camera.grab()
        self._note(place, image)
        return image

    def _note(self, place: float, image: ImageArray) -> None:
        assert self._search is not None
        entropy = image_entropy(image, None if self.settings.whole_image else self._field)
        self._search.tell(place, entropy)
        self.tried.append(Tried(place, *self.settings.path.at(place), entropy))

    def _finish(self) -> None:
        assert self._search is not None
        self._stops = self._search.best
        self.start_at_rest()

    def _set(self, place: float) -> None:
        self._stops = place
        self.camera.set(*self.settings.path.at(place))

    def _look_at(self, image: ImageArray) -> None:
        """Compare an image's brightness with that after the last search; start another one if it has moved."""
        if self._reference is None:  # only the first image with the settings found tells what is right
            self._reference = self.brightness(image)
            return
        self._since_check += 1
        if self._since_check < self.settings.check_every:
            return
        self._since_check = 0
        step = self.wanted_step(self._reference, self.brightness(image))
        if step == 0.0:
            return
        self.start_search(step)
        assert self._search is not None
        place = self._search.propose()
        assert place is not None
        self._note(place, image)  # this image is the search's first: it was taken with the settings of now

    def wanted_step(self, before: FloatArray, now: FloatArray) -> float:
        """First step of a search (stops), 0 for none, from two `brightness` (3,).

        Brighter: less light; darker: more. Of the two means the one that has changed more decides.
        """
        s = self.settings
        overexposed = float(now[2] - before[2])
        watched = {Watch.CENTRE: [0], Watch.FIELD: [1], Watch.BOTH: [0, 1]}[s.watch]
        ratios = np.maximum(now[watched], 1.0) / np.maximum(before[watched], 1.0)
        ratios = ratios[np.isfinite(ratios)]
        if len(ratios) == 0 or np.abs(ratios - 1.0).max() <= s.threshold:
            watched_too = s.overexposed_threshold is not None and s.watch is not Watch.CENTRE
            if not watched_too or abs(overexposed) <= (s.overexposed_threshold or 0.0):
                return 0.0
            return -math.copysign(s.search.step_stops, overexposed)
        stops = -s.gamma * float(np.log2(ratios[np.argmax(np.abs(np.log(ratios)))]))
        length = s.search.step_stops
        if s.search.step_from_brightness:
            # of an image that is mostly overexposed the mean tells only that there is so much more light at least
            believed = max(abs(stops), 3.0) if now[2] > 0.5 else abs(stops)
            length = float(np.clip(believed, s.search.step_stops, s.search.longest_first_step_stops))
        return math.copysign(length, stops)
