"""Recordings: what the daemon and the planner write, compared with an independent decoder."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

import sinew_arm as sinew
from conftest import Start
from sinew_arm import Arm, Recording, SinewError, SupervisorState
from sinew_arm._cdr import Decoder
from sinew_arm.simulated import find_program


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a scenario of the paper."""
    program = find_program("sinew", os.environ.get("SINEW_PROGRAMS"))
    out = tmp_path_factory.mktemp("plan") / "plan.mcap"
    subprocess.run([program, "plan", "tip-no-avoidance", "--out", out], check=True, capture_output=True)
    return out


EVERY = 25


def independent(path: Path, topic: str) -> list[Any]:
    """Every 25th message: it takes its time."""
    with path.open("rb") as file:
        found = list(make_reader(file).iter_messages(topics=topic))[::EVERY]
        decoded = []
        for schema, channel, message in found:
            decode = DecoderFactory().decoder_for(channel.message_encoding, schema)
            assert decode is not None
            decoded.append(decode(message.data))
        return decoded


def same(ours: Any, theirs: Any) -> None:
    if isinstance(ours, dict):
        for name, value in ours.items():
            if name != "log_time_ns":
                same(value, getattr(theirs, name))
    elif isinstance(ours, list):
        assert len(ours) == len(theirs)
        for a, b in zip(ours, theirs):
            same(a, b)
    else:
        np.testing.assert_array_equal(ours, theirs)


def test_every_field_is_that_of_an_independent_decoder(planned: Path) -> None:
    recording = Recording(planned)
    assert recording.arm == "paper"
    for topic in recording.topics:
        ours = list(recording.messages(topic))[::EVERY]
        theirs = independent(planned, f"sinew/paper/{topic}")
        assert len(ours) == len(theirs)
        for a, b in zip(ours, theirs):
            same(a, b)
    # Nothing was compared with nothing.
    assert len(list(recording.messages("state"))) >= 20 * EVERY


def test_a_run_as_arrays_and_as_a_table(start: Start) -> None:
    simulated = start(record=True)
    with Arm(simulated.name, domain=simulated.domain) as arm:
        watch = arm.watch()
        arm.arm()
        # Obstacles come and go.
        watch.show([sinew.ball(1, (0.6, 0.0, -1.0), 0.1)])
        for state in arm.states(timeout_s=10):
            if state.distances:
                break
        arm.disarm()
        assert simulated.end_daemon() == 0
        watch.close()
    recording = Recording(simulated.recording)
    assert recording.topics == ["events", "obstacles", "state", "target"]
    arrays = recording.arrays()
    rows = len(arrays["time_s"])
    assert {len(column) for column in arrays.values()} == {rows}
    assert arrays["tension_command_n"].shape == (rows, 24)
    assert arrays["nodes.position_m"].shape == (rows, 20, 3)
    assert np.all(np.diff(arrays["header.tick"]) == 1)
    assert set(arrays["supervisor"]) >= {SupervisorState.DISARMED, SupervisorState.HOLDING}
    lengths = {len(listed) for listed in arrays["distances"]}
    assert lengths == {0, 1}
    table = recording.frame()
    assert table.shape[0] == rows
    assert table.index.name == "time_s"
    np.testing.assert_array_equal(table["tip_position_m.2"], arrays["tip_position_m"][:, 2])
    np.testing.assert_array_equal(table["nodes.position_m.19.2"], arrays["nodes.position_m"][:, 19, 2])
    assert "arm" in list(recording.arrays("events")["text"])
    assert recording.settings["arm"]["name"] == "paper"
    assert recording.metadata["arm"] == "paper"
    assert b"[arm]" in recording.attachment("configuration.toml")
    with pytest.raises(KeyError, match="no attachment"):
        recording.attachment("nothing")
    with pytest.raises(KeyError, match="no topic nothing; there are events"):
        recording.arrays("nothing")


def test_a_file_that_was_cut_short_is_read_as_far_as_it_goes(planned: Path, tmp_path: Path) -> None:
    whole = Recording(planned).arrays()
    data = planned.read_bytes()
    cut = tmp_path / "cut.mcap"
    counts = []
    for share in (0.6, 0.9, 0.999):
        cut.write_bytes(data[: int(share * len(data))])
        recording = Recording(cut)
        arrays = recording.arrays() if "state" in recording.topics else {"time_s": np.empty(0)}
        count = len(arrays["time_s"])
        counts.append(count)
        np.testing.assert_array_equal(arrays["time_s"], whole["time_s"][:count])
        assert recording.metadata == {}
    assert counts == sorted(counts)
    assert counts[-1] > 0


def test_what_is_no_recording_is_refused(tmp_path: Path) -> None:
    other = tmp_path / "other.mcap"
    other.write_text("nothing of the kind")
    with pytest.raises(SinewError, match="no recording of sinew"):
        Recording(other)
    with pytest.raises(FileNotFoundError):
        Recording(tmp_path / "missing.mcap")


def test_messages_that_are_cut_short_are_told() -> None:
    decoder = Decoder("uint8 a\nuint32 b\nstring c\nPart[] d\n====\nMSG: x/Part\nuint32 e\nfloat64[2] f\n")
    head = b"\0\1\0\0"
    part = b"\x05\0\0\0" + bytes(16)
    whole = head + b"\x01\0\0\0" + b"\x02\0\0\0" + b"\x03\0\0\0ab\0" + b"\0" + b"\x01\0\0\0" + part
    message = decoder.decode(whole)
    assert (message["a"], message["b"], message["c"]) == (1, 2, "ab")
    assert message["d"][0]["e"] == 5
    for length in range(4, len(whole)):
        with pytest.raises(ValueError, match="cut short"):
            decoder.decode(whole[:length])
    with pytest.raises(ValueError, match="no little-endian CDR"):
        decoder.decode(b"\0\0\0\0" + whole[4:])
    with pytest.raises(ValueError, match="Other"):
        Decoder("Other x\n")
