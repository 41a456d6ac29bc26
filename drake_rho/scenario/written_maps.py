"""Maps of scenarios in files: as references, by numbers, or as JSON text."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, TypeAdapter, ValidationError

from drake_rho.scenario.fields import unchecked
from drake_rho.scenario.maps.forms import StoredMap, reference_to
from drake_rho.scenario.maps.map import Map
from drake_rho.scenario.records import Mesh, Obstacle, Scenario, Voxels
from drake_rho.scenario.refusals import scenario_error


def with_references(scenario: Scenario, folder: Path) -> Scenario:
    """Return a scenario for a file in a folder, with maps replaced by references to their files.

    Maps without a file, or with other cells or triangles than were read from it, stay.
    """

    def reference(each: Map) -> object:
        source = each.source
        if source is None or not each.is_that_of_its_file or not Path(source.path).is_file():
            return each
        return reference_to(source, folder)

    return _with_forms(scenario, reference)


def with_numbers(scenario: Scenario, maps: list[Map]) -> Scenario:
    """Return a scenario to be written, with maps replaced by numbers in a list.

    Args:
        scenario: scenario with the maps.
        maps: maps stored so far; new ones of the scenario are appended.
    """
    return _with_forms(scenario, lambda each: StoredMap(_number_of(each, maps)))


def _with_forms(scenario: Scenario, form_of: Callable[[Map], object]) -> Scenario:
    """Return a scenario to be written, with its maps converted."""

    def written(each: object) -> object:
        if isinstance(each, Obstacle):
            return unchecked(each, shape=written(each.shape))
        return form_of(each) if isinstance(each, Map) else each

    if not any(isinstance(each.shape, Map) for each in scenario.bodies):
        return scenario
    return unchecked(scenario, obstacles=tuple(map(written, scenario.obstacles)))


def _number_of(each: Map, maps: list[Map]) -> int:
    """Return the number of a map in a list, appended to it if missing."""
    for number, other in enumerate(maps):
        if other is each or other == each:
            return number
    maps.append(each)
    return len(maps) - 1


def map_to_json(each: Map) -> str:
    """Return a map as JSON text with all of its cells or triangles."""
    return _map_adapter().dump_json(each, exclude_none=True).decode()


def map_from_json(text: str) -> Map:
    """Return the map that `map_to_json` has written.

    Raises:
        ScenarioError: the text is not JSON, or no valid map.
    """
    try:
        found: Map = _map_adapter().validate_json(text)
    except ValidationError as error:
        raise scenario_error(error, Obstacle) from None
    return found


@cache
def _map_adapter() -> TypeAdapter[Any]:
    return TypeAdapter(Annotated[Voxels | Mesh, Field(union_mode="left_to_right")])
