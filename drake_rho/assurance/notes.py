"""What a report says below its table of a disturbance, in words."""

from __future__ import annotations

from drake_rho.assurance.course import Course
from drake_rho.scenario.disturbance import Disturbance
from drake_rho.scenario.parts import Grid


def notes_on(course: Course) -> tuple[str, ...]:
    """What disturbance plans are judged with, and where vehicles end that reach their goals."""
    around, tubes = course.scenario.disturbance, course.tubes
    if around is None or tubes is None:
        return ()
    tube, end = tubes.last, course.scenario.grid.end
    position, velocity = float(tube.position(end)), float(tube.velocity(end))
    return (
        f"judged {disturbance_in_words(around, course.scenario.grid)}",
        f"vehicles end within {position:.4g} m and {velocity:.4g} m/s of their goals",
    )


def disturbance_in_words(around: Disturbance, grid: Grid) -> str:
    """What a scenario says of a disturbance, as in 'for every wind up to 0.3 m/s²'."""
    words = [f"for every wind up to {around.acceleration:g} m/s²"]
    if around.position_error > 0.0 or around.velocity_error > 0.0:
        errors = f"{around.position_error:g} m and {around.velocity_error:g} m/s"
        words.append(f"estimates up to {errors} off")
    late = f", {around.delay} late" if around.delay > 0 else ""
    words.append(f"feedback every {around.sample(grid):g} s{late}")
    return ", ".join(words)
