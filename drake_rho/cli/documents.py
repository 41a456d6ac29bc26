"""Documents of `assign`, `campaign`, `results`, `reproduce`, `show`, `map` and `export`."""

from __future__ import annotations

from typing import Any

from drake_rho.cli.document import Document, record


@record
class AssignedRow:
    """Goal assigned to a vehicle."""

    vehicle: str
    """name of the vehicle"""
    goal_of: str
    """name of the vehicle that had this goal before"""
    goal_m: list[float]
    """position of the goal: x, y and z"""


@record
class Assigned(Document):
    """Document of assign."""

    scenario: str
    """name of the scenario"""
    effort: float
    """least cost with the goals exchanged, without other constraints"""
    effort_before: float
    """least cost with the original goals, without other constraints"""
    vehicles: list[AssignedRow]
    """goal of each vehicle"""
    file: str | None
    """path of the saved scenario; null if it was not saved"""


@record
class Ran(Document):
    """Document of campaign."""

    store: str
    """path of the store"""
    runs: int
    """number of runs in the store"""
    failed: int
    """number of runs without a plan that holds"""
    seconds: float
    """wall time of this call"""


@record
class Summary(Document):
    """Document of results; docs/campaigns.md describes its lists, from `rho.Results.to_json`."""

    study: str
    """name of the study"""
    runs: int
    """number of runs in the store"""
    groups: list[dict[str, Any]]
    """success, costs and times of each method on each source of scenarios"""
    failures: list[dict[str, Any]]
    """runs without a plan that holds, by method and status"""
    comparisons: list[dict[str, Any]]
    """pairs of methods, compared on the runs that both have done"""
    export: str | None
    """path of the file with all rows; null if none was written"""
    figures: list[str]
    """paths of the figures"""


@record
class ExampleRow:
    """One of the paper's four examples."""

    number: int
    """number of the example, 1 to 4"""
    method: str
    """method: convex or RHO"""
    obstacle: str
    """treatment of the obstacle: ignored or avoided"""
    ok: bool
    """true if all required constraints hold"""
    cost: float
    """performance index f"""
    lower_bound: float
    """lower bound of the cost of every plan of the example"""
    seconds: float
    """median wall time of planning"""
    programs: int
    """number of quadratic programs solved"""
    clearance_m: float
    """least distance from the obstacle's surface at any instant; negative inside"""


@record
class ClaimRow:
    """Claim of the paper, checked against the reproduced examples."""

    number: int
    """number of the claim in docs/paper.md"""
    claim: str
    """text of the claim"""
    evidence: str
    """numbers that decide whether the claim is found"""
    found: bool
    """true if the reproduced examples confirm the claim"""


@record
class Reproduced(Document):
    """Document of reproduce."""

    examples: list[ExampleRow]
    """Examples 1 to 4"""
    claims: list[ClaimRow]
    """the six claims of the paper"""
    figures: list[str]
    """paths of the figures"""


@record
class Shown(Document):
    """Document of show."""

    page: str | None = None
    """path of the page; null if none was written"""
    film: str | None = None
    """path of the film; null if none was written"""
    url: str | None = None
    """address at which the page is served until the command is interrupted"""


@record
class Mapped(Document):
    """Document of map."""

    file: str
    """path of the file"""
    kind: str
    """kind of the map: octomap, points, mesh or world"""
    lower_m: list[float]
    """least coordinates of the obstacle, x, y and z"""
    upper_m: list[float]
    """greatest coordinates of the obstacle, x, y and z"""
    resolution_m: float | None
    """side of the cells; null for a mesh or a world"""
    cells: int | None
    """number of cells of the obstacle; null for a mesh or a world"""
    occupied_cells: int | None
    """number of cells that an OctoMap has as occupied; null for other maps"""
    free_cells: int | None
    """number of cells that an OctoMap has as free; null for other maps"""
    unknown_cells: int | None
    """number of cells in the bounding box of an OctoMap that were never seen; null for others"""
    triangles: int | None
    """number of triangles; null unless it is a mesh"""
    vertices: int | None
    """number of vertices; null unless it is a mesh"""
    watertight: bool | None
    """true if a mesh has an inside, false if it is a surface; null unless it is a mesh"""
    obstacles: list[str] | None
    """names and shapes of the obstacles of a world; null for other maps"""
    parts: int
    """number of convex parts that planners keep clear of"""
    beyond_m: float
    """largest distance of these parts from the map; 0 if their union is the map"""
    figure: str | None
    """path of the figure; null if none was drawn"""


@record
class Content(Document):
    """Document of campaign --example."""

    content: str
    """text of an example study"""


@record
class Exported(Document):
    """Document of export."""

    path: str
    """requested file or folder"""
    files: list[str]
    """paths of all files that were written"""
    content: str
    """description of the content of the files"""
    deviations_m: dict[str, float]
    """for each vehicle, bound of the distance between the exported and the planned motion"""
    keeps_clear: bool | None
    """true if vehicles keep clear within these deviations; null if the export is exact"""


@record
class Listed(Document):
    """Document of drake-rho without a command, and of --version."""

    version: str
    """version of drake_rho"""
    commands: dict[str, str]
    """names of the commands, with a description of each"""
