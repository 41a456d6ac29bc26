"""Table of the display of every kind of requirement."""

from __future__ import annotations

TREATMENT = {
    "dynamics": "the motion, exact between the knots",
    "goals": "marks at the ends",
    "position": "not drawn: boxes may be far larger than what is flown",
    "velocity": "bounds in `velocities_figure`",
    "acceleration": "bounds in `accelerations_figure`",
    "jerk": "not drawn; `verify` tells it",
    "max_speed": "a panel of `velocities_figure`",
    "max_acceleration": "a panel of `accelerations_figure`",
    "max_thrust": "a panel of `accelerations_figure`",
    "max_tilt": "a panel of `accelerations_figure`",
    "max_jerk": "a panel of `accelerations_figure`",
    "waypoints": "marks in `paths_figure` and in the scene",
    "requirements": "of positions: sets, and lines that redden, in `paths_figure` and the scene, "
    "and curves in `distances_figure`; of other quantities: not drawn, `verify` tells them",
    "obstacles": "their shapes, of maps the surfaces by height, and distances from them",
    "moving obstacles": "shapes at the closest approach, and moving in the scene",
    "late obstacles": "a line where they become known, and faint in the scene before",
    "active obstacles": "shaded times, and in the scene while they are active",
    "uncertain obstacles": "a halo, the space where they may be, and distances from it",
    "separation": "`separation_figure`, and shells in the scene",
    "disturbance": "`errors_figure`, and the tube's radius in the scene",
    "holding": "not drawn; `verify` tells it",
    "smoothing": "the averages are drawn, from the first knot to the last",
}
"""Display of every kind of requirement."""
