"""Where frames come from: `open_source(path)` recognises the kind of recording by itself."""

from pathlib import Path

from touchline.errors import InputError
from touchline.given import given_path
from touchline.sources.bags.kinds import find_bag, require_bags
from touchline.sources.bags.roles import BagOptions
from touchline.sources.folder import SENSOR_FILES, Recording
from touchline.sources.other_files import refuse_other_files
from touchline.sources.problems import ProblemKind, ProblemLog, RecordingProblem
from touchline.sources.truth import Truth

__all__ = [
    "SENSOR_FILES",
    "BagOptions",
    "ProblemKind",
    "ProblemLog",
    "Recording",
    "RecordingProblem",
    "Truth",
    "is_recording",
    "open_source",
]


def is_recording(path: Path) -> bool:
    """Whether a path is that of a folder or a bag, rather than of a single image or table."""
    return path.is_dir() or find_bag(path) is not None


def open_source(
    path: str | Path | Recording, follow_links: bool = False, options: BagOptions | None = None
) -> Recording:
    """Open a recording: a folder (docs/how-to-recording.md, format 1), an MCAP file, a rosbag2 folder or a ROS 1 bag.

    A recording that is open already is returned as it is. follow_links: read what the recording names or links to
    outside of its folder, too. options: what a bag that another program wrote does not say of itself.
    Raises InputError, naming file and line, when it can't be read at all. What can be survived is in `.problems`.
    """
    if isinstance(path, Recording):
        return path
    path = given_path("recording", "the path of a recording", path)
    files = find_bag(path)
    options = options or BagOptions()
    if files is None:
        refuse_other_files(path)
        if options.given():
            reason = "a recording's folder tells its field and camera itself, in sequence.yaml"
            raise InputError(f"{path}: --topic, --field, --camera and --base are for bags; {reason}")
        return Recording(path, follow_links)
    require_bags(path)
    from touchline.sources.bags.opening import open_bag

    return open_bag(path, files, options)
