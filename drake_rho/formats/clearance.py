"""Clearance for bounded deviations from a motion."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.motion.flown import Flown
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.parts import UNITS
from drake_rho.scenario.records import Scenario
from drake_rho.verification.check import Check
from drake_rho.verification.verify import verify

_DISTANCES = ("position", "obstacles", "separation", "requirements")
"""Kinds of requirements on distances, which deviations reduce."""
_NAMED = 8
"""Largest number of constraints that the text names."""
_NEGLIGIBLE = 1e-6
"""Clearance that is printed as zero [m]."""


@dataclasses.dataclass(frozen=True)
class Spare:
    """Least clearance beyond the required distances, before and after deviations.

    The distances are from obstacles, other vehicles, the position box and the boundaries of
    required sets of positions, as in `verify`.
    """

    before: float
    """least clearance of the motion itself [m]; negative if a distance is violated, infinite if
    there are no such constraints"""
    left: float
    """lower bound of the clearance if every vehicle deviates from the motion [m]: each displaced
    towards its closest constraint, and other vehicles towards it"""
    violated: dict[str, float]
    """largest violation of each distance that may be violated, beyond the tolerances of `verify`
    [m], by the name of the constraint; infinite without a bound"""
    closest: str = ""
    """name of the constraint with the least clearance before; empty if there are none"""
    lost: str = ""
    """name of the constraint with the least clearance after"""

    @property
    def keeps_clear(self) -> bool:
        """Whether all distances still hold; if not, they may be violated by up to `-left`."""
        return not self.violated

    def without(self, violations: dict[str, float]) -> Spare:
        """Return the clearance if further distances may be violated.

        Args:
            violations: largest violations [m] by the names of their constraints.
        """
        violated = self.violated | violations
        worst = ((-by, name) for name, by in violated.items())
        left, lost = min([(self.left, self.lost), *worst])
        return dataclasses.replace(self, left=left, violated=violated, lost=lost)

    def __str__(self) -> str:
        if np.isinf(self.before):
            return "which has no distances to keep"
        much = f"{self.before:.3g} m" if self.before > _NEGLIGIBLE else "nothing"
        spare = f"which has {much} to spare beyond the required distances ({self.closest})"
        if self.keeps_clear:
            return f"{spare}: they still hold"
        (first, most), *others = sorted(self.violated.items(), key=lambda each: -each[1])
        texts = [f"{first} may now be violated by {_up_to(most)}"]
        texts += [f"{name} by {_up_to(by)}" for name, by in others[: _NAMED - 1]]
        if len(others) >= _NAMED:
            texts.append(f"{len(others) - _NAMED + 1} more")
        return f"{spare}: {', '.join(texts)}"


def _up_to(distance: float) -> str:
    """Return words for a largest violation [m]."""
    return "any amount" if np.isinf(distance) else f"up to {distance:.3g} m"


def spare_of(flown: Flown, deviations: FloatArray) -> Spare:
    """Return the clearance for all positions of vehicles within their deviations.

    Args:
        flown: the motion.
        deviations: largest distance of each vehicle from its motion [m], shape (N,).
    """
    report, scenario = verify(flown), flown.scenario
    own = dict(zip((vehicle.name for vehicle in scenario.vehicles), deviations, strict=True))
    planned = [check for check in report.checks if not check.is_measured]
    checks = [check for check in planned if check.asked and check.kind in _DISTANCES]
    checks = [check for check in checks if check.unit == UNITS["position"]]
    closer = [_closer_by(check, scenario, own) for check in checks]
    before = [(-check.excess, check.constraint) for check in checks]
    after = [(left - d, name) for (left, name), d in zip(before, closer, strict=True)]
    none = (np.inf, "")
    (most, closest), (left, lost) = min(before, default=none), min(after, default=none)
    violated = dict[str, float]()
    for check, d in zip(checks, closer, strict=True):
        if (by := check.excess + d) > check.tolerance:
            violated[check.constraint] = max(float(by), violated.get(check.constraint, 0.0))
    return Spare(most, left, violated, closest, lost)


def _closer_by(check: Check, scenario: Scenario, deviations: dict[str, float]) -> float:
    """Return the largest loss of a distance by deviations [m].

    For a pair it is the sum of both deviations, with the largest of any other vehicle for the
    second, times the largest scale of the separation's ellipsoid.
    """
    own = deviations[check.vehicle]
    relative = any(
        each.leader is not None and each.called(number) == check.constraint
        for number, each in enumerate(scenario.required, start=1)
    )
    if check.kind != "separation" and not relative:
        return own
    others = max(each for name, each in deviations.items() if name != check.vehicle)
    scale = 1.0
    if check.kind == "separation" and scenario.separation is not None:
        scale = float(scenario.separation.shape.scales.max())
    return scale * (own + others)
