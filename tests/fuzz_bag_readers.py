"""Readers of bags, and of runs whose recording is one."""

from __future__ import annotations

import shutil
from pathlib import Path

from fuzz_bags import bag_seeds
from fuzz_reader import Reader, new_folder, read_recording, small_recording

from touchline.sources import BagOptions, open_source
from touchline.sources.to_folder import write_folder

_FIELD = BagOptions(field="msl-18x12")


def bag_readers(workplace: Path) -> list[Reader]:
    """Every kind of bag, its metadata, and what a run notes of it."""
    recording = small_recording(new_folder(workplace, "bag-recording"))
    seeds = {name: (data, mutate) for name, data, mutate in bag_seeds(recording)}
    readers = []
    for name, (data, mutate) in seeds.items():
        folder = new_folder(workplace, f"bag-{name}")
        options = _FIELD if name.startswith("robot") else BagOptions()

        def read(path: Path, options: BagOptions = options) -> None:
            read_recording(open_source(path, options=options))

        if name == "metadata.yaml":
            (folder / "robot.db3").write_bytes(seeds["robot.db3"][0])
            readers.append(Reader("bag, metadata.yaml", folder / name, [data], _metadata, 0.6))
        else:
            readers.append(Reader(f"bag, {name}", folder / name, [data], read, 1.5, mutate))
    robot = new_folder(workplace, "bag-converted") / "robot.mcap"
    data, mutate = seeds["robot.mcap"]
    readers.append(Reader("convert, robot.mcap", robot, [data], _to_folder, 0.1, mutate))
    return readers


def _metadata(path: Path) -> None:
    read_recording(open_source(path.parent, options=_FIELD))


def _to_folder(path: Path) -> None:
    target = path.parent / "converted"
    shutil.rmtree(target, ignore_errors=True)
    write_folder(open_source(path, options=_FIELD), target)
