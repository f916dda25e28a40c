"""A camera at this machine, beside whatever link brings the sensors."""

import threading
import time
from typing import Protocol

from touchline.errors import TouchlineError
from touchline.live.heard import Heard, Link, Published, Sight
from touchline.types import ImageArray

_WAIT_S = 0.002  # for the link, so that an image does not wait for it


class Grabber(Protocol):
    """A camera that gives images: `touchline.sources.uvc_camera.UvcCamera`, or anything like it."""

    def grab(self) -> ImageArray:
        """The next image (H, W, 3) BGR. Raises TouchlineError if there is none any more."""

    def close(self) -> None:
        """Let go of it."""


class WithCamera:
    """A link and a camera as one link. Images are stamped by time.time_ns at their arrival, as ROS stamps messages.

    The newest image waits to be heard; those before it, that nobody had time for, are gone, and counted.
    """

    def __init__(self, link: Link, camera: Grabber) -> None:
        self._link, self._camera = link, camera
        self._newest: Sight | None = None
        self._failure: TouchlineError | None = None
        self._lock = threading.Lock()
        self._ended, self._overwritten = False, 0
        self._thread = threading.Thread(target=self._grab_all, name="camera", daemon=True)
        self._thread.start()

    def _grab_all(self) -> None:
        while not self._ended:
            try:
                image = self._camera.grab()
            except TouchlineError as error:
                self._failure = error
                return
            with self._lock:
                self._overwritten += self._newest is not None
                self._newest = Sight(time.time_ns(), time.monotonic(), image)

    def hear(self, timeout_s: float) -> list[Heard]:
        """What the link brings, and the newest image. Raises TouchlineError once the camera gives none any more."""
        if self._failure is not None:
            raise self._failure
        found = self._link.hear(min(timeout_s, _WAIT_S))
        with self._lock:
            image, self._newest = self._newest, None
        return found if image is None else [*found, image]

    def publish(self, published: Published) -> None:
        """As the link does."""
        self._link.publish(published)

    @property
    def refused(self) -> dict[str, int]:
        """As the link has it, and the camera's images that were not asked for before the next one came."""
        gone = self._overwritten
        return {**self._link.refused, **({"an image of the camera that nobody had time for": gone} if gone else {})}

    def around(self) -> str:
        """As the link says."""
        return self._link.around()

    def close(self) -> None:
        """Let go of both."""
        self._ended = True
        self._thread.join(timeout=1.0)
        self._camera.close()
        self._link.close()
