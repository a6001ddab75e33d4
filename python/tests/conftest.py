"""A simulated arm with its daemon for every test that asks for one."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Callable

import pytest

from sinew_arm import Arm, SimulatedArm, Watch

ROOT = Path(__file__).resolve().parents[2]
CONFIG = [ROOT / "config" / name for name in ("arm.toml", "controller.toml", "drives.toml", "plant.toml")]

Start = Callable[..., SimulatedArm]


@pytest.fixture(autouse=True)
def _no_domain_of_the_user(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("SINEW_IPC_PREFIX", "SINEW_IPC_ROOT", "SINEW_RUN_DIR"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def start() -> Iterator[Start]:
    """Starts simulated arms, which end with the test."""
    running: list[SimulatedArm] = []

    def begin(**options: object) -> SimulatedArm:
        arm = SimulatedArm(CONFIG, programs=os.environ.get("SINEW_PROGRAMS"), **options)  # type: ignore[arg-type]
        running.append(arm)
        return arm

    yield begin
    for arm in running:
        arm.close()


@pytest.fixture
def simulated(start: Start) -> SimulatedArm:
    """The paper's arm in lockstep, whose every tick waits for source 1."""
    return start()


@pytest.fixture
def arm(simulated: SimulatedArm) -> Iterator[Arm]:
    """Its client."""
    with Arm(simulated.name, domain=simulated.domain) as client:
        yield client


@pytest.fixture
def watch(arm: Arm) -> Iterator[Watch]:
    """Source 1, which sees nothing."""
    with arm.watch() as source:
        yield source
