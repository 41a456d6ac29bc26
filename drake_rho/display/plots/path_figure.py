"""Three-dimensional figure of the paths of a plan, a flight, a simulation or a scenario."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from math import ceil
from typing import Self

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from mpl_toolkits.mplot3d.axes3d import Axes3D

from drake_rho.display.common.drawable import Drawn, drawn
from drake_rho.display.common.hidden import best_from_above
from drake_rho.display.common.names import as_text
from drake_rho.display.common.obstacle_snapshots import (
    Snapshot,
    approaches,
    as_obstacles,
    obstacle_notes,
    obstacle_paths,
    snapshots,
)
from drake_rho.display.common.requirements import required_positions
from drake_rho.display.common.set_surfaces import requirements_near
from drake_rho.display.common.style import MAX_NAMED, dense_times, window_colours
from drake_rho.display.plots.axes3d import Area, SceneAxes, fit_scene, frame_scene
from drake_rho.display.plots.formats import DOUBLE_COLUMN, check_width
from drake_rho.display.plots.given_axes import given_axes_in_space
from drake_rho.display.plots.layout import EDGE, grow
from drake_rho.display.plots.legends import (
    add_below,
    add_beside,
    figure_of,
    in_width,
    start_handles,
    vehicle_handles,
    width_beside,
)
from drake_rho.display.plots.maps import map_notes
from drake_rho.display.plots.overlapping_curves import marks_every
from drake_rho.display.plots.publish import styled
from drake_rho.display.plots.requirements import draw_links, draw_sets
from drake_rho.display.plots.space import (
    MAX_LABELLED,
    draw_approaches,
    draw_conflicts,
    draw_measured_paths,
    draw_obstacle_labels,
    draw_obstacle_paths,
    draw_obstacles,
    draw_paths,
    draw_planned_paths,
    draw_windows,
    within,
)
from drake_rho.motion.flown import Flown
from drake_rho.planning.errors import InfeasibleError
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.shapes.base import Solid

_LINE = 0.135
"""Height of a line of notes [in]."""
_BAR = 0.7
"""Width of the colour bar of windows with its labels [in]."""
_BAR_WIDTH = 0.12
"""Width of the colour bar without its labels [in]."""
_MAX_TICKS = 12
"""Largest number of numbered windows."""
_MIN_BESIDE = 5.0
"""Least width of a figure with a legend beside its scene [in]."""
_HIGHEST = (1.1, 0.45)
"""Largest height of a scene: a constant [in] plus a fraction of the figure's width."""


@checked
@styled
def paths_figure(
    flown: Flown | Scenario,
    *,
    conflicts: InfeasibleError | None = None,
    obstacles: Sequence[Solid | Obstacle] | None = None,
    ax: Axes | None = None,
    width: float = DOUBLE_COLUMN,
) -> Figure:
    """Plot the vehicles' paths and the obstacles in space, with a colour for each window.

    Plans have no windows; each vehicle has its own colour instead. A scenario is drawn before
    planning, with straight lines from starts through waypoints to goals.

    Paths behind obstacles are faint. Maps are coloured by height. If maps, such as a building,
    would hide too much of the paths, the figure shows x and y from above, and the maps only at the
    heights of the flights.

    Args:
        flown: plan, flight, simulation or scenario to draw.
        conflicts: error of an infeasible scenario, whose vehicles and obstacles in conflict are
            marked in red.
        obstacles: obstacles to draw; the scenario's if not given.
        ax: three-dimensional axes to draw in, without a legend and notes; a new figure if not
            given.
        width: width of a new figure [in]; in IEEE journals 3.5 for one column, 7.16 for two.

    Raises:
        ValueError: the axes are not three-dimensional, or the text would be illegible at the width.

    Examples:
        >>> scenario = rho.load_scenario("paper")
        >>> before = rho.paths_figure(scenario)
        >>> figure = rho.paths_figure(rho.plan(scenario))
        >>> path = rho.save_figure(figure, folder / "paths.png")
    """
    content = _Content.of(flown, obstacles, conflicts)
    if ax is not None:
        given = given_axes_in_space(ax)
        content.frame(given)
        content.draw(given)
        return figure_of(ax)
    figure = Figure(figsize=(check_width(width), width))
    scene = figure.add_subplot(axes_class=SceneAxes)
    content.frame(scene)
    handles, notes = content.handles, content.notes(figure)
    below = 2 * EDGE + _LINE * len(notes)
    beside = _BAR if content.in_windows else width_beside(figure, handles)
    if beside is None or not (content.in_windows or width >= _MIN_BESIDE):
        beside = 0.0
    max_height = _HIGHEST[0] + _HIGHEST[1] * width
    area = Area(EDGE, below, width - 2 * EDGE - beside, max_height)
    box = fit_scene(figure, scene, area)
    beside_at = box.x1 + (area.left + area.width - box.x1) / 2  # middle of the unused width
    grow(figure, above=EDGE)
    content.draw(scene)
    if content.in_windows:
        place = (beside_at + EDGE, box.y0 + 0.2 * box.height, _BAR_WIDTH, 0.6 * box.height)
        _add_window_bar(figure, len(content.plan.windows), place)
    for line, words in enumerate(notes):
        at = (EDGE + _LINE * line) / figure.get_figheight()
        figure.text(EDGE / width, at, words, fontsize=7, va="bottom")
    if beside > 0.0 and not content.in_windows:
        add_beside(figure, handles, beside_at)
    else:
        grow(figure, below=add_below(figure, handles))
    return figure


@dataclasses.dataclass(frozen=True, eq=False)
class _Content:
    """Content of a figure of paths."""

    plan: Drawn
    bodies: tuple[Obstacle, ...]
    shown: list[Snapshot]
    conflicts: InfeasibleError | None
    heights: tuple[float, float] | None
    """lower and upper height of the map slice shown from above [m]; None from the side"""

    @classmethod
    def of(
        cls,
        flown: Flown | Scenario,
        obstacles: Sequence[Solid | Obstacle] | None,
        conflicts: InfeasibleError | None,
    ) -> Self:
        """Return the content of a figure, with the scenario's obstacles if none are given."""
        plan = drawn(flown)
        bodies = as_obstacles(plan.scenario.obstacles if obstacles is None else obstacles)
        shown, heights = snapshots(plan, bodies), None
        paths = plan.motion().at("position", dense_times(plan)).reshape(-1, 3)
        if best_from_above(paths, shown):
            beside = float(plan.scenario.fleet.radii.max())
            heights = (float(paths[:, 2].min()) - beside, float(paths[:, 2].max()) + beside)
            shown = [dataclasses.replace(each, between=heights) for each in shown]
        return cls(plan, bodies, shown, conflicts, heights)

    @property
    def in_windows(self) -> bool:
        """Whether windows are drawn, each in its colour."""
        return len(self.plan.windows) > 1 or self.plan.kind == "flight"

    @property
    def handles(self) -> list[Line2D]:
        """Entries of the legend: vehicles without names beside their starts."""
        scenario = self.plan.scenario
        if self.in_windows:
            return start_handles(scenario) if len(scenario.vehicles) > MAX_LABELLED else []
        handles = vehicle_handles(scenario)
        for handle in handles if self.plan.kind == "scenario" else []:
            handle.set(marker="none", linestyle="--")
        return handles

    def frame(self, ax: Axes3D) -> None:
        """Set the limits of the axes around everything shown."""
        plan = self.plan
        passed = [each.position for one in plan.scenario.vehicles for each in one.waypoints]
        flights = [plan, *(window.shown for window in plan.windows)]
        flights += [each.braking for each in plan.windows if each.braking is not None]
        places = [each.positions.reshape(-1, 3) for each in flights]
        places.append(np.reshape(passed, (-1, 3)))
        if plan.measured is not None:
            places.append(plan.measured.positions[plan.measured.seen])
        drawn_here = np.concatenate(places)
        bounds = [(drawn_here.min(axis=0), drawn_here.max(axis=0))]
        bounds += [each.bounds for each in self.shown]
        near = np.reshape(requirements_near(plan, bounds), (-1, 3))
        from_above = self.heights is not None
        frame_scene(ax, np.concatenate([drawn_here, near]), self.shown, from_above=from_above)

    def draw(self, ax: Axes3D) -> None:
        """Draw obstacles, paths, starts and goals, and mark conflicts."""
        plan, shown = self.plan, within(ax, self.shown)
        draw_sets(ax, plan)
        draw_obstacles(ax, shown)
        draw_obstacle_paths(ax, obstacle_paths(plan, self.bodies), shown)
        draw_approaches(ax, approaches(plan, self.bodies))
        draw_obstacle_labels(ax, shown)
        draw_links(ax, plan, shown)
        if self.in_windows:
            draw_windows(ax, plan, shown)
        else:
            draw_paths(ax, plan, shown)
            draw_planned_paths(ax, plan, shown)
        draw_measured_paths(ax, plan, shown)
        if self.conflicts is not None:
            draw_conflicts(ax, plan.scenario, self.conflicts, shown)

    def notes(self, figure: Figure) -> list[str]:
        """Return notes on marks and lines, in texts as wide as the figure, the lowest first."""
        plan, words = self.plan, ["ring: start", "star: goal"]
        if plan.kind == "scenario":
            words.append("dashed: straight lines, not planned")
        elif self.in_windows:
            thick = "flown" if plan.measured is None else "planned"
            words = [f"thick: {thick}", "thin: the rest of each window's prediction", *words]
            if any(window.braking is not None for window in plan.windows):
                words.insert(2, "dotted, to a cross: contingencies, which brake to rest")
        else:
            if len(plan.positions) <= MAX_NAMED:
                every = marks_every(len(plan.times), figure.get_figwidth())
                words.append(
                    "a mark at every knot" if every == 1 else f"a mark every {every} knots"
                )
            words += ["dotted: planned"] if plan.planned else []
        words += ["black: measured"] if plan.measured is not None else []
        if any(vehicle.waypoints for vehicle in plan.scenario.vehicles):
            words.append("diamond: waypoint")
        words += ["red: in conflict"] if self.conflicts is not None else []
        width = figure.get_figwidth() - 2 * EDGE
        notes = ["; ".join(words), *obstacle_notes(plan, self.bodies)]
        notes += map_notes(self.shown)
        required = list(required_positions(plan.scenario))
        if not all(each.is_link for each in required):
            notes.append("green: sets in which vehicles stay")
        if any(each.is_link for each in required):
            notes.append(
                "dashed, grey to red: links when least is left of them; red: nothing is left"
            )
        if self.conflicts is not None:
            notes.append(as_text(str(self.conflicts)))
        return [line for note in notes for line in in_width(figure, note, width).split("\n")][::-1]


def _add_window_bar(figure: Figure, count: int, place: tuple[float, ...]) -> None:
    """Add the colour bar of the windows at a place: left, bottom, width and height [in]."""
    colours = ListedColormap(window_colours(count))
    edges = [number + 0.5 for number in range(count + 1)]
    mappable = ScalarMappable(BoundaryNorm(edges, count), colours)
    x, y, wide, high = np.array(place) / np.tile(figure.get_size_inches(), 2)
    bar = figure.colorbar(mappable, cax=figure.add_axes((x, y, wide, high)))
    numbers = range(1, count + 1, ceil(count / _MAX_TICKS))
    bar.set_ticks(numbers, labels=[str(number) for number in numbers])
    bar.minorticks_off()
    bar.set_label("window")
