"""What can go wrong. Every exception of this package is a `SinewError`, and says what to do about it where that is known."""

from __future__ import annotations

from .payloads import RefusalReason, RejectCause, SupervisorState


class SinewError(Exception):
    """Anything that this package raises of its own."""


class NoDaemonError(SinewError):
    """No daemon runs for the arm."""


class NotPermittedError(SinewError):
    """A daemon is there, and this user may not do that: `[access]` of its configuration says who may."""


class IncompatibleError(SinewError):
    """The daemon is of another version."""


class UnusableError(SinewError):
    """Shared memory, or the socket, cannot be used."""


class TimedOutError(SinewError, TimeoutError):
    """What was waited for did not happen in time."""


class InterruptedMotionError(SinewError):
    """The arm left the mode that was waited for without a fault: somebody else asked for something else."""

    def __init__(self, message: str, supervisor: SupervisorState) -> None:
        """Keeps the mode in which the arm is."""
        super().__init__(message)
        self.supervisor = supervisor


class RefusedError(SinewError):
    """The daemon does not carry out a request; the message is the daemon's.

    Attributes:
        asked: What was asked for.
        reason: Why, as a code.
        detail: A number that belongs to the reason.
        cause: What is wrong with a target, where the reason is `RefusalReason.BAD_TARGET`.
        supervisor: Mode of the arm after the request.
        fault_code: The latched fault, 0 without one.

    """

    def __init__(
        self, asked: str, reason: RefusalReason, detail: int, supervisor: SupervisorState, fault_code: int, text: str
    ) -> None:
        """Says what was refused and why."""
        super().__init__(f"{asked} is refused: {text}")
        self.asked = asked
        self.reason = reason
        self.detail = detail
        self.cause = RejectCause(detail) if reason is RefusalReason.BAD_TARGET else None
        self.supervisor = supervisor
        self.fault_code = fault_code
        self.text = text


class RejectedError(SinewError):
    """The daemon does not take over what is published; the message is the daemon's."""


class FaultError(SinewError):
    """A fault is latched.

    Attributes:
        code: Code of the fault (docs/CODES.md).
        detail: What it is about (cable, drive, source), by code.
        what: What happened.
        clears: What clears it.

    """

    def __init__(self, code: int, detail: int, what: str, clears: str) -> None:
        """Says what happened and what clears it."""
        super().__init__(f"fault {code}: {what}" + (f" (to clear it: {clears})" if clears else ""))
        self.code = code
        self.detail = detail
        self.what = what
        self.clears = clears
