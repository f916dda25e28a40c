"""Files that hold a recording but are none: what to do with them."""

from pathlib import Path

from touchline.errors import InputError
from touchline.files.opened import open_bytes
from touchline.sources.description import SEQUENCE

_STARTS = (  # what a file starts with, at which byte
    (b"PK\x03\x04", 0, "zip"),
    (b"PK\x05\x06", 0, "zip"),
    (b"\x1f\x8b", 0, "tar"),
    (b"BZh", 0, "tar"),
    (b"\xfd7zXZ\x00", 0, "tar"),
    (b"\x28\xb5\x2f\xfd", 0, "tar"),
    (b"ustar", 257, "tar"),
    (b"7z\xbc\xaf\x27\x1c", 0, "7z"),
    (b"ftyp", 4, "video"),
    (b"\x1a\x45\xdf\xa3", 0, "video"),
    (b"RIFF", 0, "video"),
    (b"\xff\xd8\xff", 0, "image"),
    (b"\x89PNG", 0, "image"),
)
_ENDINGS = {
    "zip": (".zip",),
    "tar": (".tar", ".tgz", ".gz", ".bz2", ".xz", ".zst"),
    "7z": (".7z", ".rar"),
    "video": (".mp4", ".avi", ".mkv", ".mov", ".webm", ".m4v", ".mpg"),
    "bag": (".mcap", ".db3", ".bag"),
    "image": (".jpg", ".jpeg", ".png", ".bmp"),
    "list": (".csv", ".yaml", ".yml", ".tum"),
}
_GUIDE = "docs/how-to-recording.md"


def refuse_other_files(path: Path) -> None:
    """Raises InputError for a file: how it becomes a recording; for a folder that is empty or one of bags."""
    if not path.exists() or (path / SEQUENCE).exists():
        return
    if path.is_dir():
        try:
            names = sorted(each.name for each in path.iterdir())
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror})") from None
        if not names:
            raise InputError(f"{path}: is an empty folder; expected a recording ({_GUIDE})")
        for name in names:
            if name.endswith(_ENDINGS["bag"]):
                raise InputError(f"{path}: holds bags, each a recording of its own: give one of them, as {path / name}")
        return
    kind, parent = _kind_of(path), path.resolve().parent
    advice = {
        "zip": f"is a zip archive: unpack it (unzip '{path.name}' -d recording) and give the folder",
        "tar": f"is a packed archive: unpack it (mkdir recording && tar -xf '{path.name}' -C recording) "
        "and give the folder",
        "7z": "is a packed archive: unpack it and give the folder",
        "video": f"is a video: touchline convert '{path.name}' recording --field NAME --camera FILE makes a recording",
        "bag": "ends like a bag but is none, or it is cut: record or copy it again",
        "image": "is one image: `touchline view` and `touchline locate` take it; a recording is a folder of images "
        f"({_GUIDE})",
        "list": f"is one file of a recording: give its folder, {parent}",
    }
    why = advice.get(kind, f"is not a recording; expected a folder that holds sequence.yaml and images.csv ({_GUIDE})")
    raise InputError(f"{path}: {why}")


def _kind_of(path: Path) -> str:
    """By the first bytes, else by the ending."""
    with open_bytes(path) as file:
        start = file.read(300)
    for mark, at, kind in _STARTS:
        if start[at : at + len(mark)] == mark:
            return kind
    endings = (kind for kind, known in _ENDINGS.items() if path.suffix.lower() in known)
    return next(endings, "")
