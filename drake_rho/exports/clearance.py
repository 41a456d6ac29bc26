"""Whether vehicles still keep clear when they are a little off what was planned."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.motion.plan import Flight, Plan
from drake_rho.motion.simulation import Simulation
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Scenario
from drake_rho.verification.report import Check
from drake_rho.verification.verify import verify

_SEPARATION = "separation"
_NOTHING = 1e-6
"""What is told as nothing [m]."""


@dataclasses.dataclass(frozen=True)
class Spare:
    """What `verify` finds left of the distances from obstacles, others and the position box."""

    before: float
    """least of it in the motion itself [m]; negative where it is too close, infinite where there is
    nothing to keep clear of"""
    left: float
    """what is left of it at least when every vehicle is off by its deviation towards what it is
    close to, and others towards it [m]"""
    keeps_clear: bool
    """whether that is within what `verify` puts down to rounding; if not, vehicles may be too close
    by `-left`, or may not"""

    def __str__(self) -> str:
        if np.isinf(self.before):
            return "which has nothing to keep clear of"
        much = f"{self.before:.3g} m" if self.before > _NOTHING else "nothing"
        held = f"which has {much} to spare from what it keeps clear of"
        if self.keeps_clear:
            return f"{held}: it still keeps clear"
        return f"{held}: it may now be too close by up to {-self.left:.3g} m"


def spare(flown: Plan | Flight | Simulation, deviations: FloatArray) -> Spare:
    """What is left of all clearances, wherever within their deviations the vehicles are.

    Args:
        flown: the motion.
        deviations: how far each vehicle is from it, at most [m], shape (N,).
    """
    report, scenario = verify(flown), flown.scenario
    off = dict(zip((vehicle.name for vehicle in scenario.vehicles), deviations, strict=True))
    kept = {"position box", _SEPARATION}
    kept |= {scenario.obstacle_name(index + 1) for index in range(len(scenario.obstacles))}
    checks = [check for check in report.checks if check.asked and check.constraint in kept]
    closer = [_closer_by(check, scenario, off) for check in checks]
    return Spare(
        min((-check.excess for check in checks), default=np.inf),
        min((-check.excess - d for check, d in zip(checks, closer, strict=True)), default=np.inf),
        all(c.excess + d <= c.tolerance for c, d in zip(checks, closer, strict=True)),
    )


def _closer_by(check: Check, scenario: Scenario, off: dict[str, float]) -> float:
    """By how much a distance may be less when vehicles are off [m].

    Of a pair both are, whoever the other one is; where the separation is flat, a metre along z
    counts for more.
    """
    own = off[check.vehicle]
    if check.constraint != _SEPARATION or scenario.separation is None:
        return own
    others = max(each for name, each in off.items() if name != check.vehicle)
    return float(scenario.separation.shape.scales.max()) * (own + others)
