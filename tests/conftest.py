"""What several test modules share."""

import pytest
from hypothesis import HealthCheck, settings
from pydrake.solvers import ClarabelSolver, OsqpSolver, SolverInterface

import drake_rho as rho
from drake_rho.paper.study import Study, run_study

# No deadline: how long a program takes is no property to test. Fixtures that hypothesis reuses
# are frozen records.
settings.register_profile(
    "drake_rho",
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
settings.load_profile("drake_rho")


@pytest.fixture(scope="session")
def paper() -> rho.Scenario:
    """The paper's scenario."""
    return rho.load_scenario("paper")


@pytest.fixture(scope="session")
def study() -> Study:
    """The paper's four examples."""
    return run_study()


@pytest.fixture(params=[ClarabelSolver, OsqpSolver], ids=["Clarabel", "OSQP"])
def solver(request: pytest.FixtureRequest) -> SolverInterface:
    """Each of the two free solvers."""
    made: SolverInterface = request.param()
    return made
