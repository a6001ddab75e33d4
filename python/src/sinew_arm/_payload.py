"""What all payloads and codes have in common."""

from __future__ import annotations

import ctypes
from enum import IntEnum
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.uint64]
BoolArray = npt.NDArray[np.bool_]

if TYPE_CHECKING:
    from typing_extensions import Self


class Code(IntEnum):
    """A number on the wire with a meaning. A number of a later version becomes a member `UNKNOWN_<number>`."""

    @classmethod
    def _missing_(cls, value: object) -> Code | None:
        if not isinstance(value, int):
            return None
        member = int.__new__(cls, value)
        member._name_ = f"UNKNOWN_{value}"
        member._value_ = value
        return member

    @property
    def words(self) -> str:
        """The name for people: `emergency stop`."""
        return self.name.lower().replace("_", " ")

    def __str__(self) -> str:
        """The name for people."""
        return self.words


class Payload(ctypes.Structure):
    """A message of shared memory, byte by byte as `src/ipc/PAYLOADS.md` has it."""

    FIELDS: ClassVar[tuple[str, ...]] = ()

    @staticmethod
    def type_name() -> str:
        """Name by which shared memory knows the type."""
        raise NotImplementedError

    def copy(self) -> Self:
        """A payload of its own with the same content."""
        return type(self).from_buffer_copy(self)

    def to_dict(self) -> dict[str, Any]:
        """Every field by its name; arrays as copies, payloads inside as dictionaries."""
        return {name: _plain(getattr(self, name)) for name in self.FIELDS}

    def __eq__(self, other: object) -> bool:
        """Whether both have the same bytes."""
        return type(self) is type(other) and bytes(self) == bytes(_buffer(other))

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        """Type and fields."""
        fields = ", ".join(f"{name}={value!r}" for name, value in self.to_dict().items())
        return f"{type(self).__name__}({fields})"

    def _array(self, name: str, kind: Any, shape: tuple[int, ...]) -> npt.NDArray[Any]:
        place = getattr(type(self), f"_{name}")
        count = int(np.prod(shape))
        return np.frombuffer(_buffer(self), dtype=kind, count=count, offset=place.offset).reshape(shape)

    def _put(self, name: str, kind: Any, shape: tuple[int, ...], value: npt.ArrayLike) -> None:
        given = np.asarray(value, dtype=kind)
        if given.ndim != len(shape) or given.shape[1:] != shape[1:] or len(given) > shape[0]:
            most = (
                f"({shape[0]} at most, {', '.join(map(str, shape[1:]))})" if len(shape) > 1 else f"{shape[0]} at most"
            )
            raise ValueError(f"{type(self).__name__}.{name}: shape {given.shape}, expected {most}")
        array = self._array(name, kind, shape)
        array[: len(given)] = given
        array[len(given) :] = 0

    def _bits(self, name: str, count: int) -> BoolArray:
        octets = self._array(name, np.uint8, (count // 8,))
        return np.unpackbits(octets, bitorder="little").astype(np.bool_)

    def _set_bits(self, name: str, count: int, value: npt.ArrayLike) -> None:
        given = np.asarray(value, dtype=np.bool_)
        if given.ndim != 1 or len(given) > count:
            raise ValueError(f"{type(self).__name__}.{name}: shape {given.shape}, expected {count} at most")
        bits = np.zeros(count, dtype=np.uint8)
        bits[: len(given)] = given
        self._array(name, np.uint8, (count // 8,))[:] = np.packbits(bits, bitorder="little")

    def _get_text(self, name: str) -> str:
        return bytes(getattr(self, f"_{name}")).split(b"\0")[0].decode(errors="replace")

    def _set_text(self, name: str, value: str) -> None:
        place = getattr(self, f"_{name}")
        # Cut at a character.
        kept = value.encode()[: len(place)].decode(errors="ignore").encode()
        place[:] = kept.ljust(len(place), b"\0")

    @staticmethod
    def _list(items: Any, count: int) -> list[Any]:
        return [items[i] for i in range(min(count, len(items)))]


def _buffer(payload: Any) -> Any:
    """A payload as a buffer, which it is."""
    return payload


def _plain(value: Any) -> Any:
    if isinstance(value, Payload):
        return value.to_dict()
    if isinstance(value, list):
        return [_plain(item) for item in value]
    return value.copy() if isinstance(value, np.ndarray) else value
