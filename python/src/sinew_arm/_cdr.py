"""Messages of a recording: CDR (XCDR1, little-endian), decoded by the `ros2msg` schema that the file carries."""

from __future__ import annotations

import re
import struct
from typing import Any, Callable

import numpy as np

_KINDS = {
    "bool": ("?", 1),
    "byte": ("B", 1),
    "uint8": ("B", 1),
    "int8": ("b", 1),
    "uint16": ("H", 2),
    "int16": ("h", 2),
    "uint32": ("I", 4),
    "int32": ("i", 4),
    "uint64": ("Q", 8),
    "int64": ("q", 8),
    "float32": ("f", 4),
    "float64": ("d", 8),
}
# Bytes are counted from behind those of the encapsulation.
_HEAD = 4

Read = Callable[[bytes, int], "tuple[Any, int]"]


class Decoder:
    """Decodes one type of message into a dictionary: numbers, numpy arrays, text, dictionaries and lists of them."""

    def __init__(self, schema: str) -> None:
        """Reads a schema.

        Raises:
            ValueError: It has a type that is not known.

        """
        first, *rest = re.split(r"^=+\nMSG: ", schema, flags=re.MULTILINE)
        self._parts = {}
        for part in rest:
            name, _, text = part.partition("\n")
            self._parts[name.strip().rsplit("/", 1)[-1]] = text
        self._made: dict[str, list[tuple[str, Read]]] = {}
        self._fields = self._read_fields(first)

    def decode(self, data: bytes) -> dict[str, Any]:
        """The message.

        Raises:
            ValueError: It is none, or cut short.

        """
        if data[:2] != b"\0\1":
            raise ValueError("no little-endian CDR")
        try:
            return _message(self._fields, data, _HEAD)[0]
        except (struct.error, IndexError) as error:
            raise ValueError(f"the message is cut short: {error}") from None

    def _read_fields(self, text: str) -> list[tuple[str, Read]]:
        fields = []
        for line in text.splitlines():
            words = line.split("#")[0].split()
            # Constants are for readers of the schema.
            if len(words) < 2 or "=" in line:
                continue
            fields.append((words[1], self._read(words[0])))
        return fields

    def _read(self, kind: str) -> Read:
        match = re.fullmatch(r"([\w/]+)(?:\[(\d*)\])?", kind)
        if match is None:
            raise ValueError(f"a schema with the type {kind}, which is not known")
        base, count = match.group(1).rsplit("/", 1)[-1], match.group(2)
        if base in _KINDS:
            form, size = _KINDS[base]
            if count is None:
                return _scalar(form, size)
            return _array(f"<{form}" if size > 1 else form, size, int(count) if count else None)
        one = _text if base == "string" else self._nested(base)
        return one if count is None else _list(one, int(count) if count else None)

    def _nested(self, name: str) -> Read:
        if name not in self._made:
            if name not in self._parts:
                raise ValueError(f"a schema with the type {name}, which it does not have")
            self._made[name] = self._read_fields(self._parts[name])
        fields = self._made[name]
        return lambda data, at: _message(fields, data, at)


def _message(fields: list[tuple[str, Read]], data: bytes, at: int) -> tuple[dict[str, Any], int]:
    message = {}
    for name, read in fields:
        message[name], at = read(data, at)
    return message, at


def _aligned(at: int, size: int) -> int:
    return at + (_HEAD - at) % size


def _scalar(form: str, size: int) -> Read:
    unpack = struct.Struct(f"<{form}").unpack_from

    def read(data: bytes, at: int) -> tuple[Any, int]:
        place = _aligned(at, size)
        return unpack(data, place)[0], place + size

    return read


def _length(data: bytes, at: int) -> tuple[int, int]:
    place = _aligned(at, 4)
    (count,) = struct.unpack_from("<I", data, place)
    return count, place + 4


def _array(form: str, size: int, fixed: int | None) -> Read:
    kind = np.dtype(form)

    def read(data: bytes, at: int) -> tuple[Any, int]:
        count, place = (fixed, at) if fixed is not None else _length(data, at)
        if count == 0:
            return np.empty(0, kind), place
        place = _aligned(place, size)
        end = place + count * size
        if end > len(data):
            raise IndexError(f"{end} bytes, there are {len(data)}")
        return np.frombuffer(data, kind, count, place), end

    return read


def _text(data: bytes, at: int) -> tuple[Any, int]:
    count, place = _length(data, at)
    if place + count > len(data):
        raise IndexError(f"{place + count} bytes, there are {len(data)}")
    return data[place : place + count].rstrip(b"\0").decode(errors="replace"), place + count


def _list(one: Read, fixed: int | None) -> Read:
    def read(data: bytes, at: int) -> tuple[Any, int]:
        count, at = (fixed, at) if fixed is not None else _length(data, at)
        items = []
        for _ in range(count):
            item, at = one(data, at)
            items.append(item)
        return items, at

    return read
