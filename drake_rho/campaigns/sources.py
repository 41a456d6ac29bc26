"""Sources of a study's scenarios: generators, files, and scenarios with randomly varied fields."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import field
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_type_hints

import numpy as np
from pydantic import Discriminator, Field, Tag, TypeAdapter, ValidationError

from drake_rho.campaigns.distributions import AnyDistribution, is_distribution
from drake_rho.campaigns.paths import add, put, suggestion
from drake_rho.formats.lsc_missions import is_lsc_mission, load_lsc_mission
from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import Count, Name, Positive, record
from drake_rho.scenario.files import load_scenario, scenario_from_content, scenario_to_content
from drake_rho.scenario.problems.generators import circle_swap, random_transitions
from drake_rho.scenario.problems.worlds import random_field, trefoil_swap
from drake_rho.scenario.records import Grid, Scenario
from drake_rho.scenario.refusals import scenario_error

GENERATORS: dict[str, Callable[..., Scenario]] = {
    "random_transitions": random_transitions,
    "circle_swap": circle_swap,
    "trefoil_swap": trefoil_swap,
    "random_field": random_field,
}
"""Generators by their names in a study."""

_DRAWS = 10
"""Number of draws; if none is a valid scenario, the parameters are refused."""

Repetitions = Annotated[Count, Field(ge=1, le=10_000_000)]
if TYPE_CHECKING:
    Vary = Mapping[str, Any]  # mappings that describe distributions become them
else:
    Vary = dict[str, AnyDistribution]


@record
class Generated:
    """Scenarios of a generator."""

    name: Name
    """name of these scenarios in tables and figures"""
    generator: Literal["random_transitions", "circle_swap", "trefoil_swap", "random_field"]
    """function of this package that generates them"""
    parameters: dict[str, Any] = field(default_factory=dict)
    """arguments of the generator by name, without `rng`; each may be a distribution"""
    vary: Vary = field(default_factory=dict)
    """distributions of values that replace fields of a generated scenario, by the fields' paths;
    drawn in this order"""
    offset: Vary = field(default_factory=dict)
    """distributions of offsets that are added to fields, by the fields' paths; drawn after `vary`
    """
    repetitions: Repetitions | None = None
    """number of scenarios drawn; that of the study if not given"""

    def __post_init__(self) -> None:
        _check_parameters(self.generator, self.parameters)
        for seed in range(_DRAWS):
            try:
                made = self._generated(np.random.default_rng(seed))
                break
            except ScenarioError as error:
                refused = error
        else:
            raise refused.inside("parameters")
        _check_paths(made, self.vary, self.offset)

    def drawn(self, rng: np.random.Generator) -> Scenario:
        """Draw one of the scenarios.

        Raises:
            ScenarioError: the values drawn do not make a valid scenario.
        """
        return varied(self._generated(rng), self.vary, self.offset, rng)

    def _generated(self, rng: np.random.Generator) -> Scenario:
        generator = GENERATORS[self.generator]
        drawn: dict[str, Any] = {
            name: _parameter(self.generator, name, _drawn(value, rng))
            for name, value in self.parameters.items()
        }
        if "rng" in inspect.signature(generator).parameters:
            drawn["rng"] = rng
        try:
            return generator(**drawn)
        except TypeError as error:  # a parameter without default is missing
            raise ScenarioError("", dict(self.parameters), str(error)) from None


@record
class Given:
    """One scenario, with distributions on any of its fields."""

    name: Name
    """name of these scenarios in tables and figures"""
    scenario: Scenario
    """scenario whose fields are varied"""
    vary: Vary = field(default_factory=dict)
    """distributions of values that replace fields, by the fields' paths; drawn in this order"""
    offset: Vary = field(default_factory=dict)
    """distributions of offsets that are added to fields, by the fields' paths; drawn after `vary`
    """
    repetitions: Repetitions | None = None
    """number of scenarios drawn; that of the study if not given"""

    def __post_init__(self) -> None:
        _check_paths(self.scenario, self.vary, self.offset)

    def drawn(self, rng: np.random.Generator) -> Scenario:
        """Draw one of the scenarios.

        Raises:
            ScenarioError: the values drawn do not make a valid scenario.
        """
        return varied(self.scenario, self.vary, self.offset, rng)


@record
class FromFile:
    """Scenario from a file or from the library, or a mission of the LSC planner."""

    name: Name
    """name of these scenarios in tables and figures"""
    file: str
    """name of a library scenario, or path of a YAML file or of a mission (.json), relative to the
    folder of the study's file"""
    duration: Positive | None = None
    """duration of a mission's flight [s]"""
    step: Positive | None = None
    """step of a mission's grid, which divides the duration [s]"""
    world: str | None = None
    """path of a CSV file with boxes, or of an OctoMap, that are a mission's obstacles"""
    vary: Vary = field(default_factory=dict)
    """distributions of values that replace fields, by the fields' paths; drawn in this order"""
    offset: Vary = field(default_factory=dict)
    """distributions of offsets that are added to fields, by the fields' paths; drawn after `vary`
    """
    repetitions: Repetitions | None = None
    """number of scenarios drawn; that of the study if not given"""

    def given(self, folder: Path) -> Given:
        """Return this source with the content of the file in place of its path.

        Raises:
            ScenarioError: there is no such file, or it holds no scenario.
        """
        scenario = self._read(folder)
        _check_paths(scenario, self.vary, self.offset)
        return Given(self.name, scenario, self.vary, self.offset, self.repetitions)

    def _read(self, folder: Path) -> Scenario:
        path = folder / self.file
        if not is_lsc_mission(path):
            self._check_no_mission()
            return load_scenario(path if path.exists() else self.file)
        if self.duration is None or self.step is None:
            raise ScenarioError("file", self.file, "a duration and a step together with a mission")
        world = None if self.world is None else folder / self.world
        grid = Grid.lasting(self.duration, step=self.step)
        return load_lsc_mission(path, grid=grid, world=world)

    def _check_no_mission(self) -> None:
        for name in ("duration", "step", "world"):
            if getattr(self, name) is not None:
                expected = f"a mission (.json) with it, not {self.file}"
                raise ScenarioError(name, getattr(self, name), expected)


_KINDS = {"generator": "Generated", "file": "FromFile", "scenario": "Given"}


def _kind(value: object) -> str:
    """Return the name of a value's record type, or of the type that a mapping describes.

    Misspelt keys are recognised, too.
    """
    if not isinstance(value, Mapping):
        return type(value).__name__
    for key in value:
        if close := get_close_matches(str(key), _KINDS, 1, 0.75):
            return _KINDS[close[0]]
    raise ScenarioError("", dict(value), "a mapping with generator, file or scenario")


AnySource = Annotated[
    Annotated[Generated, Tag("Generated")]
    | Annotated[FromFile, Tag("FromFile")]
    | Annotated[Given, Tag("Given")],
    Discriminator(_kind),
]
"""One of the sources of scenarios, distinguished by its keys."""


def varied(
    scenario: Scenario,
    vary: Mapping[str, Any],
    offset: Mapping[str, Any],
    rng: np.random.Generator,
) -> Scenario:
    """Return a scenario with randomly drawn values and offsets for some of its fields.

    Raises:
        ScenarioError: there is no such field, or the result is not a valid scenario.
    """
    if not vary and not offset:
        return scenario
    content = scenario_to_content(scenario)
    for path, distribution in vary.items():
        put(content, path, distribution.draw(rng))
    for path, distribution in offset.items():
        add(content, path, distribution.draw(rng))
    return scenario_from_content(content)


def _check_paths(scenario: Scenario, vary: Mapping[str, Any], offset: Mapping[str, Any]) -> None:
    """Check that the fields exist, and that those with offsets are numeric."""
    content, rng = scenario_to_content(scenario), np.random.default_rng(0)
    for name, distributions, change in (("vary", vary, put), ("offset", offset, add)):
        for path, distribution in distributions.items():
            try:
                change(content, path, distribution.draw(rng))
            except ScenarioError as error:
                raise error.inside(name) from None


def _check_parameters(generator: str, parameters: Mapping[str, object]) -> None:
    known = _kinds_of(generator)
    for name in parameters:
        if name not in known:
            hint = suggestion(name, known) or f"; there are {', '.join(known)}"
            expected = f"no parameter of this name for {generator}{hint}"
            raise ScenarioError(f"parameters.{name}", parameters[name], expected)


def _drawn(value: object, rng: np.random.Generator) -> object:
    """Return a value, or a draw from it if it is a distribution."""
    if not is_distribution(value):
        return value
    return _distributions().validate_python(value).draw(rng)


def _parameter(generator: str, name: str, value: object) -> object:
    """Convert a parameter to the type that a generator takes, mappings to records.

    Raises:
        ScenarioError: the value does not have this type.
    """
    kind = _kinds_of(generator)[name]
    try:
        return _adapter(generator, name).validate_python(value)
    except ValidationError as error:
        raise scenario_error(error, kind if isinstance(kind, type) else object, name) from None


@cache
def _kinds_of(generator: str) -> dict[str, Any]:
    """Return names and types of a generator's parameters, except `rng`."""
    hints = get_type_hints(GENERATORS[generator])
    return {name: kind for name, kind in hints.items() if name not in ("rng", "return")}


@cache
def _adapter(generator: str, name: str) -> TypeAdapter[Any]:
    return TypeAdapter(_kinds_of(generator)[name])


@cache
def _distributions() -> TypeAdapter[Any]:
    return TypeAdapter(AnyDistribution)
