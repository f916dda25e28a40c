"""Files that would cost far more than they hold: written by the libraries, refused or left out at once."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.opcode import Opcode

from touchline.camera.model_free import table_radii
from touchline.errors import InputError
from touchline.live.datagrams import Datagrams
from touchline.sources import open_source


def test_a_chunk_that_would_hold_more_than_memory_is_left_out(tmp_path: Path) -> None:
    packed = zstandard.ZstdCompressor(write_content_size=False).compress(bytes(1000))
    body = struct.pack("<QQQI", 0, 0, 10**12, 0) + struct.pack("<I4sQ", 4, b"zstd", len(packed)) + packed
    path = tmp_path / "zeros.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + struct.pack("<BQ", Opcode.CHUNK, len(body)) + body)
    with pytest.raises(InputError, match="it would hold 1000000 MB"):
        open_source(path)


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
