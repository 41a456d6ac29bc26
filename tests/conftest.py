"""Settings and fixtures shared by several test modules."""

import signal
from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, settings
from pydrake.solvers import ClarabelSolver, OsqpSolver, SolverInterface

import drake_rho as rho
from drake_rho.paper.study import Study as Study  # for tests that take the fixture
from drake_rho.paper.study import run_study
from drake_rho.planning.programs import backend

# No deadline: how long a program takes is not what is tested. Fixtures that hypothesis reuses are
# frozen records. Failures are reproduced from their seed and need no database.
settings.register_profile(
    "random",
    deadline=None,
    database=None,
    max_examples=30,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
settings.register_profile("same", settings.get_profile("random"), derandomize=True)
settings.load_profile("same")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add `--solver daqp`: run the whole suite with another solver where a test names none."""
    parser.addoption("--solver", choices=["clarabel", "daqp"], default="clarabel")


def pytest_configure() -> None:
    """Handle Ctrl-C, which processes that a shell starts in the background ignore by default."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Leave notebooks to `make test-all`."""
    for item in items:
        if item.path.suffix == ".ipynb":
            item.add_marker(pytest.mark.slow)


@pytest.fixture(autouse=True, scope="session")
def _default_solver(request: pytest.FixtureRequest) -> Iterator[None]:
    """Set the solver that is used where none is given."""
    with pytest.MonkeyPatch.context() as patched:
        if request.config.getoption("--solver") == "daqp":
            patched.setattr(backend, "DEFAULT", rho.Daqp)
        yield


@pytest.fixture(scope="session")
def paper() -> rho.Scenario:
    """Return the paper's scenario."""
    return rho.load_scenario("paper")


@pytest.fixture(scope="session")
def study() -> Study:
    """Return the study of the paper's four examples."""
    return run_study()


@pytest.fixture(params=[ClarabelSolver, OsqpSolver, rho.Daqp], ids=["Clarabel", "OSQP", "DAQP"])
def solver(request: pytest.FixtureRequest) -> SolverInterface:
    """Return each of the free solvers in turn."""
    made: SolverInterface = request.param()
    return made
