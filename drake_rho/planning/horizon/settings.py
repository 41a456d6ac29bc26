"""Settings of windows, the common keyword arguments of functions that fly a receding horizon.

`RecedingHorizon` documents and checks them, and has their defaults.
"""

from __future__ import annotations

import inspect
from typing import Annotated, TypedDict, cast

from pydantic import Field

from drake_rho.planning.call.options import Options
from drake_rho.planning.call.progress import Progress
from drake_rho.planning.horizon.interfaces import (
    Planner,
    Reference,
    free_reference,
    tail_reference,
)
from drake_rho.planning.horizon.receding_horizon import RecedingHorizon
from drake_rho.planning.planners.convex import plan_convex
from drake_rho.planning.planners.plan import plan
from drake_rho.planning.programs.backend import Solver, SolverName
from drake_rho.scenario.arguments import passes_to
from drake_rho.scenario.fields import Count, Margin, Positive, record


class Windows(TypedDict, total=False):
    """Settings of windows: the keyword arguments of `RecedingHorizon`."""

    replan_every: int
    free_final_time: bool
    planner: Planner
    fallback: Planner | None
    reference: Reference | None
    solver: Solver | SolverName | None
    progress: Progress | None
    options: Options | None
    contingencies: bool
    latency: float
    bounded_cost: bool
    horizon: float | None
    rest_for: float


DEFAULTS = cast(
    Windows,
    {
        name: each.default
        for name, each in inspect.signature(RecedingHorizon).parameters.items()
        if each.kind is each.KEYWORD_ONLY
    },
)
"""Settings of calls that give none."""

takes_windows = passes_to(RecedingHorizon)
"""Decorator of functions with `**windows: Unpack[Windows]`, whose signatures then list them."""


@record
class PlainSettings:
    """Settings of windows that are numbers or truth values, for studies and the command line.

    Descriptions are in the annotations, which records inherit; docstrings under fields they do not.
    """

    replan_every: Annotated[
        Count,
        Field(ge=1, description="number of steps flown of each window before the next is planned"),
    ] = DEFAULTS["replan_every"]
    free_final_time: Annotated[
        bool,
        Field(
            description="whether windows arrive at the earliest knot for which a plan is found, "
            "after which vehicles rest; otherwise they arrive at the last knot"
        ),
    ] = DEFAULTS["free_final_time"]
    contingencies: Annotated[
        bool,
        Field(
            description="whether every window also plans how to brake to rest, clear of everything "
            "known, in case something seen late leaves no plan"
        ),
    ] = DEFAULTS["contingencies"]
    latency: Annotated[
        Margin | None,
        Field(
            description="seconds that planning a window takes, at most those for which it is "
            "flown: windows are planned that much ahead, from predicted states"
        ),
    ] = None
    bounded_cost: Annotated[
        bool,
        Field(
            description="whether a new plan is accepted only if it costs no more than the rest of "
            "the previous one, moved to the measured states, so that the cost of the flight has a "
            "bound"
        ),
    ] = DEFAULTS["bounded_cost"]
    horizon: Annotated[
        Positive | None,
        Field(
            description="seconds that every window plans ahead, ending at rest where vehicles may "
            "stay; if not given, windows plan up to the last knot"
        ),
    ] = DEFAULTS["horizon"]
    rest_for: Annotated[
        Positive | None,
        Field(
            description="seconds for which vehicles have to be able to stay where a window of such "
            f"a horizon ends, as long as errors of obstacles grow; {DEFAULTS['rest_for']:g} if not "
            "given"
        ),
    ] = None


_REFERENCES = {None: None, "free": free_reference, "tail": tail_reference}


def by_names(windows: str, reference: str | None, iterated: Planner = plan) -> Windows:
    """Return the planners and the reference of windows by their names in commands and studies.

    Args:
        windows: convex for `plan_convex`, scp for `plan`, or auto for `plan` where `plan_convex`
            has no solution.
        reference: free or tail; None for the default.
        iterated: `plan`, possibly with arguments.
    """
    planner, fallback = {
        "auto": (plan_convex, iterated),
        "convex": (plan_convex, None),
        "scp": (iterated, None),
    }[windows]
    return {"planner": planner, "fallback": fallback, "reference": _REFERENCES[reference]}


def refuse_settings(windows: Windows, flown: str) -> None:
    """Check that all settings of windows are the defaults, where no windows are planned.

    Args:
        windows: settings that were given.
        flown: kind of the motion that is flown without windows.

    Raises:
        ValueError: a setting differs from its default.
    """
    for name, value in windows.items():
        if name != "progress" and value != DEFAULTS[name]:  # type: ignore[literal-required]
            expected = f"none for a {flown}, which is flown as it is"
            raise ValueError(
                f"{name}: got {getattr(value, '__name__', value)}, expected {expected}"
            )
