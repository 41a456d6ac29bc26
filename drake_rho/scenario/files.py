"""Scenario files in YAML, their JSON schema, and the library that comes with the package."""

from __future__ import annotations

import reprlib
from collections.abc import Callable, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import TypeAdapter, ValidationError

from drake_rho.scenario.arguments import checked
from drake_rho.scenario.context import Context
from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.goals import is_storable
from drake_rho.scenario.maps.map import Map
from drake_rho.scenario.records import KeepIn, Scenario, Waypoint
from drake_rho.scenario.refusals import scenario_error
from drake_rho.scenario.sets import PACKAGE_SET
from drake_rho.scenario.written_maps import with_numbers, with_references
from drake_rho.system.files import atomic_write, read_text, reason_of

_Parsed = TypeVar("_Parsed")

_HERE = Path()
"""Working directory of the program."""

_MOST_REPEATED = 500_000
"""Largest number of values that aliases of YAML repeat: few lines may stand for billions."""

_LIBRARY = files("drake_rho.scenario") / "library"


def library() -> tuple[str, ...]:
    """Return the names of the scenarios that come with the package.

    Examples:
        >>> "paper" in rho.library()
        True
    """
    names = (entry.name for entry in _LIBRARY.iterdir())
    return tuple(sorted(name.removesuffix(".yaml") for name in names if name.endswith(".yaml")))


@checked
def load_scenario(source: str | Path) -> Scenario:
    """Read a scenario and the map files to which it refers.

    Args:
        source: the name of a library scenario, as `"paper"`, or the path of a YAML file.

    Warns:
        MapChangedWarning: a map's file has changed since the scenario was saved; it is read as it
            is now.

    Raises:
        ScenarioError: there is no such scenario, or it is not a valid one.

    Examples:
        >>> scenario = rho.load_scenario("paper")
        >>> len(scenario.vehicles), scenario.grid.knots, scenario.obstacles[0].radius
        (4, 50, 1000.0)
    """
    if isinstance(source, str) and source in library():
        return scenario_from_yaml((_LIBRARY / f"{source}.yaml").read_text(encoding="utf-8"))
    expected = f"a library scenario ({', '.join(library())}) or a readable YAML file"
    return parsed_file(source, "scenario", expected, scenario_from_yaml)


def parsed_file(
    path: str | Path, what: str, expected: str, parse: Callable[[str, Path], _Parsed]
) -> _Parsed:
    """Return what a YAML file describes.

    Args:
        path: of the file.
        what: name of its content, for errors.
        expected: description of such files, for errors.
        parse: function of the file's text and its folder.

    Raises:
        ScenarioError: there is no such file, or `parse` refuses it; the error names the file.
    """
    try:
        text = read_text(path)
    except (OSError, ValueError) as error:
        raise ScenarioError(what, str(path), f"{expected}; {reason_of(error)}") from None
    try:
        return parse(text, Path(path).parent)
    except ScenarioError as error:
        where = f"{path}: {error.field}" if error.field else str(path)
        raise ScenarioError(where, error.value, error.expected) from None


@checked
def save_scenario(scenario: Scenario, path: str | Path) -> None:
    """Write a scenario as YAML. The file is written completely or not at all.

    A map read from a file is written as the path of that file, relative to the scenario's, with its
    hash; any other map, or one whose file is gone, with all of its cells or triangles.

    Raises:
        OSError: the file cannot be written.
    """
    with atomic_write(path) as file:
        file.write(scenario_to_yaml(scenario, Path(path).resolve().parent).encode())


def scenario_from_yaml(text: str, folder: Path = _HERE) -> Scenario:
    """Return the scenario that YAML text describes.

    Args:
        text: in YAML.
        folder: base of the relative paths of maps.

    Raises:
        ScenarioError: the text is not YAML, or not a valid scenario.
    """
    return scenario_from_content(yaml_content(text), folder)


def scenario_from_content(content: object, folder: Path = _HERE) -> Scenario:
    """Return the scenario described by the mappings, lists and values of a file.

    Args:
        content: of the file.
        folder: base of the relative paths of maps.

    Raises:
        ScenarioError: they do not describe a valid scenario.
    """
    try:
        return _adapter().validate_python(content, context=Context(folder=folder))
    except ValidationError as error:
        raise scenario_error(error, Scenario) from None


def scenario_to_content(scenario: Scenario) -> dict[str, Any]:
    """Return a scenario as mappings, lists and values, with every field; absent ones are None.

    Raises:
        ScenarioError: a requirement or a waypoint has a user's own set, which no file can hold.
    """
    _check_storable(scenario)
    content: dict[str, Any] = _adapter().dump_python(scenario, mode="json")
    weights = scenario.objective.weights._asdict()  # files omit those without an effect
    content["objective"] = {**weights, "reference": None, **content.get("objective", {})}
    return content


def yaml_content(text: str) -> object:
    """Return the content of YAML text as mappings, lists and values.

    Raises:
        ScenarioError: the text is not YAML, or repeats a key.
    """
    try:
        # `_Loader` is a SafeLoader that also rejects repeated keys.
        return yaml.load(text, Loader=_Loader)  # noqa: S506
    except RecursionError:
        raise ScenarioError(
            "", Description("malformed YAML"), "YAML that is less deeply nested"
        ) from None
    except (TypeError, AttributeError, LookupError):  # PyYAML raises these for `!!bool perhaps`
        expected = "YAML whose values have the types that their tags (!!) name"
        raise ScenarioError("", Description("malformed YAML"), expected) from None
    except (yaml.YAMLError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise ScenarioError("", Description("malformed YAML"), f"YAML; {reason}") from None


def scenario_to_yaml(scenario: Scenario, folder: Path | None = None) -> str:
    """Return a scenario as YAML text, with the fields in their order, without absent ones.

    Args:
        scenario: to be written.
        folder: of the scenario's file, to which the paths of maps are relative; without it, maps
            are written with all of their cells or triangles.
    """
    _check_storable(scenario)
    if folder is not None:
        scenario = with_references(scenario, folder)
    content = _adapter().dump_python(scenario, mode="json", exclude_none=True)
    return yaml.safe_dump(content, sort_keys=False, default_flow_style=None, allow_unicode=True)


def scenario_to_json(scenario: Scenario, maps: list[Map] | None = None) -> str:
    """Return a scenario as one line of JSON with exact numbers, to be stored in other files.

    Args:
        scenario: to be stored.
        maps: maps stored elsewhere. The scenario refers to them by their numbers, and its other
            maps are appended. If not given, the text has all of their cells or triangles.
    """
    _check_storable(scenario)
    if maps is not None:
        scenario = with_numbers(scenario, maps)
    return _adapter().dump_json(scenario, exclude_none=True).decode()


def _check_storable(scenario: Scenario) -> None:
    """Check that a file can hold a scenario.

    Raises:
        ScenarioError: a requirement, a waypoint or a goal has a user's own set.
    """
    storable: list[tuple[str, KeepIn | Waypoint]] = [
        (f"requirements[{k}]", each) for k, each in enumerate(scenario.requirements)
    ]
    for i, vehicle in enumerate(scenario.vehicles):
        if not is_storable(vehicle.goal):
            raise ScenarioError(f"vehicles[{i}].goal", vehicle.goal, PACKAGE_SET)
        storable += [
            (f"vehicles[{i}].waypoints[{k}]", each) for k, each in enumerate(vehicle.waypoints)
        ]
    for field, each in storable:
        try:
            each.check_storable()
        except ScenarioError as error:
            raise error.inside(field) from None


def scenario_from_json(text: str, *, under_way: bool = False, maps: Sequence[Map] = ()) -> Scenario:
    """Return the scenario that `scenario_to_json` has written.

    Args:
        text: JSON of the scenario.
        under_way: whether the scenario is the remainder of a flight, which may begin too close to
            an obstacle that became known late; its starts are not checked then.
        maps: maps to which the scenario refers by their numbers.

    Raises:
        ScenarioError: the text is not JSON, or not a valid scenario.
    """
    try:
        context = Context(under_way=under_way, maps=maps)
        scenario = _adapter().validate_json(text, context=context)
    except ValidationError as error:
        raise scenario_error(error, Scenario) from None
    return scenario.derived(under_way=True) if under_way else scenario


def scenario_schema() -> dict[str, Any]:
    """Return the JSON schema of a scenario file, with the units of every field."""
    return _adapter().json_schema()


@cache
def _adapter() -> TypeAdapter[Scenario]:
    return TypeAdapter(Scenario)


class _Loader(yaml.SafeLoader):
    """YAML's safe loader, which also rejects repeated keys and excessive expansion of aliases."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._values = self._repeated = 0
        self._sizes = dict[str, int]()

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Compose a node, and count its values with all aliases expanded."""
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        if isinstance(event, yaml.AliasEvent):
            self._repeat(event)
        before = self._values
        self._values += 1
        node = super().compose_node(parent, index)
        if not isinstance(event, yaml.AliasEvent) and event.anchor is not None:
            self._sizes[event.anchor] = self._values - before
        return node

    def _repeat(self, alias: Any) -> None:
        """Count the values that an alias repeats."""
        name = alias.anchor
        if name in self.anchors and name not in self._sizes:
            words = f"aliases of other values, not {reprlib.repr(name)} inside of itself"
            raise yaml.MarkedYAMLError(problem=words, problem_mark=alias.start_mark)
        self._values += self._sizes.get(name, 0)
        self._repeated += self._sizes.get(name, 0)
        if self._repeated > _MOST_REPEATED:
            words = f"aliases that repeat at most {_MOST_REPEATED} values"
            raise yaml.MarkedYAMLError(problem=words, problem_mark=alias.start_mark)

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        node: yaml.MappingNode = super().compose_mapping_node(anchor)
        seen = set()
        for key, _ in node.value:
            name = _name(key)
            if name in seen and key.tag != "tag:yaml.org,2002:merge":
                words = f"the key {reprlib.repr(key.value)} once, not again"
                raise yaml.MarkedYAMLError(problem=words, problem_mark=key.start_mark)
            seen.add(name)
        return node

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        """Merge mappings and keep each key once: nested merges would grow exponentially."""
        super().flatten_mapping(node)
        node.value = list({_name(key): (key, value) for key, value in node.value}.values())


def _name(key: yaml.Node) -> object:
    """Return the identity of a key. Only scalar keys are compared: field names are scalars."""
    return (key.tag, key.value) if isinstance(key, yaml.ScalarNode) else key
