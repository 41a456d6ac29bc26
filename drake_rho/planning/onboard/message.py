"""Messages by which vehicles share their plans: bytes with a version and a checksum.

A message has everything that its sender may fly from then on: the plan to which it has committed
itself, and the one that it has announced, if any. So a later message replaces all earlier ones, and
those that are lost, repeated or late do no harm.
"""

from __future__ import annotations

import dataclasses
import struct
import zlib

import numpy as np

from drake_rho.planning.onboard.shared_plan import SharedPlan
from drake_rho.scenario.errors import DrakeRhoError, shorten
from drake_rho.scenario.fields import LARGEST

LONGEST = 65_000
"""Largest number of bytes of a message, which fits into one UDP datagram."""

_MAGIC = b"rho-plan\x01"
"""First bytes of a message; the last of them is the version of the format."""

_HEAD = struct.Struct("<QBB")
"""Number of the message, number of its plans, and number of bytes of the sender's name."""

_PLAN = struct.Struct("<10dI")
"""Announcement, start, step, radius, state, and number of accelerations of a plan."""

_SUM = struct.Struct("<I")
"""Checksum of all bytes before it."""

_STEPS = 1e-4, 1e4
"""Shortest and longest step of a plan [s]."""


class MessageError(DrakeRhoError, ValueError):
    """Error for a message that is not one, or whose plans do not hold.

    Attributes:
        sender: name of the sender as far as it is known; None if not.
        reason: what is wrong.
    """

    def __init__(self, sender: str | None, reason: str) -> None:
        self.sender, self.reason = sender, reason
        super().__init__(sender, reason)

    def __str__(self) -> str:
        whose = "message" if self.sender is None else f"message of {shorten(self.sender)}"
        return f"{whose}: {self.reason}"


@dataclasses.dataclass(frozen=True, eq=False)
class Message:
    """What a vehicle may fly from now on."""

    sender: str
    """name of the vehicle"""
    number: int
    """number of the message: one with a larger number is newer"""
    committed: SharedPlan
    """plan to which it has committed itself"""
    announced: SharedPlan | None = None
    """plan that it may fly instead, unless it is withdrawn"""

    @property
    def plans(self) -> tuple[SharedPlan, ...]:
        """Both plans, or the only one."""
        return (self.committed,) if self.announced is None else (self.committed, self.announced)

    def encoded(self) -> bytes:
        """Return the message as bytes.

        Raises:
            MessageError: it is too long.
        """
        name = self.sender.encode()
        if len(name) > 255:
            raise MessageError(self.sender, f"got a name of {len(name)} bytes, expected 255")
        parts = [_MAGIC, _HEAD.pack(self.number, len(self.plans), len(name)), name]
        for each in self.plans:
            numbers = each.announced, each.start, each.step, each.radius, *each.state
            parts += [_PLAN.pack(*numbers, len(each.accelerations))]
            parts += [each.accelerations.astype("<f8").tobytes()]
        body = b"".join(parts)
        if len(body) + _SUM.size > LONGEST:
            reason = f"got {len(body)} bytes, expected at most {LONGEST}: a shorter horizon"
            raise MessageError(self.sender, reason)
        return body + _SUM.pack(zlib.crc32(body))

    @classmethod
    def decoded(cls, data: bytes) -> Message:
        """Return the message in some bytes.

        Raises:
            MessageError: they are no message of this version, damaged, or have numbers that no
                plan has.
        """
        if not isinstance(data, bytes | bytearray | memoryview):
            raise MessageError(None, f"got {type(data).__name__}, expected bytes")
        data = bytes(data)
        if not len(_MAGIC) + _HEAD.size + _SUM.size <= len(data) <= LONGEST:
            raise MessageError(None, f"got {len(data)} bytes, expected at most {LONGEST}")
        if not data.startswith(_MAGIC):
            raise MessageError(None, f"got {data[: len(_MAGIC)]!r}, expected {_MAGIC!r} at first")
        body, check = data[: -_SUM.size], data[-_SUM.size :]
        if _SUM.unpack(check)[0] != zlib.crc32(body):
            raise MessageError(None, "the checksum is wrong: it is damaged")
        try:
            return cls._of(body)
        except (struct.error, UnicodeDecodeError, ValueError) as error:
            raise MessageError(None, f"its lengths do not fit: {error}") from None

    @classmethod
    def _of(cls, body: bytes) -> Message:
        """Return the message in bytes without the checksum."""
        number, count, length = _HEAD.unpack_from(body, len(_MAGIC))
        begin = len(_MAGIC) + _HEAD.size
        sender, begin = body[begin : begin + length].decode(), begin + length
        if count not in (1, 2):
            raise ValueError(f"got {count} plans, expected 1 or 2")
        plans = list[SharedPlan]()
        for _ in range(count):
            *numbers, steps = _PLAN.unpack_from(body, begin)
            begin += _PLAN.size
            a = np.frombuffer(body, "<f8", 3 * steps, begin).astype(np.float64).reshape(-1, 3)
            begin += a.nbytes
            announced, start, step, radius, *state = numbers
            plan = SharedPlan(announced, start, step, np.array(state), a, radius)
            plans.append(_checked(plan))
        if begin != len(body):
            raise ValueError(f"got {len(body)} bytes, expected {begin}")
        return cls(sender, number, *plans)


def _checked(plan: SharedPlan) -> SharedPlan:
    """Return a plan whose numbers are possible.

    Raises:
        ValueError: they are not.
    """
    single = np.array([plan.announced, plan.start, plan.step, plan.radius])
    every = np.concatenate([single, plan.state, plan.accelerations.ravel()])
    if not (np.abs(every) <= LARGEST).all():  # also for NaN
        raise ValueError(f"expected finite numbers of at most {LARGEST:g}")
    if len(plan.accelerations) == 0 or not _STEPS[0] <= plan.step <= _STEPS[1]:
        raise ValueError(f"expected steps of {_STEPS[0]:g} to {_STEPS[1]:g} s, one or more")
    if plan.radius < 0.0:
        raise ValueError("expected a radius of at least 0 m")
    return plan
