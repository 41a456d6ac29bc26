"""Cooperative trajectories for several UAVs by convex optimisation with a receding horizon.

The method of Zhou et al., ASCC 2017, on Drake's `MathematicalProgram`. SI units throughout.
"""

from drake_rho.assurance.verification import Check, Report, verify
from drake_rho.motion.files import PlanFileError, load, save
from drake_rho.motion.plan import Flight, Plan, Statistics, Window
from drake_rho.planning.convex import plan_convex
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.rho import plan_rho, previous_tail, without_obstacles
from drake_rho.planning.scp import plan_scp, scp_step
from drake_rho.scenario.errors import DrakeRhoError, ScenarioError
from drake_rho.scenario.files import library, load_scenario, save_scenario, scenario_schema
from drake_rho.scenario.records import (
    Box,
    Grid,
    Limits,
    Scenario,
    Sphere,
    State,
    Vehicle,
)

__all__ = [
    "Box",
    "Check",
    "DrakeRhoError",
    "Flight",
    "Grid",
    "InfeasibleError",
    "Limits",
    "Plan",
    "PlanFileError",
    "Report",
    "Scenario",
    "ScenarioError",
    "SolverError",
    "Sphere",
    "State",
    "Statistics",
    "Vehicle",
    "Window",
    "library",
    "load",
    "load_scenario",
    "plan_convex",
    "plan_rho",
    "plan_scp",
    "previous_tail",
    "save",
    "save_scenario",
    "scenario_schema",
    "scp_step",
    "verify",
    "without_obstacles",
]
