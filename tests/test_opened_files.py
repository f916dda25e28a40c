"""Files are opened safely: only regular ones, of a bounded size, and nothing that brings a parser or a decoder down."""

from __future__ import annotations

import io
import os
import socket
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from touchline.camera import open_camera
from touchline.config import load_settings
from touchline.errors import InputError
from touchline.evaluation.estimates import read_estimates
from touchline.evaluation.tum import read_tum
from touchline.field import open_field
from touchline.files.arrays import stored_array
from touchline.files.images import MEGAPIXELS_VARIABLE, image_size, jpeg_header, read_image
from touchline.files.opened import MAX_LINE, UnreadableError, open_bytes, read_bytes, text_lines
from touchline.files.yaml_text import read_yaml, yaml_line
from touchline.localization.one_shot.points_file import read_points
from touchline.perception.colour import ColourModel
from touchline.perception.colour_file import load_colours, save_colours
from touchline.sources.decoding import decode_image
from touchline.sources.tables import open_table
from touchline.sources.truth import read_truth
from touchline.systems import SYSTEMS

# --- what is opened ---------------------------------------------------------------------------------------------------

READERS: list[Callable[[Path], object]] = [
    open_bytes,
    read_yaml,
    read_image,
    read_points,
    read_tum,
    read_estimates,
    load_colours,
    open_camera,
    lambda path: read_truth(path, np.zeros(0, dtype=np.int64), None),  # type: ignore[arg-type]
    lambda path: open_table(path, ["t"]),
]


@pytest.mark.parametrize("reader", READERS)
def test_only_regular_files_are_opened(tmp_path: Path, reader: Callable[[Path], object]) -> None:
    """A pipe without a writer would wait for ever, /dev/zero fill the memory."""
    os.mkfifo(tmp_path / "pipe")
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(tmp_path / "socket"))
    (tmp_path / "link").symlink_to("/dev/zero")
    for path, what in (
        (tmp_path / "pipe", "a named pipe"),
        (tmp_path / "socket", "a socket"),
        (tmp_path / "link", "a device"),
        (tmp_path, "Is a directory"),
        (tmp_path / "nowhere", "No such file"),
        (tmp_path / "a\0b", "cannot be read"),
    ):
        with pytest.raises(InputError, match=what):
            reader(path)


def test_no_more_than_fits_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(bytes(1001))
    assert len(read_bytes(path, 1001)) == 1001
    with pytest.raises(UnreadableError, match=r"larger than 0.001 MB"):
        read_bytes(path, 1000)
    with pytest.raises(UnreadableError, match="larger than"):  # it claims to be empty, and is not
        read_bytes(Path("/proc/self/smaps"), 1000)


def test_a_line_without_an_end_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("\ufefft\n" + "x" * MAX_LINE + "\n1\n")
    with pytest.raises(UnreadableError, match=f"line 2 is longer than {MAX_LINE} characters"):
        list(text_lines(path))
    path.write_text("\ufefft\r\n1", newline="")
    assert list(text_lines(path)) == ["t\n", "1"]
    path.write_bytes(b"t\n\xff")
    with pytest.raises(UnreadableError, match="is not a text file"):
        list(text_lines(path))


# --- YAML -------------------------------------------------------------------------------------------------------------


def aliases(levels: int, each: int, merged: bool = False) -> str:
    """Lists or mappings of which each names the one before `each` times."""
    first, start, end = ("{x: 1}", "{<<: [", "]}") if merged else ("[x]", "[", "]")
    rows = [f"a{i}: &a{i} {start}{','.join([f'*a{i - 1}'] * each)}{end}" for i in range(1, levels)]
    return "\n".join([f"a0: &a0 {first}", *rows])


BOMBS = {
    "brackets": ("a: " + "[" * 50_000 + "]" * 50_000, "line 1: is nested deeper than 100 levels"),
    "indentation": ("\n".join(" " * i + "a:" for i in range(200)), "line 101: is nested deeper than 100"),
    "many aliases": (f"a: &a 1\nb: [{'*a,' * 51}]", r"line 2: holds more than 50 aliases \(\*a\)"),
    "lists of lists": (aliases(17, 3), "line .*with its aliases written out it is larger than 1 MB"),
    "merged mappings": (aliases(17, 3, merged=True), "written out it is larger than 1 MB"),
    "long text": ("a: &a " + "x" * 30_000 + f"\nb: [{'*a,' * 49}]", "written out it is larger than 1 MB"),
    "itself": ("a: &a [*a]", r"line 1: \*a stands inside of what it stands for"),
    "many values": ("[" + "1," * 200_001 + "]", "holds more than 200000 values"),
    "large": ("#" * 1_000_001, "is larger than 1 MB"),
    "directives": ("%TAG !a! x\n" * 60_000 + "---\na: 1", "more than 10 lines that begin with %"),
    "large integer": ("a: 1\nb: " + "9" * 5000, r"line 2: holds a value that cannot be read \(99999"),
    "integer of 70 bits": ("a: 1\nb: [0x400000000000000000]", r"line 2: the number 0x4000\S*… is too large"),
    "no date": ("a: 1\nb: !!timestamp x", r"line 2: holds a value that cannot be read \(x\)"),
    "code": ("a: !!python/object/apply:os.system ['false']", "line 1: is not valid YAML"),
}


@pytest.mark.parametrize(("text", "what"), BOMBS.values(), ids=BOMBS.keys())
def test_yaml_that_would_take_a_parser_down_is_refused_in_words(tmp_path: Path, text: str, what: str) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=rf"^{path}(: |, ).*{what}") as refused:
        read_yaml(path)
    assert len(str(refused.value)) < 400
    with pytest.raises(InputError):
        open_field(path)
    yaml_line(path, ["a", 0])  # says where an error is, and must not be one


def test_a_setting_on_the_command_line_is_bounded_as_well() -> None:
    settings = next(iter(SYSTEMS.values())).settings
    with pytest.raises(InputError, match=r"--set a=\[.*nested deeper than 100 levels") as refused:
        load_settings(settings, None, ["a=" + "[" * 50_000])
    assert len(str(refused.value)) < 400


def test_brackets_in_text_and_comments_are_none(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    rows = ['a: "' + "[{" * 200 + '"', "b: '" + "[''" * 200 + "' # " + "{" * 200, "c: |", "  " + "[" * 200]
    rows += ["d: it's [" + "[" * 200, "e: &x [1, 2]", f"f: [{'*x, ' * 50}]", "g: " + "[" * 99 + "]" * 99]
    path.write_text("\n".join(rows))
    loaded = read_yaml(path)
    assert loaded["a"] == "[{" * 200
    assert loaded["f"] == [[1, 2]] * 50


# --- images -----------------------------------------------------------------------------------------------------------


def png(width: int, height: int, bits: int = 8) -> bytes:
    """A PNG file that claims a size, with hardly any pixels."""

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = struct.pack(">IIBBBBB", width, height, bits, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(bytes(100))) + chunk(b"IEND", b"")
    )


@pytest.mark.parametrize("ending", [".png", ".jpg", ".bmp", ".tiff", ".webp", ".ppm", ".pbm"])
def test_the_size_is_read_from_the_header_of_every_format(tmp_path: Path, ending: str) -> None:
    pixels = np.random.default_rng(1).integers(0, 256, (37, 53, 3), dtype=np.uint8)
    picture = pixels if ending not in (".pgm", ".pbm") else pixels[:, :, 0]
    code = cv2.imencode(ending, picture)[1].tobytes()
    assert image_size(code) == (53, 37)
    (tmp_path / "a").write_bytes(code)
    assert read_image(tmp_path / "a").shape == (37, 53, 3)
    for end in range(0, 30, 3):
        image_size(code[:end])  # the header may be cut anywhere
    if ending == ".webp":
        lossless = cv2.imencode(ending, picture, [cv2.IMWRITE_WEBP_QUALITY, 101])[1].tobytes()
        alpha = cv2.imencode(ending, np.dstack((picture, picture[:, :, 0])))[1].tobytes()
        assert image_size(lossless) == image_size(alpha) == (53, 37)


def test_headers_of_other_writers_are_read_as_well() -> None:
    assert image_size(b"P5\n# a remark\n640 # another\n 480\n255\n" + bytes(640 * 480)) == (640, 480)
    top_down = struct.pack("<IiiHHIIiiII", 40, 640, -480, 1, 24, 0, 0, 0, 0, 0, 0)
    assert image_size(b"BM" + bytes(8) + struct.pack("<I", 54) + top_down) == (640, 480)
    assert image_size(b"BM" + bytes(8) + struct.pack("<IIHHHH", 26, 12, 640, 480, 1, 24)) == (640, 480)
    rows = ((0x0100, 4, 640), (0x0101, 3, 480 << 16), (0x0102, 3, 8 << 16), (0x0103, 3, 1 << 16), (0x0106, 3, 1 << 16))
    for more, size in ((((273, 4, 8),), (640, 480)), (((322, 4, 9000), (323, 4, 16), (324, 4, 8)), (9000, 480))):
        tags = b"".join(struct.pack(">HHII", tag, kind, 1, value) for tag, kind, value in rows + more)
        assert image_size(b"MM\0*" + struct.pack(">IH", 8, len(rows + more)) + tags + bytes(4)) == size
    thumbnail = b"\xff\xe1" + struct.pack(">H", 13) + b"\xff\xc0\0\x0b\x08\0\x09\0\x09\0\0"
    jpeg = cv2.imencode(".jpg", np.zeros((480, 640), np.uint8))[1].tobytes()
    assert image_size(jpeg[:2] + thumbnail + b"\xff" + jpeg[2:]) == (640, 480)
    progressive = cv2.imencode(".jpg", np.zeros((480, 640), np.uint8), [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes()
    assert image_size(progressive) == (640, 480)
    bare = jpeg[:2] + b"\xff\x01\xff\xd0\xff\xff\xd8" + jpeg[2:]  # markers that no length follows
    assert jpeg_header(bare) == (jpeg_header(jpeg).size, (jpeg_header(jpeg).scan or 0) + 7)
    assert image_size(jpeg[: jpeg.index(b"\xff\xda")].replace(b"\xff\xc0", b"\xff\xc4")) is None


def test_images_that_claim_to_be_huge_are_not_decoded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(png(30_000, 30_000))
    monkeypatch.setattr(cv2, "imdecode", None)
    with pytest.raises(InputError, match=r"a\.png: is 30000×30000 pixels; a side may have 20000"):
        read_image(path)
    path.write_bytes(png(19_000, 3_000))
    with pytest.raises(InputError, match=rf"19000×3000 pixels, more than 50 megapixels; {MEGAPIXELS_VARIABLE} sets"):
        read_image(path)
    assert "more than 50 megapixels" in decode_image(path).what
    assert decode_image(path, (640, 480)).what == "is 19000×3000 pixels, expected 640×480"
    path.write_bytes(b"GIF89a" + bytes(20))
    with pytest.raises(InputError, match="is not an image that can be decoded"):
        read_image(path)


def test_how_large_an_image_may_be_can_be_set(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(cv2.imencode(".png", np.zeros((100, 100), np.uint8))[1].tobytes())
    monkeypatch.setenv(MEGAPIXELS_VARIABLE, "0.009")
    with pytest.raises(InputError, match=r"more than 0\.009 megapixels"):
        read_image(path)
    path.write_bytes(path.read_bytes() + bytes(36_000))
    with pytest.raises(InputError, match=rf"larger than 0.036 MB.*{MEGAPIXELS_VARIABLE}"):
        read_image(path)
    monkeypatch.setenv(MEGAPIXELS_VARIABLE, "many")
    with pytest.raises(InputError, match=f"{MEGAPIXELS_VARIABLE}=many: expected a number of megapixels up to 400"):
        read_image(path)


# --- archives ---------------------------------------------------------------------------------------------------------


def colours_with(tmp_path: Path, name: str, data: bytes) -> Path:
    """A colour table of which one member holds something else."""
    model = ColourModel(np.zeros((64, 64, 64), np.uint8), np.zeros(3), np.zeros(3), 1.0, np.zeros(3))
    good, bad = tmp_path / "good.npz", tmp_path / "bad.npz"
    if not good.exists():
        save_colours(model, good)
    load_colours(good)
    with zipfile.ZipFile(io.BytesIO(good.read_bytes())) as old, zipfile.ZipFile(bad, "w", zipfile.ZIP_DEFLATED) as new:
        for member in old.namelist():
            new.writestr(member, data if member == f"{name}.npy" else old.read(member))
    return bad


def npy(shape: str, kind: str = "'<f8'", body: bytes = bytes(64)) -> bytes:
    header = f"{{'descr': {kind}, 'fortran_order': False, 'shape': {shape}, }}".encode().ljust(117) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + body


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (bytes(50_000_000), "'noise' has 50000000 bytes, more than"),
        (npy("(100000, 12000)"), r"'noise' has shape \(100000, 12000\), expected \(\)"),
        (npy("()", "'|O'"), "is not a colour table"),
        (npy("()", "'|V1000000000'"), "'noise' has shape"),
        (npy("("), "is not a colour table"),
        (b"no array", "is not a colour table"),
        (npy("()", "'<f8'", b""), "is not a colour table"),
        (npy("()", "'<U4'", "abcd".encode("utf-32-le")), "'noise' holds something else than numbers"),
    ],
)
def test_an_archive_with_something_else_inside_is_refused(tmp_path: Path, data: bytes, what: str) -> None:
    path = colours_with(tmp_path, "noise", data)
    with pytest.raises(InputError, match=rf"^{path}: .*{what}"):
        load_colours(path)


def test_an_array_that_claims_gigabytes_is_not_made_room_for() -> None:
    written = io.BytesIO()
    with zipfile.ZipFile(written, "w") as archive:
        archive.writestr("rows.npy", npy("(99999999999,)"))
    with zipfile.ZipFile(written) as archive, pytest.raises(InputError, match="'rows' claims 799999999992 bytes"):
        stored_array(archive, "rows", (None,), 1000)
