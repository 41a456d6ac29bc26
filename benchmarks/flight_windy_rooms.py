"""Quadrotors in random rooms with declared wind: whether they end in the tube of their plant."""

from __future__ import annotations

import dataclasses
import time
import warnings

import drake_rho as rho
from benchmarks.all_cores import on_all_cores
from benchmarks.tables import Goal, Table
from tests.disturbed import windy_room

_FIRST = 1000
"""First seed."""

COLUMNS = (
    "scenes",
    "refused",
    "errors",
    "not in the tube at the end",
    "largest way out of the tube [m]",
    "refused by verify",
    "median [s]",
)


@dataclasses.dataclass(frozen=True)
class Flown:
    """One scene, flown by quadrotors."""

    seed: int
    """seed of the scene"""
    seconds: float
    """processor time [s]"""
    refused: bool = False
    """whether the plant cannot hold what is declared, which is said before it flies"""
    error: str = ""
    """any other error"""
    ended: bool = True
    """whether all vehicles are in the tube at the end"""
    beyond: float = 0.0
    """largest distance outside of the tube at any time [m]"""
    violated: str = ""
    """checks of the true motion that do not hold"""


def run(scenes: int) -> Table:
    """Fly scenes, as many as given, on all cores."""
    return _table(on_all_cores(flown, range(_FIRST, _FIRST + scenes), "rooms"))


def flown(seed: int) -> Flown:
    """Fly one scene."""
    scenario, wind = windy_room(seed)
    began = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rho.DrakeRhoWarning)
        try:
            true = rho.simulate(scenario, wind=wind, plant="quadrotor")
        except rho.InfeasibleError:
            return Flown(seed, time.process_time() - began, refused=True)
        except Exception as error:  # every other one is a fault, whatever it is
            return Flown(
                seed, time.process_time() - began, error=f"{type(error).__name__}: {error}"
            )
    errors, radii = true.errors(), true.radii()
    return Flown(
        seed,
        time.process_time() - began,
        ended=bool((errors[-1] <= radii[-1] + 1e-9).all()),
        beyond=float((errors - radii[:, None]).max()),
        violated="; ".join(
            f"{each.what} by {each.excess:.2g} {each.unit}"
            for each in rho.verify(true).checks
            if not each.holds
        ),
    )


def _table(found: list[Flown]) -> Table:
    seconds = sorted(each.seconds for each in found)
    refused = sum(each.refused for each in found)
    errors = [f"- scene {each.seed}: {each.error}" for each in found if each.error]
    violated = [f"- scene {each.seed}: {each.violated}" for each in found if each.violated]
    outside = sum(not each.ended for each in found)
    beyond = max(each.beyond for each in found)
    row = len(found), refused, len(errors), outside, beyond, len(violated)
    return Table(
        name="flight_windy_rooms",
        title="Quadrotors in random rooms with declared wind",
        columns=COLUMNS,
        rows=((*row, seconds[len(seconds) // 2]),),
        notes=(_WORK, "\n".join(errors + violated) or "No faults."),
        goals=(
            Goal("scenes refused [%]", 10.0, 100.0 * refused / len(found)),
            Goal(
                "scenes that end outside of the tube, or with an error", 0.0, outside + len(errors)
            ),
        ),
    )


_WORK = """\
One or two quadrotors with thrust and attitude fly 2 s in a room of some metres, with steps of 0.02
to 0.1 s, in a constant wind or a gust of the largest declared strength, with no errors of the
estimate. The tube is that of the declared plant, whose lag is a delay of the loop. Refused: the
gains that the plant can hold leave no plan."""
