"""Reads hostile files by every reader and counts what must not be: `make fuzz N=20000 SEED=1`.

Three things are faults: an exception that is no TouchlineError, more than 2 s, more than 150 MB above the process at
rest. Each is printed with the reader and the number of the input, which makes it again: `--only NUMBER`.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import resource
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from fuzz_readers import Reader, all_readers

import touchline
from touchline.errors import TouchlineError

_PACKAGE = Path(touchline.__file__).parent  # not whatever lies in a folder of that name
MAX_SECONDS, MAX_MEGABYTES = 2.0, 150.0
_ALARM_S = 30
_ADDRESS_SPACE = 4 * 2**30  # beyond the process at rest: larger demands fail at once
_BATCH = 500


class Outcome(NamedTuple):
    """What became of one input. fault: empty if nothing."""

    reader: str
    number: int
    end: str
    fault: str
    seconds: float
    megabytes: float


class HangError(BaseException):
    """No answer within _ALARM_S."""


def hostile(reader: Reader, seed: int, number: int) -> bytes:
    """The same input for the same seed and number."""
    return reader.mutate(reader.seeds, random.Random(f"{seed} {reader.name} {number}"))


def outcome(reader: Reader, number: int, data: bytes) -> Outcome:
    """Let a reader read an input, and measure it."""
    rest_mb = _resident_mb(reset=True)
    started, end, fault = time.process_time(), "read", ""
    before = signal.signal(signal.SIGALRM, _hang)
    signal.alarm(_ALARM_S)
    try:
        reader.try_one(data)
    except TouchlineError:
        end = "refused"
    except (Exception, HangError) as error:
        end, fault = type(error).__name__, f"{type(error).__name__}: {str(error)[:150]} {_where(error)}"
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    seconds, above_mb = time.process_time() - started, _resident_mb() - rest_mb
    if not fault and seconds > MAX_SECONDS:
        fault = f"took {seconds:.1f} s of processor time"
    if not fault and above_mb > MAX_MEGABYTES:
        fault = f"took {above_mb:.0f} MB"
    return Outcome(reader.name, number, end, fault, seconds, above_mb)


def _hang(*_: object) -> None:
    raise HangError


def _where(error: BaseException) -> str:
    frames = [one for one in traceback.extract_tb(error.__traceback__) if Path(one.filename).is_relative_to(_PACKAGE)]
    return f"({Path(frames[-1].filename).name}:{frames[-1].lineno})" if frames else ""


def _resident_mb(reset: bool = False) -> float:
    """The most memory (MB) that was resident since the last reset; since the beginning where no reset is possible."""
    try:
        if reset:
            Path("/proc/self/clear_refs").write_text("5")
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmHWM"):
                return int(line.split()[1]) / 1000.0
    except OSError:
        pass
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000.0


def turns(readers: Iterable[Reader], count: int) -> list[tuple[Reader, int]]:
    """Which reader reads which input, by their shares, mixed."""
    readers = list(readers)
    total = sum(reader.share for reader in readers)
    given = [(reader, k) for reader in readers for k in range(max(1, round(count * reader.share / total)))]
    random.Random(0).shuffle(given)
    return given


def _in_processes(given: list[tuple[Reader, int]], seed: int) -> Iterator[Outcome]:
    """Outcomes from processes of their own, so that not even a crash ends the count."""
    while given:
        batch, given = given[:_BATCH], given[_BATCH:]
        receive, send = os.pipe()
        child = os.fork()
        if not child:
            try:
                os.close(receive)
                _work(batch, seed, send)
                os._exit(0)
            finally:
                traceback.print_exc()
                os._exit(1)  # whatever happens: the folder is the parent's to clear up
        os.close(send)
        with os.fdopen(receive, newline="\n") as lines:
            done = 0
            for line in lines:
                reader, number, end, fault, seconds, megabytes = line.rstrip("\n").split("\t")
                done += 1
                yield Outcome(reader, int(number), end, fault, float(seconds), float(megabytes))
        _, status = os.waitpid(child, 0)
        if done < len(batch):
            reader, number = batch[done]
            yield Outcome(reader.name, number, "crash", f"the process ended with status {status}", 0.0, 0.0)
            given = batch[done + 1 :] + given


def _work(batch: list[tuple[Reader, int]], seed: int, send: int) -> None:
    status = Path("/proc/self/statm")
    if status.exists():
        most = int(status.read_text().split()[0]) * resource.getpagesize() + _ADDRESS_SPACE
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
    with os.fdopen(send, "w", errors="backslashreplace") as out:
        for reader, number in batch:
            found = outcome(reader, number, hostile(reader, seed, number))
            out.write("\t".join(" ".join(str(part).split("\t")).replace("\n", " ") for part in found) + "\n")
            out.flush()


def main() -> int:
    """Fuzz, print what was found; 1 if there was a fault."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int, nargs="?", default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--reader", default="", help="regular expression of readers' names")
    parser.add_argument("--only", type=int, help="this input alone, with its traceback")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        readers = [reader for reader in all_readers(Path(folder)) if re.search(arguments.reader, reader.name)]
        for reader in readers:
            for data in reader.seeds:
                reader.try_one(data)  # as it is: everything is loaded before anything is measured
        if arguments.only is not None:
            for reader in readers:
                reader.try_one(hostile(reader, arguments.seed, arguments.only))
            return 0
        started = time.perf_counter()
        found = []
        for one in _in_processes(turns(readers, arguments.count), arguments.seed):
            found.append(one)
            if one.fault:
                print(f"{one.reader}, input {one.number}: {one.fault}", flush=True)
        _report(found, time.perf_counter() - started)
        return any(one.fault for one in found)


def _report(found: list[Outcome], wall_s: float) -> None:
    ends, faults = Counter(one.end for one in found), [one for one in found if one.fault]
    slowest, largest = max(found, key=lambda one: one.seconds), max(found, key=lambda one: one.megabytes)
    print(
        f"{len(found)} inputs in {wall_s:.0f} s: {ends['read']} read, {ends['refused']} refused, {len(faults)} faults"
    )
    print(f"slowest {slowest.seconds:.2f} s ({slowest.reader} {slowest.number})")
    print(f"most memory above rest {largest.megabytes:.0f} MB ({largest.reader} {largest.number})")
    hangs = sum(one.seconds > MAX_SECONDS or one.end == "HangError" for one in found)
    large = sum(one.megabytes > MAX_MEGABYTES for one in found)
    foreign = sum(one.end not in ("read", "refused", "HangError") for one in found)
    print(f"over {MAX_SECONDS:g} s: {hangs}; over {MAX_MEGABYTES:g} MB: {large}; foreign exceptions: {foreign}")


if __name__ == "__main__":
    sys.exit(main())
