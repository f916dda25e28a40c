"""Readers of bags, and of runs whose recording is one."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
from fakes import FakeSource, FakeSystem
from fuzz_bags import bag_seeds
from fuzz_reader import Reader, new_folder, read_recording, small_recording

from touchline.evaluation import Run
from touchline.evaluation.ros_results import write_results
from touchline.evaluation.run_folder import RunFolder, write_summary
from touchline.evaluation.runner import run_frames
from touchline.evaluation.summary import RunSummary
from touchline.sources import BagOptions, open_source
from touchline.sources.bags.with_rosbags import Codec
from touchline.sources.bags.writing import McapWriter, write_recording
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
    return [*readers, *_runs(workplace, data), *_conversions(workplace)]


def _metadata(path: Path) -> None:
    read_recording(open_source(path.parent, options=_FIELD))


def _to_folder(path: Path) -> None:
    target = path.parent / "converted"
    shutil.rmtree(target, ignore_errors=True)
    write_folder(open_source(path, options=_FIELD), target)


def _to_mcap(write: Callable[[McapWriter, Codec], None], target: Path) -> None:
    target.unlink(missing_ok=True)
    codec = Codec()
    write(McapWriter(target, codec), codec)


def _runs(workplace: Path, bag: bytes) -> list[Reader]:
    """The folder of a run over a bag: evaluated, and its results written as another."""
    folder = new_folder(workplace, "bag-run")
    (folder / "robot.mcap").write_bytes(bag)
    with RunFolder(folder) as rows:
        tally = run_frames(FakeSource(6, black=(3,)), FakeSystem(np.random.default_rng(0)), rows)
    options = BagOptions({"truth": "/ground_truth/odom", "image": "/front/image_raw"}, "msl-18x12", None, "base_link")
    about = {"path": str(folder / "robot.mcap"), "bag": options.to_dict()}
    write_summary(folder, RunSummary(recording=about).updated(tally.summary()))
    short = json.dumps({**json.loads((folder / "summary.json").read_text()), "recording": about}).encode()
    readers = []
    for name in ("summary.json", "estimates.csv"):
        copy = workplace / f"bag-run-{name}"
        shutil.copytree(folder, copy)

        def read(path: Path) -> None:
            run = Run(path.parent)
            _ = (run.incomplete, run.errors, run.why_no_errors)

        def results(path: Path) -> None:
            run = Run(path.parent)
            _to_mcap(lambda writer, codec: write_results(run, writer, codec), path.parent / "results.mcap")

        seeds = [short] if name == "summary.json" else [(copy / name).read_bytes()]
        readers.append(Reader(f"run of a bag, {name}", copy / name, seeds, read, 0.5))
        readers.append(Reader(f"results as a bag, {name}", copy / name, seeds, results, 0.3))
    return readers


def _conversions(workplace: Path) -> list[Reader]:
    """Recordings with one hostile file each, written as a bag."""
    readers = []
    for name in ("sequence.yaml", "camera.yaml", "images.csv", "ground_truth.tum", "observations.csv"):
        folder = small_recording(new_folder(workplace, f"to-bag-{name}"))

        def convert(path: Path, folder: Path = folder) -> None:
            source = open_source(folder)
            _to_mcap(lambda writer, codec: write_recording(source, writer, codec), folder / "bag.mcap")

        readers.append(Reader(f"as a bag, {name}", folder / name, [(folder / name).read_bytes()], convert, 0.3))
    return readers
