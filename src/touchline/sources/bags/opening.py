"""A bag opened as a recording."""

from __future__ import annotations

from pathlib import Path

from touchline.errors import InputError
from touchline.sources.bags.bag_images import BagImages
from touchline.sources.bags.extraction import extract_own
from touchline.sources.bags.foreign import Foreign
from touchline.sources.bags.kinds import BagFiles, BagKind
from touchline.sources.bags.layout import SEQUENCE_TOPIC
from touchline.sources.bags.mcap_file import McapBag
from touchline.sources.bags.messages import Bag
from touchline.sources.bags.roles import BagOptions
from touchline.sources.bags.with_rosbags import Codec, RosbagsBag
from touchline.sources.folder import Recording
from touchline.sources.problems import ProblemLog
from touchline.sources.temporary import TemporaryFolder


def open_bag(path: Path, files: BagFiles, options: BagOptions) -> Recording:
    """The recording in a bag. Its tables are copied into a temporary folder, which goes with it; its images stay.
    options: what a bag that Touchline did not write leaves open.

    Raises InputError if it cannot be read as a recording.
    """
    problems = ProblemLog()
    bag = _open(files, problems)
    if not bag.topics:
        raise InputError(f"{path}: holds no message that can be read{_said(problems)}")
    codec = Codec()
    folder = TemporaryFolder()
    if SEQUENCE_TOPIC not in bag.topics:
        places = Foreign(bag, codec, options, path, problems).extract(folder.path)
    elif options.given():
        raise InputError(f"{path}: is a recording that Touchline wrote: its topics, field and camera are known")
    else:
        places = extract_own(bag, folder.path, problems)
    images = BagImages(bag, codec, places)
    try:
        recording = Recording(folder.path, path=path, images=images, problems=problems)
    except InputError as error:  # the user knows the bag, not the folder
        raise InputError(f"{str(error).replace(str(folder.path), str(path))}{_said(problems)}") from None
    recording.options, recording.kept = options, folder
    return recording


def _open(files: BagFiles, problems: ProblemLog) -> Bag:
    if files.kind is BagKind.MCAP:
        return McapBag(files.paths, problems)
    return RosbagsBag(files.paths, files.kind is BagKind.ROS1, problems)


def _said(problems: ProblemLog) -> str:
    return f" ({problems[0].message})" if problems.total else ""
