"""Every reader of files that the package has, with files to begin from."""

from __future__ import annotations

import io
import shutil
from pathlib import Path

import cv2
import numpy as np
import yaml
from fakes import CAMERA_YAML, FakeSource, FakeSystem, true_samples
from fuzz_bag_readers import bag_readers
from fuzz_calibration_readers import calibration_readers, loose_readers
from fuzz_mutations import mutated_archive
from fuzz_reader import SEQUENCE, Reader, new_folder, read_recording, small_recording

from touchline.calibration.colour import calibrate_marked
from touchline.camera import open_camera
from touchline.checks.check import check_recording
from touchline.config import Settings, load_settings, settings_tree
from touchline.evaluation import evaluate, read_tum, write_tum
from touchline.evaluation.estimates import read_estimates
from touchline.evaluation.run_folder import RunFolder, write_summary
from touchline.evaluation.runner import robot_setup, run_frames
from touchline.evaluation.summary import RunSummary
from touchline.field import open_field
from touchline.files.images import read_image
from touchline.localization.one_shot.points_file import read_points
from touchline.perception.colour_file import load_colours, save_colours
from touchline.published.iris_fusion.range_pairs import marked_pairs
from touchline.published.iris_fusion.range_regression import fit_range
from touchline.published.strip.recording import read_bearings, rough_center, sensor_gamma
from touchline.sources import open_source
from touchline.systems import SYSTEMS, open_system
from touchline.view.look import observe_image

DATA = Path(__file__).parent / "data"
MARKS = "file,name,u,v,x_m,y_m\n" + "".join(
    f"images/000000.jpg,m{k},{47.5 + 4 * k},47.5,0.0,{-0.2 * k:.3f}\n" for k in range(2, 11)
)
REGIONS = """- {file: 000000.jpg, class: green, polygon: [[2, 2], [40, 2], [40, 20]]}
- {file: 000000.jpg, class: white, box: [5, 22, 30, 30]}
"""
POINTS = "x_m,y_m,weight\n" + "".join(f"{0.1 * k},{1.0 + 0.05 * k},1.0\n" for k in range(40))


def all_readers(workplace: Path) -> list[Reader]:
    """Every reader, with a folder of its own in a workplace."""
    return [
        *_recordings(workplace),
        *_settings(workplace),
        *_runs(workplace),
        *_single_files(workplace),
        *_images(workplace),
        *_whole_ways(workplace),
        *bag_readers(workplace),
        *loose_readers(workplace),
        *calibration_readers(workplace),
    ]


def _recordings(workplace: Path) -> list[Reader]:
    names = ("sequence.yaml", "camera.yaml", "images.csv", "odometry.csv", "wheels.csv", "imu.csv")
    readers = []
    for name in (*names, "camera_pose.csv", "ground_truth.tum", "observations.csv", "images/000001.jpg"):
        folder = small_recording(new_folder(workplace, f"recording-{name}"))
        seeds = [(folder / name).read_bytes()]
        readers.append(Reader(name, folder / name, seeds, lambda _, f=folder: read_recording(open_source(f))))  # type: ignore[misc]
    folder = small_recording(new_folder(workplace, "recording-field"))
    (folder / "sequence.yaml").write_text(SEQUENCE.replace("msl-18x12", "field.yaml"))
    seeds = [(DATA / "omni_9x6_points" / "field.yaml").read_bytes()]
    readers.append(
        Reader("field.yaml of a recording", folder / "field.yaml", seeds, lambda _: open_source(folder).field)
    )
    strip = small_recording(new_folder(workplace, "recording-strip"))
    rows = (strip / "images.csv").read_text().splitlines()
    rows = [rows[0] + ",bearing_rad", *(f"{row},{k}" for k, row in enumerate(rows[1:]))]
    (strip / "images.csv").write_text("\n".join(rows))
    for name in ("images.csv", "sequence.yaml", "camera.yaml"):
        copy = workplace / f"strip-{name}"
        shutil.copytree(strip, copy)
        readers.append(Reader(f"strip, {name}", copy / name, [(copy / name).read_bytes()], _read_strip))
    return readers


def _read_strip(path: Path) -> None:
    source = open_source(path.parent)
    read_bearings(source)
    rough_center(source)
    sensor_gamma(source)


def _settings(workplace: Path) -> list[Reader]:
    readers = []
    for name, info in SYSTEMS.items():
        file = new_folder(workplace, f"config-{name}") / "config.yaml"
        tree = yaml.safe_dump(settings_tree(info.settings())).encode()

        def read(path: Path, model: type[Settings] = info.settings) -> None:
            load_settings(model, path)

        readers.append(Reader(f"settings of {name}", file, [tree], read, 0.5))
    return readers


def _runs(workplace: Path) -> list[Reader]:
    folder = new_folder(workplace, "run")
    with RunFolder(folder) as rows:
        tally = run_frames(FakeSource(6, black=(3,)), FakeSystem(np.random.default_rng(0)), rows)
    write_summary(folder, RunSummary(recording={"path": str(folder / "gone")}).updated(tally.summary()))
    truth = folder / "truth.tum"
    write_tum(truth, true_samples(6))
    seeds = {path.name: path.read_bytes() for path in folder.iterdir()}
    with_mode = (
        seeds["estimates.csv"]
        .replace(b"localization_ms\n", b"localization_ms,mode\n")
        .replace(b"0.5000\n", b"0.5000,omnivision\n")
    )
    readers = [
        Reader("trajectory.tum", folder / "hostile.tum", [seeds["truth.tum"]], read_tum),
        Reader("true poses", folder / "hostile_truth.tum", [seeds["truth.tum"]], lambda path: evaluate(folder, path)),
        Reader("estimates.csv", folder / "hostile.csv", [seeds["estimates.csv"], with_mode], read_estimates),
    ]
    for name in ("estimates.csv", "summary.json"):
        copy = workplace / f"run-{name}"
        shutil.copytree(folder, copy)
        readers.append(Reader(f"run, {name}", copy / name, [seeds[name]], lambda path: evaluate(path.parent, truth)))
    return readers


def _single_files(workplace: Path) -> list[Reader]:
    folder = new_folder(workplace, "single")
    fields = [path.read_bytes() for path in sorted(DATA.glob("*/field.yaml"))]
    omni = [CAMERA_YAML.encode(), (DATA / "omni_exposure" / "camera.yaml").read_bytes()]
    omni.append(
        CAMERA_YAML.replace("range_table: {", "viewpoint_height_m: 0.5\nrange_table: {bearing_rad: [0.0, 1.0],")
        .replace(
            "range_m: [0.0, 0.6, 1.6, 3.6, 9.0]", "range_m: [[0.0, 0.6, 1.6, 3.6, 9.0], [0.0, 0.6, 1.6, 3.6, 9.0]]"
        )
        .encode()
    )
    pinhole = [(DATA / "humanoid_9x6_walk" / "camera.yaml").read_bytes()]
    (folder / "000000.jpg").write_bytes(_jpeg())
    (folder / "camera.yaml").write_text(CAMERA_YAML)

    def ranges(path: Path) -> None:
        fit_range(marked_pairs(path, folder / "camera.yaml")).camera()

    def camera(path: Path) -> None:
        opened = open_camera(path)
        opened.ground_from_image(np.array([[1.0, 2.0], [40.0, 20.0]]))
        opened.image_from_ground(np.array([[1.0, 2.0], [3.0, -1.0]]))

    def a_field(path: Path) -> None:
        opened = open_field(path)
        _ = (opened.crossings, opened.posts, opened.is_symmetric, list(opened.polylines(0.1)))
        opened.line_distances(np.array([[0.0, 0.0]]))

    return [
        Reader("field.yaml", folder / "field.yaml", fields, a_field, 2.0),
        Reader("camera.yaml, omni", folder / "omni.yaml", omni, camera, 2.0),
        Reader("camera.yaml, pinhole", folder / "pinhole.yaml", pinhole, camera, 2.0),
        Reader("marks.csv", folder / "marks.csv", [MARKS.encode()], ranges),
        Reader("regions.yaml", folder / "regions.yaml", [REGIONS.encode()], lambda p: calibrate_marked(folder, p), 0.4),
        Reader(
            "points",
            folder / "points.csv",
            [POINTS.encode(), POINTS.replace("x_m,y_m,weight", "x,y,z").encode()],
            read_points,
        ),
        Reader("colours", folder / "colours.npz", _colours(folder), load_colours, 2.0, mutated_archive),
    ]


def _jpeg() -> bytes:
    image = np.full((32, 48, 3), (40, 140, 40), dtype=np.uint8)
    image[21:31] = 240
    return bytes(cv2.imencode(".jpg", image)[1].tobytes())


def _colours(folder: Path) -> list[bytes]:
    regions = folder / "regions_seed.yaml"
    regions.write_text(REGIONS)
    save_colours(calibrate_marked(folder, regions).colours, folder / "seed.npz")
    packed = (folder / "seed.npz").read_bytes()
    plain = io.BytesIO()
    with np.load(folder / "seed.npz") as arrays:
        np.savez(plain, **{name: arrays[name] for name in arrays.files})
    return [packed, plain.getvalue()]


def _images(workplace: Path) -> list[Reader]:
    image = np.random.default_rng(3).integers(0, 255, (24, 32, 3), dtype=np.uint8)
    made = {
        ending: bytes(cv2.imencode(ending, image)[1].tobytes())
        for ending in (".png", ".jpg", ".ppm", ".bmp", ".webp", ".tiff")
    }
    made[".pgm"] = bytes(cv2.imencode(".pgm", image[:, :, 0])[1].tobytes())
    deep = bytes(cv2.imencode(".png", image.astype(np.uint16) * 257)[1].tobytes())
    progressive = bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes())
    folder = new_folder(workplace, "images")
    return [
        Reader(f"image {ending}", folder / f"image{ending}", [data, deep, progressive], read_image)
        for ending, data in made.items()
    ]


def _whole_ways(workplace: Path) -> list[Reader]:
    """From a hostile file through everything behind its reader: few of them, for they take their time."""
    ways = []
    for name in ("sequence.yaml", "camera.yaml", "observations.csv", "imu.csv", "images/000001.jpg"):
        folder = small_recording(new_folder(workplace, f"check-{name}"))
        seed = (folder / name).read_bytes()
        ways.append(
            Reader(f"check, {name}", folder / name, [seed], lambda _, f=folder: check_recording(open_source(f)), 0.04)
        )  # type: ignore[misc]
    for name in ("camera.yaml", "field.yaml"):
        folder = small_recording(new_folder(workplace, f"system-{name}"))
        (folder / "sequence.yaml").write_text(SEQUENCE.replace("msl-18x12", "field.yaml"))
        (folder / "field.yaml").write_bytes((DATA / "omni_9x6_points" / "field.yaml").read_bytes())

        def system(_: Path, folder: Path = folder) -> None:
            open_system("nubot-mti", robot_setup(open_source(folder)))

        ways.append(Reader(f"system, {name}", folder / name, [(folder / name).read_bytes()], system, 0.06))
    folder = new_folder(workplace, "look")
    (folder / "camera.yaml").write_text(CAMERA_YAML)
    image = cv2.resize(cv2.imdecode(np.frombuffer(_jpeg(), np.uint8), 1), (96, 96))
    seed = bytes(cv2.imencode(".png", image)[1].tobytes())
    camera, field_model = open_camera(folder / "camera.yaml"), open_field("msl-18x12")
    ways.append(
        Reader("look at an image", folder / "image.png", [seed], lambda p: observe_image(p, camera, field_model), 0.04)
    )
    return ways
