"""The separation of every two vehicles, judged at the knots and at every instant."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from drake_rho.verification.closest_pairs import FAR, closest_at_all_times, closest_at_knots
from drake_rho.verification.course import Course
from drake_rho.verification.report import AT_ALL_TIMES, AT_KNOTS, PRECISION, Column


def check_separation(course: Course, far: float = FAR) -> Iterator[Column]:
    """Judge every vehicle's distance from the one that comes closest, at knots and every instant.

    The distance is that of the separation, with z divided by its downwash. Where errors are around
    positions it is the separation and how far beyond its ellipsoid the other one is: what errors
    take are metres in every direction.

    Args:
        course: what is judged.
        far: in separations, as in `closest_at_all_times`.
    """
    scenario = course.scenario
    separation = scenario.separation
    if separation is None or len(scenario.vehicles) < 2:
        return
    knots = closest_at_knots(course, separation)
    precision = PRECISION * separation.tolerance
    always = closest_at_all_times(course, separation, knots, precision, far)
    for part, found in ((AT_KNOTS, knots), (AT_ALL_TIMES, always)):
        names = [scenario.vehicles[partner].name for partner in found.partners]
        limits = separation.distance + found.errors
        yield Column(
            kind="separation",
            constraint="separation",
            parts=[f"from {name} {part}" for name in names],
            times=scenario.grid.start + found.times,
            values=found.distances,
            limits=limits,
            excess=limits - found.distances,
            tolerances=np.full(len(names), separation.tolerance),
            errors=found.errors,
            unit="m",
            asked=part == AT_KNOTS or scenario.between_knots,
            always=part == AT_ALL_TIMES,
            partners=found.partners,
        )
