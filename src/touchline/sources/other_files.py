"""Files that hold a recording but are none: what to do with them."""

from pathlib import Path

from touchline.errors import InputError
from touchline.sources.description import SEQUENCE

_BAGS = (".mcap", ".db3", ".bag")
_GUIDE = "docs/how-to-recording.md"
_ADVICE = {
    (".zip", ".tar", ".tgz", ".gz", ".bz2", ".xz", ".zst", ".7z", ".rar"): "is a packed archive: unpack it and give "
    "the folder",
    (".mp4", ".avi", ".mkv", ".mov", ".webm", ".m4v", ".mpg"): "is a video: touchline convert '{0.name}' recording "
    "--field NAME --camera FILE makes a recording",
    _BAGS: "ends like a bag but is none, or it is cut: record or copy it again",
    (".jpg", ".jpeg", ".png", ".bmp"): "is one image: `touchline view` and `touchline locate` take it; a recording is "
    f"a folder of images ({_GUIDE})",
    (".csv", ".yaml", ".yml", ".tum"): "is one file of a recording: give its folder, {0.parent}",
}
"""By the ending of a file, whose path is put in."""


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
            if name.endswith(_BAGS):
                raise InputError(f"{path}: holds bags, each a recording of its own: give one of them, as {path / name}")
        return
    why = f"is not a recording; expected a folder that holds sequence.yaml and images.csv ({_GUIDE})"
    for endings, advice in _ADVICE.items():
        if path.suffix.lower() in endings:
            why = advice.format(path.resolve())
    raise InputError(f"{path}: {why}")
