"""Row generation: the loop that adds violated rows and solves again."""

from __future__ import annotations

from collections.abc import Callable

from drake_rho.planning.call.time_limit import check_time
from drake_rho.planning.call.work_limit import count_work


def generate_rows(search: Callable[[], bool], solve: Callable[[], None], most: int) -> bool:
    """Alternate between adding violated rows and solving until no row is violated.

    `search` and `solve` determine whether rows are hard or soft, and whether vehicles are
    independent, coupled or in groups.

    Args:
        search: adds the rows that the motions violate; returns whether there were any.
        solve: finds motions that satisfy the rows in the working set.
        most: the largest number of rounds.

    Returns:
        Whether nothing is violated; False if the last round still added rows.
    """
    for _ in range(most):
        check_time()
        if not search():
            return True
        solve()
        count_work(1.0)
    return False
