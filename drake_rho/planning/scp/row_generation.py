"""The one loop that adds rows."""

from __future__ import annotations

from collections.abc import Callable

from drake_rho.planning.call.time_limit import check_time


def generate_rows(look: Callable[[], bool], solve: Callable[[], None], most: int) -> bool:
    """Add violated rows and solve with them, in turn, until none is violated.

    The rows may be hard or soft, about vehicles by themselves, coupled or in groups: that is for
    `look` and `solve` to know.

    Args:
        look: adds rows that the motions violate, and returns whether there were any.
        solve: finds motions that keep the rows that are in.
        most: bound on the rounds.

    Returns:
        Whether nothing is violated; False where rows were still added in the last round.
    """
    for _ in range(most):
        check_time()
        if not look():
            return True
        solve()
    return False
