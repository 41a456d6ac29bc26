"""Drake's log: solvers and scenes add no lines to what a program or a notebook shows."""

from __future__ import annotations

import logging

import pytest
from pydrake.solvers import ScsSolver

import drake_rho as rho
from tests.scenarios import box, single

IMPOSSIBLE = single(limits=rho.Limits(acceleration=box(0.1)))


@pytest.mark.parametrize("solver", ["clarabel", "osqp", ScsSolver()])
def test_solvers_and_scenes_are_silent(
    solver: str | ScsSolver, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.INFO):
        with pytest.raises(rho.InfeasibleError):
            rho.plan(IMPOSSIBLE, solver=solver)
        rho.viewer_page(IMPOSSIBLE)
    assert not caplog.records


def test_other_lines_of_the_log_are_kept(caplog: pytest.LogCaptureFixture) -> None:
    rho.plan(single())
    with caplog.at_level(logging.INFO, logger="drake"):
        logging.getLogger("drake").info("Meshcat says something else")
    assert len(caplog.records) == 1
