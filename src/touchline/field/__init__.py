"""A marked field as data: lines, crossings, posts, presets and the distance map."""

from touchline.field.catalogue import open_field, preset_names
from touchline.field.crossings import Crossing
from touchline.field.distance_map import DistanceMap, lookup
from touchline.field.letters import LETTERS, field_from_letters
from touchline.field.model import FieldModel, Goal, Pole, Post
from touchline.field.reading import load_field

__all__ = [
    "LETTERS",
    "Crossing",
    "DistanceMap",
    "FieldModel",
    "Goal",
    "Pole",
    "Post",
    "field_from_letters",
    "load_field",
    "lookup",
    "open_field",
    "preset_names",
]
