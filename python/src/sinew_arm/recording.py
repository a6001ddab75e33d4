"""Recordings (MCAP) as numpy arrays and pandas tables."""

from __future__ import annotations

import json
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader, make_reader

from ._cdr import Decoder
from .errors import SinewError

if TYPE_CHECKING:
    import os
    from collections.abc import Iterator

    import pandas as pd

Columns = dict[str, npt.NDArray[Any]]


class Recording:
    """What `sinew run --record`, `demo --keep` and `plan --out` write. A file that was cut short is read as far as it goes.

    Attributes:
        path: The file.
        arm: Name of the arm, as its topics have it.
        topics: Topics with sinew's own messages, without `sinew/<arm>/`: `state`, `obstacles`, `target`, `events`.

    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Looks into a file.

        Raises:
            FileNotFoundError: It is not there.
            SinewError: It is no recording of sinew.

        """
        self.path = Path(path)
        self._decoders: dict[int, Decoder] = {}
        self._whole = True
        names: set[str] = set()
        with self.path.open("rb") as file:
            try:
                summary = make_reader(file).get_summary()
                channels = summary.channels.values() if summary is not None else []
                names = {channel.topic for channel in channels if channel.message_encoding == "cdr"}
            except (McapError, EOFError):
                self._whole = False
        if not names:
            self._whole = False
            names = {topic for topic, _, _ in self._raw(None)}
        parts = [name.split("/") for name in names if name.startswith("sinew/")]
        if not parts:
            raise SinewError(f"{self.path} is no recording of sinew, or has nothing in it yet")
        self.arm = parts[0][1]
        self.topics = sorted("/".join(part[2:]) for part in parts)

    def messages(self, topic: str = "state") -> Iterator[dict[str, Any]]:
        """Messages of a topic, in their order, as dictionaries with arrays; `log_time_ns` is when each was recorded.

        Raises:
            KeyError: The recording has no such topic.

        """
        if topic not in self.topics:
            raise KeyError(f"no topic {topic}; there are {', '.join(self.topics)}")
        for _, log_time_ns, message in self._raw(f"sinew/{self.arm}/{topic}"):
            yield {"log_time_ns": log_time_ns, **message}

    def arrays(self, topic: str = "state") -> Columns:
        """A topic as arrays whose first axis is the message.

        Fields of a message inside have a dot (`header.tick`). What has the same shape in every message is an array of
        numbers: `tension_command_n` is (messages, cables), `nodes.position_m` (messages, nodes, 3). What has not, such as
        `distances` where obstacles come and go, is an array of objects.
        """
        columns: dict[str, list[Any]] = {}
        for message in self.messages(topic):
            for name, value in _flat("", message):
                columns.setdefault(name, []).append(value)
        return {key: array for name, values in columns.items() for key, array in _arrays(name, values)}

    def frame(self, topic: str = "state") -> pd.DataFrame:
        """A topic as a pandas table: a row for each message, a column for each number (`tip_position_m.0`).

        States are indexed by `time_s`. Lists whose length changes stay lists.

        Raises:
            SinewError: pandas is not installed.

        """
        try:
            import pandas as pd
        except ImportError:
            raise SinewError("a table needs pandas: pip install 'sinew-arm[pandas]'") from None
        table: dict[str, Any] = {}
        for name, values in self.arrays(topic).items():
            if values.ndim == 1:
                table[name] = values
                continue
            flat = values.reshape(len(values), int(np.prod(values.shape[1:])))
            for column, place in enumerate(np.ndindex(values.shape[1:])):
                table[".".join([name, *map(str, place)])] = flat[:, column]
        made = pd.DataFrame(table)
        return made.set_index("time_s") if "time_s" in made.columns else made

    @property
    def metadata(self) -> dict[str, str]:
        """What the file says of itself; `wall_clock_offset_ns` is what is added to CLOCK_MONOTONIC for UTC."""
        found: dict[str, str] = {}
        if self._whole:
            with self.path.open("rb") as file:
                for record in make_reader(file).iter_metadata():
                    found.update(record.metadata)
        return found

    def attachment(self, name: str) -> bytes:
        """An attached file: `software.json`, `settings.json`, `configuration.toml`.

        Raises:
            KeyError: There is none of this name, or the file was cut short before it.

        """
        with self.path.open("rb") as file:
            for attachment in make_reader(file).iter_attachments() if self._whole else ():
                if attachment.name == name:
                    return bytes(attachment.data)
        raise KeyError(f"{self.path} has no attachment {name}")

    @property
    def settings(self) -> dict[str, Any]:
        """Every setting as it came out, in SI units."""
        return dict(json.loads(self.attachment("settings.json")))

    def _raw(self, topic: str | None) -> Iterator[tuple[str, int, dict[str, Any]]]:
        """Topic, time and content; of a whole file by its index, else as far as it goes."""
        with self.path.open("rb") as file:
            found = _indexed(file, topic) if self._whole else _unindexed(file, topic)
            for schema, channel, message in found:
                if channel.message_encoding != "cdr" or schema is None:
                    continue
                decoder = self._decoders.get(schema.id)
                if decoder is None:
                    decoder = self._decoders[schema.id] = Decoder(schema.data.decode())
                yield channel.topic, message.log_time, decoder.decode(message.data)


def _indexed(file: IO[bytes], topic: str | None) -> Iterator[tuple[Any, Any, Any]]:
    yield from make_reader(file).iter_messages(topics=topic)


def _unindexed(file: IO[bytes], topic: str | None) -> Iterator[tuple[Any, Any, Any]]:
    messages = NonSeekingReader(file).iter_messages(topics=topic, log_time_order=False)
    while True:
        try:
            found = next(messages)
        except (StopIteration, McapError, EOFError):
            return
        yield found


def _flat(prefix: str, message: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    for key, value in message.items():
        name = f"{prefix}{key}"
        if isinstance(value, dict):
            yield from _flat(f"{name}.", value)
        else:
            yield name, value


def _arrays(name: str, values: list[Any]) -> Iterator[tuple[str, npt.NDArray[Any]]]:
    """A column, or one for each field where it has the same number of alike messages in every row."""
    if isinstance(values[0], list):
        items = [item for value in values for item in value]
        counts = {len(value) for value in values}
        if len(counts) == 1 and items and isinstance(items[0], dict) and _alike(items):
            for inner in items[0]:
                yield f"{name}.{inner}", np.array([[item[inner] for item in value] for value in values])
            return
    elif len({np.shape(value) for value in values}) == 1:
        yield name, np.array(values)
        return
    objects = np.empty(len(values), dtype=object)
    objects[:] = values
    yield name, objects


def _alike(items: list[dict[str, Any]]) -> bool:
    """Whether messages have the same shapes, and nothing inside."""
    plain = all(not isinstance(value, (dict, list)) for value in items[0].values())
    return plain and all(len({np.shape(item[key]) for item in items}) == 1 for key in items[0])
