"""Types of ROS 2 as Cyclone DDS wants them, from their definitions; samples stay the bytes that they are on the wire.

Cyclone's own Python code would make every byte of an image an object. Here a sample is its CDR, made and read by
rosbags: a megabyte costs a tenth of a millisecond.
"""

from functools import cache
from typing import Any

from cyclonedds.idl import make_idl_struct, types
from rosbags.interfaces import Nodetype

_NUMBERS = ("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64")
_BASE: dict[str, Any] = {
    **{"bool": bool, "byte": types.uint8, "char": types.uint8, "string": str},
    **{name: getattr(types, name) for name in _NUMBERS},
}


class Cdr(bytes):
    """A message as it is on the wire. sample_info is set by Cyclone."""


def dds_name(kind: str) -> str:
    """sensor_msgs/msg/Image -> sensor_msgs::msg::dds_::Image_."""
    package, _, name = kind.split("/")
    return f"{package}::msg::dds_::{name}_"


def ros_name(name: str) -> str | None:
    """The other way; None for what is no message of ROS."""
    parts = name.split("::")
    if len(parts) != 4 or parts[1:3] != ["msg", "dds_"] or not parts[3].endswith("_"):
        return None
    return f"{parts[0]}/msg/{parts[3][:-1]}"


@cache
def sample_type(kind: str) -> Any:
    """A class whose samples are made by `sample` and come as `Cdr`."""
    made = _struct(kind)
    made.serialize = lambda self, buffer=None, endianness=None, use_version_2=None: self.cdr
    made.deserialize = classmethod(lambda cls, data, has_header=True, use_version_2=None: Cdr(data))
    return made


def sample(kind: str, cdr: bytes) -> Any:
    """A sample of a type, ready to be written."""
    made = object.__new__(sample_type(kind))
    made.cdr = cdr
    return made


@cache
def _struct(kind: str) -> Any:
    from touchline.sources.bags.with_rosbags import field_kinds

    fields = {name: _field(described) for name, described in field_kinds(kind)}
    return make_idl_struct(kind.rpartition("/")[2] + "_", dds_name(kind).replace("::", "."), fields)


def _field(described: Any) -> Any:
    node, value = described
    if node == Nodetype.BASE:
        return _BASE[value[0]]
    if node == Nodetype.NAME:
        return _struct(value)
    of, count = value
    array: Any = types.array
    sequence: Any = types.sequence
    if node == Nodetype.ARRAY:
        return array[_field(of), count]
    return sequence[_field(of), count] if count else sequence[_field(of)]
