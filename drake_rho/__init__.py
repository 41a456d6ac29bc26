"""Cooperative trajectories for several UAVs by convex optimisation with a receding horizon.

The method of Zhou et al., ASCC 2017, on Drake's `MathematicalProgram`. SI units throughout.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    __version__: str
    from drake_rho.analysis.certificate import Certificate, VehicleCertificate
    from drake_rho.analysis.certify import certify
    from drake_rho.analysis.certify_time import certify_time
    from drake_rho.analysis.diagnose import diagnose
    from drake_rho.analysis.diagnosis import Diagnosis
    from drake_rho.analysis.infeasible_subset import infeasible_subset
    from drake_rho.analysis.minimum_time import plan_minimum_time, shortest_plan
    from drake_rho.analysis.sensitivity import LimitEffect, TimeSensitivity
    from drake_rho.analysis.time_certificate import TimeCertificate, VehicleTimeBound
    from drake_rho.campaigns.campaign import campaign
    from drake_rho.campaigns.results import Results
    from drake_rho.campaigns.study import Study, load_study
    from drake_rho.display.meshcat.animation import animate
    from drake_rho.display.plots.figures import (
        accelerations_figure,
        distances_figure,
        errors_figure,
        separation_figure,
        velocities_figure,
    )
    from drake_rho.display.plots.path_figure import paths_figure
    from drake_rho.display.plots.publish import save_figure
    from drake_rho.display.viewer.page import viewer_page
    from drake_rho.exports.export import export
    from drake_rho.exports.record import Exported
    from drake_rho.motion.files import PlanFileError, load, save
    from drake_rho.motion.flight import Flight, Window
    from drake_rho.motion.plan import Plan
    from drake_rho.motion.samples import Samples
    from drake_rho.motion.scenario_tube import error_tube, largest_disturbance
    from drake_rho.motion.simulation import Simulation
    from drake_rho.motion.statistics import Statistics
    from drake_rho.motion.tube import ErrorTube
    from drake_rho.planning.call.options import Options
    from drake_rho.planning.constraints.coupling import coupled, decoupled, grouped
    from drake_rho.planning.errors import InfeasibleError, OutOfTimeError, SolverError
    from drake_rho.planning.horizon.interfaces import free_reference, tail_reference
    from drake_rho.planning.horizon.plan_rho import plan_rho
    from drake_rho.planning.horizon.receding_horizon import RecedingHorizon
    from drake_rho.planning.planners.assignment import assign_goals
    from drake_rho.planning.planners.convex import plan_convex
    from drake_rho.planning.planners.plan import plan, plan_scp
    from drake_rho.planning.programs.daqp import Daqp
    from drake_rho.planning.scp.sequential_convex import scp_step
    from drake_rho.scenario.errors import (
        DrakeRhoError,
        DrakeRhoWarning,
        MapChangedWarning,
        MapScaleWarning,
        ScenarioError,
    )
    from drake_rho.scenario.files import library, load_scenario, save_scenario, scenario_schema
    from drake_rho.scenario.problems.generators import circle_swap, flight_cube, random_transitions
    from drake_rho.scenario.problems.missions import load_lsc_mission
    from drake_rho.scenario.problems.worlds import random_field, trefoil_swap
    from drake_rho.scenario.records import (
        Ball,
        Box,
        Capsule,
        Cone,
        Cylinder,
        Disturbance,
        Ellipsoid,
        Grid,
        HalfSpace,
        KeepIn,
        Limits,
        Mesh,
        Obstacle,
        Polytope,
        Posed,
        Scenario,
        Separation,
        Smoothing,
        Sphere,
        State,
        Track,
        Vehicle,
        Voxels,
        Waypoint,
    )
    from drake_rho.scenario.sets import ConvexSet, check_set
    from drake_rho.scenario.worlds import load_world
    from drake_rho.simulation import winds
    from drake_rho.simulation.attack import Attack, attack
    from drake_rho.simulation.simulate import simulate
    from drake_rho.simulation.systems import RecedingHorizonController, WindyPointMass
    from drake_rho.simulation.worst_case import WorstCase, worst_case
    from drake_rho.verification.verify import Check, Report, Summary, verify

__all__ = [
    "Attack",
    "Ball",
    "Box",
    "Capsule",
    "Certificate",
    "Check",
    "Cone",
    "ConvexSet",
    "Cylinder",
    "Daqp",
    "Diagnosis",
    "Disturbance",
    "DrakeRhoError",
    "DrakeRhoWarning",
    "Ellipsoid",
    "ErrorTube",
    "Exported",
    "Flight",
    "Grid",
    "HalfSpace",
    "InfeasibleError",
    "KeepIn",
    "LimitEffect",
    "Limits",
    "MapChangedWarning",
    "MapScaleWarning",
    "Mesh",
    "Obstacle",
    "Options",
    "OutOfTimeError",
    "Plan",
    "PlanFileError",
    "Polytope",
    "Posed",
    "RecedingHorizon",
    "RecedingHorizonController",
    "Report",
    "Results",
    "Samples",
    "Scenario",
    "ScenarioError",
    "Separation",
    "Simulation",
    "Smoothing",
    "SolverError",
    "Sphere",
    "State",
    "Statistics",
    "Study",
    "Summary",
    "TimeCertificate",
    "TimeSensitivity",
    "Track",
    "Vehicle",
    "VehicleCertificate",
    "VehicleTimeBound",
    "Voxels",
    "Waypoint",
    "Window",
    "WindyPointMass",
    "WorstCase",
    "accelerations_figure",
    "animate",
    "assign_goals",
    "attack",
    "campaign",
    "certify",
    "certify_time",
    "check_set",
    "circle_swap",
    "coupled",
    "decoupled",
    "diagnose",
    "distances_figure",
    "error_tube",
    "errors_figure",
    "export",
    "flight_cube",
    "free_reference",
    "grouped",
    "infeasible_subset",
    "largest_disturbance",
    "library",
    "load",
    "load_lsc_mission",
    "load_scenario",
    "load_study",
    "load_world",
    "paths_figure",
    "plan",
    "plan_convex",
    "plan_minimum_time",
    "plan_rho",
    "plan_scp",
    "random_field",
    "random_transitions",
    "save",
    "save_figure",
    "save_scenario",
    "scenario_schema",
    "scp_step",
    "separation_figure",
    "shortest_plan",
    "simulate",
    "tail_reference",
    "trefoil_swap",
    "velocities_figure",
    "verify",
    "viewer_page",
    "winds",
    "worst_case",
]

# Public names are imported on first access, together with the modules they need. Importing Drake
# and matplotlib takes a second, which loading a scenario or interrupting a command does not need.
_NAMES = {
    "drake_rho.analysis.diagnosis": ("Diagnosis",),
    "drake_rho.analysis.diagnose": ("diagnose",),
    "drake_rho.analysis.sensitivity": ("LimitEffect", "TimeSensitivity"),
    "drake_rho.analysis.minimum_time": ("plan_minimum_time", "shortest_plan"),
    "drake_rho.analysis.infeasible_subset": ("infeasible_subset",),
    "drake_rho.analysis.certificate": ("Certificate", "VehicleCertificate"),
    "drake_rho.analysis.certify": ("certify",),
    "drake_rho.analysis.certify_time": ("certify_time",),
    "drake_rho.analysis.time_certificate": ("TimeCertificate", "VehicleTimeBound"),
    "drake_rho.campaigns.campaign": ("campaign",),
    "drake_rho.campaigns.results": ("Results",),
    "drake_rho.campaigns.study": ("Study", "load_study"),
    "drake_rho.display.meshcat.animation": ("animate",),
    "drake_rho.display.plots.figures": (
        "accelerations_figure",
        "distances_figure",
        "errors_figure",
        "separation_figure",
        "velocities_figure",
    ),
    "drake_rho.display.viewer.page": ("viewer_page",),
    "drake_rho.display.plots.path_figure": ("paths_figure",),
    "drake_rho.display.plots.publish": ("save_figure",),
    "drake_rho.exports.export": ("export",),
    "drake_rho.exports.record": ("Exported",),
    "drake_rho.motion.files": ("PlanFileError", "load", "save"),
    "drake_rho.motion.flight": ("Flight", "Window"),
    "drake_rho.motion.plan": ("Plan",),
    "drake_rho.motion.samples": ("Samples",),
    "drake_rho.motion.scenario_tube": ("error_tube", "largest_disturbance"),
    "drake_rho.motion.simulation": ("Simulation",),
    "drake_rho.motion.statistics": ("Statistics",),
    "drake_rho.motion.tube": ("ErrorTube",),
    "drake_rho.planning.planners.assignment": ("assign_goals",),
    "drake_rho.planning.planners.plan": ("plan", "plan_scp"),
    "drake_rho.planning.planners.convex": ("plan_convex",),
    "drake_rho.planning.programs.daqp": ("Daqp",),
    "drake_rho.planning.errors": ("InfeasibleError", "OutOfTimeError", "SolverError"),
    "drake_rho.planning.constraints.coupling": ("coupled", "decoupled", "grouped"),
    "drake_rho.planning.call.options": ("Options",),
    "drake_rho.planning.horizon.plan_rho": ("plan_rho",),
    "drake_rho.planning.horizon.receding_horizon": ("RecedingHorizon",),
    "drake_rho.planning.scp.sequential_convex": ("scp_step",),
    "drake_rho.planning.horizon.interfaces": ("free_reference", "tail_reference"),
    "drake_rho.scenario.errors": (
        "DrakeRhoError",
        "DrakeRhoWarning",
        "MapChangedWarning",
        "MapScaleWarning",
        "ScenarioError",
    ),
    "drake_rho.scenario.files": ("library", "load_scenario", "save_scenario", "scenario_schema"),
    "drake_rho.scenario.problems.generators": ("circle_swap", "flight_cube", "random_transitions"),
    "drake_rho.scenario.problems.missions": ("load_lsc_mission",),
    "drake_rho.scenario.records": (
        "Ball",
        "Box",
        "Capsule",
        "Cone",
        "Cylinder",
        "Disturbance",
        "Ellipsoid",
        "Grid",
        "HalfSpace",
        "KeepIn",
        "Limits",
        "Mesh",
        "Obstacle",
        "Polytope",
        "Posed",
        "Scenario",
        "Separation",
        "Smoothing",
        "Sphere",
        "State",
        "Track",
        "Vehicle",
        "Voxels",
        "Waypoint",
    ),
    "drake_rho.scenario.sets": ("ConvexSet", "check_set"),
    "drake_rho.scenario.worlds": ("load_world",),
    "drake_rho.scenario.problems.worlds": ("random_field", "trefoil_swap"),
    "drake_rho.simulation.attack": ("Attack", "attack"),
    "drake_rho.simulation.simulate": ("simulate",),
    "drake_rho.simulation.systems": ("RecedingHorizonController", "WindyPointMass"),
    "drake_rho.simulation.worst_case": ("WorstCase", "worst_case"),
    "drake_rho.verification.verify": ("Check", "Report", "Summary", "verify"),
}
_MODULE_OF = {name: module for module, names in _NAMES.items() for name in names}


def __getattr__(name: str) -> object:
    found: object
    if name == "__version__":
        found = import_module("importlib.metadata").version("drake-rho")
    elif name == "winds":
        found = import_module("drake_rho.simulation.winds")
    elif name in _MODULE_OF:
        found = getattr(import_module(_MODULE_OF[name]), name)
        records = import_module("drake_rho.scenario.described").ShownInNotebooks
        records.html_of = staticmethod(_html_of)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = found
    return found


def _html_of(record: object) -> str:
    """Return the HTML by which a notebook shows a record."""
    found: str = import_module("drake_rho.display.notebook").html_of(record)
    return found


def __dir__() -> list[str]:
    special = (name for name in globals() if name.startswith("__"))
    return sorted({*__all__, "__version__", *special})
