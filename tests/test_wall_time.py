"""`Statistics.seconds`: wall time from a planner's call to its return, in all reports of times."""

import itertools
import pickle
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import drake_rho as rho
from tests.scenarios import single, through_the_middle
from tests.studies import small, table

ASKED = single(obstacles=(rho.Sphere([5.0, 2.1, -1.0], 1.0),))
FLEET = through_the_middle(4)
STRAIGHT = rho.Plan.from_accelerations(ASKED, rho.plan(ASKED.without_obstacles()).accelerations)
IMPOSSIBLE = single(limits=rho.Limits(max_speed=0.5))

PLANNERS = [
    pytest.param(lambda: rho.plan(ASKED), id="plan"),
    pytest.param(lambda: rho.plan(single()), id="plan of minimum effort"),
    pytest.param(lambda: rho.plan(FLEET), id="plan of a fleet"),
    pytest.param(lambda: rho.plan_scp(ASKED, reference=STRAIGHT), id="plan_scp"),
    pytest.param(lambda: rho.plan_convex(ASKED), id="plan_convex"),
    pytest.param(lambda: rho.plan_rho(ASKED, replan_every=4), id="plan_rho"),
    pytest.param(lambda: rho.scp_step(STRAIGHT), id="scp_step"),
    pytest.param(
        lambda: rho.shortest_plan(single(limits=rho.Limits(max_speed=2.0))), id="shortest_plan"
    ),
]


class Clock:
    """Clock that advances by a second with every reading."""

    def __init__(self) -> None:
        self.seconds = itertools.count()

    def __call__(self) -> float:
        """Return a second more than at the last reading."""
        return float(next(self.seconds))

    @property
    def last(self) -> float:
        """Last reading; the clock must not be read afterwards."""
        return float(next(self.seconds)) - 1.0


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Iterator[Clock]:
    """Set the clock of all code under test; its first reading is 0."""
    made = Clock()
    with monkeypatch.context() as patched:
        patched.setattr(time, "perf_counter", made)
        yield made


@pytest.mark.parametrize("planner", PLANNERS)
def test_seconds_are_from_the_call_to_the_return(
    planner: Callable[[], rho.Plan | rho.Flight], clock: Clock
) -> None:
    planned = planner()
    assert planned.statistics.seconds == clock.last > 0.0


@pytest.mark.parametrize(
    "planner",
    [
        rho.plan,
        rho.plan_convex,
        rho.plan_rho,
        lambda scenario: rho.scp_step(
            rho.Plan.from_accelerations(scenario, STRAIGHT.accelerations)
        ),
    ],
)
def test_an_error_has_the_seconds_until_it_was_raised_even_in_another_process(
    planner: Callable[[rho.Scenario], object], clock: Clock
) -> None:
    with pytest.raises(rho.InfeasibleError) as caught:
        planner(IMPOSSIBLE)
    seconds = caught.value.statistics.seconds
    assert seconds == clock.last > 0.0
    sent = pickle.loads(pickle.dumps(caught.value))  # noqa: S301  # made here
    assert sent.statistics.seconds == seconds


def test_seconds_of_a_window_include_its_reference_and_those_of_a_flight_are_the_sum(
    clock: Clock,
) -> None:
    def planned(scenario: rho.Scenario, tail: object, solver: object) -> rho.Plan:
        return rho.plan_convex(scenario)

    horizon = rho.RecedingHorizon(ASKED, replan_every=8, reference=planned)
    began, took = -1.0, 0.0
    for knot in horizon.knots:
        window = horizon.step(horizon.planned(knot), ASKED.grid.times[knot])
        ended = clock.last
        assert window.statistics.seconds == ended - began - 1.0
        assert window.statistics.linearisations == 2  # including that of the reference
        took, began = took + window.statistics.seconds, ended + 1.0
    assert len(horizon.windows) > 1
    assert horizon.flight.statistics.seconds == took


def test_the_seconds_of_a_window_without_a_plan_count_once() -> None:
    flight = rho.plan_rho(single(), planner=_failing, fallback=rho.plan_convex, replan_every=8)
    window = flight.windows[-1]
    assert window.lasting(7.0).statistics.seconds == 7.0
    assert window.lasting(7.0).reference.statistics.seconds == window.reference.statistics.seconds
    alone = rho.Window(0, flight.plan, flight.plan, infeasible="for a test").lasting(7.0)
    assert alone.reference is alone.plan
    assert alone.statistics.seconds == 7.0


def _failing(scenario: rho.Scenario, **options: object) -> rho.Plan:
    raise rho.SolverError("for a test")


def test_campaigns_record_the_seconds_of_planners(tmp_path: Path) -> None:
    methods = [{"name": each, "planner": each} for each in ("plan", "plan_convex", "plan_rho")]
    source = {"name": "asked", "scenario": ASKED}
    path = tmp_path / "runs.sqlite"
    results = rho.campaign(small(1, scenarios=[source], methods=methods, plans=True), path)
    found = table(path, ("key", "plan_seconds"))
    assert len(found) == 3
    for key, seconds in found:
        planned = results.plan(key)
        assert isinstance(planned, rho.Plan | rho.Flight)
        assert seconds == planned.statistics.seconds > 0.0
