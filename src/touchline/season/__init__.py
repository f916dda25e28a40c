"""Many recordings in one command: a folder for each, a journal that a run goes on from, tables of all of them."""

from touchline.season.recordings import find_recordings, is_season
from touchline.season.runs import Command, localize_all

__all__ = ["Command", "find_recordings", "is_season", "localize_all"]
