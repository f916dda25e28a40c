"""Hostile inputs: a file's bytes, lines, numbers and YAML leaves changed as a seeded generator says."""

from __future__ import annotations

import io
import random
import re
import zipfile
from collections.abc import Callable, Sequence
from typing import Any

import yaml

_NUMBERS = (
    "nan inf -inf 1e400 -1e400 1e308 -1e308 1e-320 1e18 1e9 1e12 -1 0 -0 0.0 9223372036854775807 9223372036854775808 "
    "-9223372036854775809 18446744073709551616 4294967296 2147483648 200000 20001 1e5 3.4e38 1e39 0x7f 0o17 0b1 1_000 "
    "1:30:00 .5 5. + - e 1e 1e+ ١٢ １２ ² ½ 1,5 true null ~ NaN .nan .inf -.inf 2001-01-01 2001-99-99 "
    "2001-01-01T25:61:61Z"
)
NUMBERS = [*_NUMBERS.split(" "), "", " ", "9" * 400, "9" * 5000, "0." + "0" * 5000 + "1", "1e" + "9" * 30]
_WORDS = "[] {} [ { ' &a *a | > % @ ` --- ... !! ! ~ omni pinhole none point line boundary tracking msl-18x12 white"
WORDS = (
    *_WORDS.split(" "),
    *('"', "\x00", "\x1b[2J", "\ud7ff", "\u202e", "\u2028", "\ufeff", "<<: *a", "- - - -", "? :", "!!binary aGk="),
    *("!!python/object/apply:os.system ['true']", "!!python/name:os.system", "!!set {a, b}", "!!omap []", "!!float x"),
    *("!!int x", "!!bool x", "!!timestamp x", "!!str", "!x y", "[[1]]", "[1, [2]]", "{a: 1}"),
    *("../../evil", "/dev/zero", "/etc/passwd", "é" * 300),
)
LEAVES: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 2, 1.5, -1.5, 1e9, 1e12, 1e300, -1e300, 1e-300, float("nan"), float("inf")),
    *(10**20, 10**400, -(10**400), 2**63, 20000, 20001, 100000, "", "x", "1", "../x", "/dev/zero", "a" * 5000),
    *([], {}, [[]], [{}], {"a": []}, [1], [1, 2], [[1, 2]], [1, "x"], [10**400], [None], {1: 2}, {None: None}),
    *([0.0] * 2000, [[0.0] * 5] * 200, [[[[1.0]]]]),
)


def mutated(seeds: Sequence[bytes], rng: random.Random) -> bytes:
    """One of some files, changed in one to four places."""
    data = rng.choice(seeds)
    for _ in range(rng.choice((1, 1, 1, 2, 2, 3, 4))):
        data = rng.choice(_MUTATIONS)(data, rng)
    return data if rng.random() > 0.02 else _spliced(data, rng.choice(seeds), rng)


def _place(data: bytes | Sequence[Any], rng: random.Random) -> int:
    return rng.randrange(len(data) + 1)


def _spliced(data: bytes, other: bytes, rng: random.Random) -> bytes:
    return data[: _place(data, rng)] + other[_place(other, rng) :]


def _flip(data: bytes, rng: random.Random) -> bytes:
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 8))):
        if changed:
            changed[rng.randrange(len(changed))] = rng.choice((0, 255, 10, 44, 128, rng.randrange(256)))
    return bytes(changed)


def _insert(data: bytes, rng: random.Random) -> bytes:
    at = _place(data, rng)
    pieces = (b"\x00", b"\xff\xfe", b"\n", b"\r", b"\r\n", b",", b" ", b"\t", b"\xef\xbb\xbf", b'"', b"#")
    long = (b"a" * 140_000, b"9" * 70_000, b"[" * 20_000, b"- " * 5000, b"\n" * 20_000, b"a: &a [*a]\n")
    piece = rng.choice(pieces) if rng.random() < 0.85 else rng.choice(long)
    return data[:at] + piece + data[at:]


def _cut(data: bytes, rng: random.Random) -> bytes:
    first, last = sorted((_place(data, rng), _place(data, rng)))
    return data[:first] if rng.random() < 0.4 else data[:first] + data[last:]


def _repeat(data: bytes, rng: random.Random) -> bytes:
    first, last = sorted((_place(data, rng), _place(data, rng)))
    last = min(last, first + 2000)
    return data[:first] + data[first:last] * rng.choice((2, 3, 50)) + data[last:]


def _number(data: bytes, rng: random.Random) -> bytes:
    return _replaced(data, rb"[-+]?\d[\d.]*(?:[eE][-+]?\d+)?", rng.choice(NUMBERS).encode(), rng)


def _word(data: bytes, rng: random.Random) -> bytes:
    return _replaced(data, rb"[\w./-]+", rng.choice(WORDS).encode(errors="surrogatepass"), rng)


def _replaced(data: bytes, pattern: bytes, by: bytes, rng: random.Random) -> bytes:
    found = list(re.finditer(pattern, data[:200_000]))
    if not found:
        return data + by
    one = rng.choice(found)
    return data[: one.start()] + by + data[one.end() :]


def _lines(data: bytes, rng: random.Random) -> bytes:
    lines = data.split(b"\n")
    at, other = rng.randrange(len(lines)), rng.randrange(len(lines))
    kind = rng.randrange(8)
    if kind == 0:
        del lines[at]
    elif kind == 1:
        lines.insert(at, lines[other])
    elif kind == 2:
        lines[at], lines[other] = lines[other], lines[at]
    elif kind == 3:
        lines[at : at + 1] = [lines[at]] * rng.choice((10, 300))
    elif kind == 4:
        lines[at] = b"  " * rng.randrange(1, 60) + lines[at]
    elif kind == 5:
        lines[at] = lines[at].replace(b",", rng.choice((b";", b"\t", b",,", b'","', b" ")))
    elif kind == 6:
        lines[at] = lines[at] + lines[other]
    else:
        return rng.choice((b"\r", b"\r\n", b"\n\n", b"\x0b", "\u2028".encode())).join(lines)
    return b"\n".join(lines)


def _leaf(data: bytes, rng: random.Random) -> bytes:
    """Another value, or another key, somewhere in a YAML or JSON tree."""
    if len(data) > 20_000 or data.count(b"[") + data.count(b"- ") + data.count(b"{") > 300:  # it may be deep
        return _number(data, rng)
    try:
        tree = yaml.load(data, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
        places: list[tuple[Any, Any]] = []
        waiting = [tree]
        while waiting and len(places) < 5000:  # an alias may lead back to where it stands
            node = waiting.pop()
            keys = list(node) if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else ()
            places += [(node, key) for key in keys]
            waiting += [node[key] for key in keys]
        node, key = rng.choice(places)
        if isinstance(node, dict) and rng.random() < 0.2:
            node[rng.choice(("x", "", 1, None, 1.5, f"{key}s", (1, 2)))] = node.pop(key)
        else:
            node[key] = rng.choice(LEAVES)
        return yaml.dump(tree, Dumper=getattr(yaml, "CSafeDumper", yaml.SafeDumper)).encode(errors="surrogatepass")
    except (yaml.YAMLError, ValueError, LookupError, RecursionError, TypeError, AttributeError):
        return _number(data, rng)


_MUTATIONS: tuple[Callable[[bytes, random.Random], bytes], ...] = (
    *(_flip, _flip, _insert, _cut, _repeat, _number, _number, _number, _word, _word, _lines, _lines, _leaf, _leaf),
)


def mutated_archive(seeds: Sequence[bytes], rng: random.Random) -> bytes:
    """A .npz file: its bytes changed, or what its members hold, or how they are stored."""
    seed = rng.choice(seeds)
    if rng.random() < 0.4:
        return mutated([seed], rng)
    with zipfile.ZipFile(io.BytesIO(seed)) as stored:
        members = {name: stored.read(name) for name in stored.namelist()}
    name = rng.choice(list(members))
    headers = (b"|O", b"<M8[ns]", b"<U900000000", b"V8", b"<c16", b">f8", b"<f2", b"'(2,)i4'", b"S0", b"|b1")
    shapes = (b"()", b"(-1,)", b"(99999999999,)", b"(3, 3)", b"(1e9,)", b"((1,),)", b"('a',)", b"(" + b"1," * 50 + b")")
    kind = rng.randrange(6)
    if kind == 0:
        members[name] = re.sub(rb"'descr': '[^']*'", b"'descr': '" + rng.choice(headers) + b"'", members[name])
    elif kind == 1:
        members[name] = re.sub(rb"'shape': \([^)]*\)", b"'shape': " + rng.choice(shapes), members[name])
    elif kind == 2:
        members[name] = mutated([members[name]], rng)
    elif kind == 3:
        del members[name]
    elif kind == 4:
        members[name] = members[name] + bytes(rng.choice((1, 1000, 30_000_000)))
    else:
        members[rng.choice(("x.npy", "../x.npy", "x", "table.npy/", "a" * 300))] = members.pop(name)
    written = io.BytesIO()
    with zipfile.ZipFile(written, "w", rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as archive:
        for member, content in members.items():
            archive.writestr(zipfile.ZipInfo(member), content, archive.compression)  # without the time of day
    data = written.getvalue()
    if rng.random() < 0.3:  # a compression that nobody knows, an encrypted member, a wrong checksum
        at = data.find(b"PK\x01\x02")
        offset = rng.choice((8, 10, 16, 20, 24, 28))
        data = data[: at + offset] + bytes([rng.randrange(256)]) + data[at + offset + 1 :]
    return data
