"""What kind of bag a path is: told by its content, with the standard library alone."""

import re
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from touchline.enums import StrEnum
from touchline.errors import InputError
from touchline.files.opened import UnreadableError, open_bytes
from touchline.files.yaml_text import read_yaml_mapping
from touchline.sources.description import SEQUENCE

METADATA = "metadata.yaml"


class BagKind(StrEnum):
    """How a bag is kept."""

    MCAP = "mcap"
    ROSBAG2 = "rosbag2"
    ROS1 = "bag"


_STARTS = {b"\x89MCAP0\r\n": BagKind.MCAP, b"SQLite format 3\0": BagKind.ROSBAG2, b"#ROSBAG V": BagKind.ROS1}


class BagFiles(NamedTuple):
    """The files of a bag, in their order. paths: those that hold messages, or a whole rosbag2 folder."""

    kind: BagKind
    paths: tuple[Path, ...]


def require_bags(path: Path) -> None:
    """Raises InputError where the packages that read and write bags are not installed."""
    missing = [name for name in ("rosbags", "mcap") if find_spec(name) is None]
    if missing:
        raise InputError(
            f"{path}: is a bag, and {' and '.join(missing)} to read and write bags is not installed: "
            "pip install 'touchline[bags]'"
        )


def find_bag(path: Path) -> BagFiles | None:
    """The bag at a path; None if there is none."""
    if path.is_dir():
        return _in_folder(path)
    if not path.is_file():
        return None
    try:
        with open_bytes(path) as file:
            start = file.read(16)
    except (OSError, UnreadableError):
        return None
    return next((BagFiles(kind, (path,)) for mark, kind in _STARTS.items() if start.startswith(mark)), None)


def _in_folder(folder: Path) -> BagFiles | None:
    """A folder as `ros2 bag record` writes it; metadata.yaml comes last, and is missing where recording was cut off."""
    if (folder / SEQUENCE).exists():
        return None
    files = sorted((file for file in folder.iterdir() if file.suffix in (".mcap", ".db3")), key=_numbered)
    if (folder / METADATA).is_file():
        order = _order(folder / METADATA)
        known = [folder / name for name in order]
        if known and all(file.suffix == ".mcap" and file.is_file() for file in known):
            return BagFiles(BagKind.MCAP, tuple(known))
        return BagFiles(BagKind.ROSBAG2, (folder,)) if order else None
    kinds = {file.suffix for file in files}
    if len(kinds) != 1 or not _is_split(files):
        return None
    return BagFiles(BagKind.MCAP if kinds == {".mcap"} else BagKind.ROSBAG2, tuple(files))


def _is_split(files: Sequence[Path]) -> bool:
    """Whether they are NAME_0, NAME_1, … of one bag; of other names each is a recording of its own."""
    name = files[0].stem.removesuffix("_0")
    return [file.stem for file in files] == [f"{name}_{number}" for number in range(len(files))]


def _order(metadata: Path) -> Sequence[str]:
    """Names of the files in the order in which they were written; empty if the file is no rosbag2's."""
    about = read_yaml_mapping(metadata).get("rosbag2_bagfile_information")
    names = about.get("relative_file_paths") if isinstance(about, dict) else None
    return [Path(str(name)).name for name in names] if isinstance(names, list) else []


def _numbered(path: Path) -> tuple[int, str]:
    """Sort key of bag_0.mcap, bag_1.mcap, … bag_10.mcap."""
    number = re.search(r"(\d+)$", path.stem)
    return (int(number[1]) if number else -1, path.name)
