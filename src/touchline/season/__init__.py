"""Many recordings in one command: the folder of a run for each, and a table with a row for each."""

from touchline.season.recordings import find_recordings
from touchline.season.runs import Command, localize_all

__all__ = ["Command", "find_recordings", "localize_all"]
