"""Files that would cost far more than they hold: written by the libraries, refused or left out at once."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
import zstandard
from foreign_bags import EPOCH_NS, Types, cloud, write_foreign
from mcap.opcode import Opcode

from touchline.camera.model_free import table_radii
from touchline.errors import InputError
from touchline.live.datagrams import Datagrams
from touchline.sources import BagOptions, open_source
from touchline.sources.bags.mcap_file import MAGIC, McapBag
from touchline.sources.problems import ProblemLog

FIELD = BagOptions(field="spl-9x6")


def chunk(compression: bytes, packed: bytes, full_size: int, length: int | None = None) -> bytes:
    name = struct.pack("<I", len(compression) if length is None else length) + compression
    body = struct.pack("<QQQI", 0, 0, full_size, 0) + name + struct.pack("<Q", len(packed)) + packed
    return struct.pack("<BQ", Opcode.CHUNK, len(body)) + body


def problems_of(path: Path) -> list[str]:
    log = ProblemLog()
    list(McapBag([path], log).messages(["/image"]))
    return [str(problem) for problem in log]


def test_a_chunk_of_zeros_is_left_out_unread(tmp_path: Path) -> None:
    size = 500_000_000
    packer = zstandard.ZstdCompressor().compressobj()
    packed = b"".join([packer.compress(bytes(1_000_000)) for _ in range(20)]) + packer.flush()
    path = tmp_path / "zeros.mcap"
    path.write_bytes(MAGIC + chunk(b"zstd", packed, size) * 3)
    assert sum("it would hold 500 MB, packed in" in each for each in problems_of(path)) == 3


def test_zeros_are_no_records(tmp_path: Path) -> None:
    """As many as fit into a chunk that is small enough end at the first one."""
    path = tmp_path / "zeros.mcap"
    path.write_bytes(MAGIC + chunk(b"zstd", zstandard.compress(bytes(8_000_000)), 8_000_000))
    assert problems_of(path) == [
        "zeros.mcap: ends early, at byte " + f"{path.stat().st_size}: 0 messages before it can be read"
    ]


def test_a_compression_s_name_without_an_end_is_damage(tmp_path: Path) -> None:
    path = tmp_path / "name.mcap"
    path.write_bytes(MAGIC + chunk(b"zstd", b"", 100, length=2**31))
    assert any("the name of its compression has no end" in each for each in problems_of(path))


def test_a_packed_rosbag2_that_unpacks_to_far_more_is_refused(tmp_path: Path) -> None:
    types = Types()
    folder = write_foreign(tmp_path / "bag", iter([cloud(types, EPOCH_NS, "eye", [(1.0, 0.0, 0.0)])]), types)
    (file,) = folder.glob("*.db3")
    packed = file.with_name(f"{file.name}.zstd")
    packed.write_bytes(zstandard.compress(bytes(70_000_000)))
    text = (folder / "metadata.yaml").read_text().replace(file.name, packed.name)
    text = text.replace("compression_format: ''", "compression_format: zstd").replace(
        "compression_mode: ''", "compression_mode: file"
    )
    (folder / "metadata.yaml").write_text(text)
    file.unlink()
    with pytest.raises(InputError, match="unpacks to more than 64 MB"):
        open_source(folder, options=FIELD)


def test_kinds_of_refused_messages_that_a_sender_makes_up_are_bounded() -> None:
    datagrams = Datagrams()
    for number in range(5000):
        datagrams.read(b'{"kind": "evidence", "source": "x", "probability": %d.5}' % number)
        datagrams.read(b'{"kind": "seen", "stamp_ns": 1, "rows": [{"kind": "L%d"}]}' % number)
    assert len(datagrams.refused) <= 21
    assert sum(datagrams.refused.values()) >= 5000


def test_a_mirror_that_is_tilted_too_far_is_told() -> None:
    radii = np.full((8, 15), np.nan)
    with pytest.raises(InputError, match="tilted too far"):
        table_radii(radii, np.ones(15))
