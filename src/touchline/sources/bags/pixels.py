"""The pixels of sensor_msgs/Image, of whatever encoding, as OpenCV has them."""

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from touchline.files.images import ImageSize, too_large

Pixels = npt.NDArray[Any]

# name -> bytes per channel, channels, conversion to B, G, R (None: they are). The names of Bayer patterns are those of
# ROS, which tell the first two pixels of the first row; OpenCV's tell those of the second row from the second on.
_ENCODINGS: dict[str, tuple[int, int, int | None]] = {
    "bgr8": (1, 3, None),
    "8UC3": (1, 3, None),
    "rgb8": (1, 3, cv2.COLOR_RGB2BGR),
    "bgra8": (1, 4, cv2.COLOR_BGRA2BGR),
    "8UC4": (1, 4, cv2.COLOR_BGRA2BGR),
    "rgba8": (1, 4, cv2.COLOR_RGBA2BGR),
    "mono8": (1, 1, cv2.COLOR_GRAY2BGR),
    "8UC1": (1, 1, cv2.COLOR_GRAY2BGR),
    "bgr16": (2, 3, None),
    "16UC3": (2, 3, None),
    "rgb16": (2, 3, cv2.COLOR_RGB2BGR),
    "mono16": (2, 1, cv2.COLOR_GRAY2BGR),
    "16UC1": (2, 1, cv2.COLOR_GRAY2BGR),
    "yuv422": (1, 2, cv2.COLOR_YUV2BGR_UYVY),
    "uyvy": (1, 2, cv2.COLOR_YUV2BGR_UYVY),
    "yuv422_yuy2": (1, 2, cv2.COLOR_YUV2BGR_YUYV),
    "yuyv": (1, 2, cv2.COLOR_YUV2BGR_YUYV),
}
# name -> conversion of two planes, brightness and U, V beside each other; rows of U, V to one of brightness
_PLANES = {"nv12": (cv2.COLOR_YUV2BGR_NV12, 0.5), "nv21": (cv2.COLOR_YUV2BGR_NV21, 0.5), "nv24": (None, 2.0)}
_BGR_FROM_YUV = np.array([[1.164, 2.017, 0.0], [1.164, -0.392, -0.813], [1.164, 0.0, 1.596]])  # ITU-R BT.601
_BAYER = {
    "bayer_rggb": cv2.COLOR_BayerBG2BGR,
    "bayer_bggr": cv2.COLOR_BayerRG2BGR,
    "bayer_gbrg": cv2.COLOR_BayerGR2BGR,
    "bayer_grbg": cv2.COLOR_BayerGB2BGR,
}
_ENCODINGS |= {f"{name}{8 * size}": (size, 1, code) for name, code in _BAYER.items() for size in (1, 2)}


def image_pixels(message: Any) -> Pixels | str:
    """(H, W, 3) B, G, R of a sensor_msgs/Image, or why there are none."""
    width, height, step = int(message.width), int(message.height), int(message.step)
    if message.encoding not in _ENCODINGS and message.encoding not in _PLANES:
        known = ", ".join(sorted((*_ENCODINGS, *_PLANES)))
        return f"has the encoding '{message.encoding:.30}', which is not known ({known})"
    if (what := too_large(ImageSize(width, height))) is not None:
        return what
    if message.encoding in _PLANES:
        return _of_planes(message.encoding, np.asarray(message.data, dtype=np.uint8), (width, height), step)
    size, channels, code = _ENCODINGS[message.encoding]
    line, data = width * channels * size, np.asarray(message.data, dtype=np.uint8)
    if min(width, height) < 1 or step < line or len(data) < step * (height - 1) + line:
        return f"holds {len(data)} bytes, too few for {width}×{height} pixels of {message.encoding}"
    rows = np.lib.stride_tricks.as_strided(data, (height, line), (step, 1))
    shape = (height, width) if channels == 1 else (height, width, channels)
    kind = "u1" if size == 1 else ">u2" if message.is_bigendian else "<u2"
    pixels = np.ascontiguousarray(rows).view(kind).reshape(shape)
    if size == 2:
        pixels = pixels.astype(np.uint16, copy=False)
    if code is None:
        return pixels
    try:
        return np.asarray(cv2.cvtColor(pixels, code))
    except cv2.error:
        return f"cannot be converted from {message.encoding}"


def _of_planes(encoding: str, data: Pixels, size: tuple[int, int], step: int) -> Pixels | str:
    """Planes of rows `step` bytes apart, U and V at half the resolution, or at the full one (nv24)."""
    (width, height), (code, ratio) = size, _PLANES[encoding]
    rows = height + int(height * ratio)
    if min(width, height) < 2 or step < width or len(data) < step * rows or (code is not None and (width | height) % 2):
        return f"holds {len(data)} bytes in rows of {step}, not those of {width}×{height} pixels of {encoding}"
    planes = data[: step * rows].reshape(rows, step)
    if code is not None:
        return np.asarray(cv2.cvtColor(np.ascontiguousarray(planes[:, :width]), code))
    colours = planes[height:].reshape(height, 2 * step)[:, : 2 * width].reshape(height, width, 2)
    matrix = np.column_stack((_BGR_FROM_YUV, _BGR_FROM_YUV @ (-16.0, -128.0, -128.0)))
    return np.asarray(cv2.transform(np.dstack((planes[:height, :width], colours)), matrix))


def is_bayer(compressed_format: str) -> bool:
    """Whether a compressed image holds a Bayer pattern: `bayer_rggb8; jpeg compressed bayer_rggb8`."""
    return _pattern(compressed_format) in _BAYER and "compressed bayer" in compressed_format


def demosaiced(pixels: Pixels, compressed_format: str) -> Pixels:
    """(H, W, 3) B, G, R of the decoded pixels of a Bayer pattern."""
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(pixels[..., 0]), _BAYER[_pattern(compressed_format)]))


def _pattern(compressed_format: str) -> str:
    return compressed_format.partition(";")[0].strip().rstrip("0123456789")
