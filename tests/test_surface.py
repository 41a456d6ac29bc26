"""Tests come at the public surface, except those that prove an internal identity."""

from __future__ import annotations

import ast
from pathlib import Path

INTERNAL = {
    "programs, their duals and proofs that none is feasible, beside symbolic twins": """
        test_best test_blocks test_cones test_daqp test_farkas test_fleets test_forms
        test_half_spaces test_in_groups test_minimum_effort test_optimality test_related test_scp
        test_solve test_sparse test_subproblem test_weight_forms test_working_set
    """,
    "least violations and the search for what makes a scenario feasible": """
        test_feasibility test_feasibility_disturbed test_max_speed test_norms test_progress
        test_requirements_flown test_time_bounds test_waypoint_times test_waypoints
    """,
    "margins of tubes, and bounds on what windows cost": """
        test_cost_bounds test_free_final_time test_hold_at_goal test_margins test_plan_in_force
        test_seen_again
        test_tube_verified
    """,
    "worst instants and extremes of motions, beside samples": """
        motions test_between_knots test_clearance test_closest_over_time test_continuous_time
        test_dynamics test_obstacles_avoided test_pairs test_smoothing
    """,
    "the search for paths": """
        test_active_search test_along_paths test_lattice test_path_search test_search_memory
    """,
    "the quick verifier beside `verify`, and records that validation would refuse": """
        test_completeness test_first_violation test_obstacles_verified test_scenario
    """,
    "the loop without Drake beside `simulate`, and the controller of a quadrotor": """
        test_quadrotors test_simulate
    """,
    "solvers, searches and files that fail when told to": """
        conftest test_errors test_files test_infeasible test_minimum_time test_rho test_threads
        test_time_limit
    """,
    "the geometry of pictures, which have no public form but the picture": """
        browser screenshot test_active_display test_airframes test_animation test_animation_flight
        test_animation_obstacles test_display test_display_clock test_display_flight
        test_display_maps test_display_obstacles test_display_requirements test_figures_published
        test_film test_names test_posed test_previews test_surfaces test_uncertain_display
        test_viewer
    """,
    "stores of campaigns, whose damage is by hand": "test_campaign test_results test_study",
    "the geometry of maps, and files of maps that are wrong": """
        test_map_files test_maps test_maps_planned
    """,
    "rules of arguments, help, missions, exports and reports": """
        test_arguments test_damaged_files test_export_files test_export_pieces test_help
        test_missions test_reports
    """,
}
"""Files that import from inside the package, by the reason. The list gets shorter, not longer."""


def _imports_internals(path: Path) -> bool:
    """Return whether a file imports a module inside the package; `drake_rho.cli` has its entry."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("drake_rho."):
            return True
        if isinstance(node, ast.Import) and any(
            each.name.startswith("drake_rho.") for each in node.names
        ):
            return True
    return False


def test_no_other_test_imports_what_users_do_not() -> None:
    found = {path.stem for path in Path(__file__).parent.rglob("*.py") if _imports_internals(path)}
    allowed = {name for names in INTERNAL.values() for name in names.split()}
    assert found - allowed == set(), "import from `drake_rho`, as users do"
    assert allowed - found == set(), "no longer needed: delete the names from the list"
