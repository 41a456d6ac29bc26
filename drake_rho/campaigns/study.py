"""`Study`: what is run, as a file or in Python, and the runs that it consists of."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

from pydantic import Field, TypeAdapter, ValidationError, model_validator

from drake_rho.campaigns.methods import AnyMethod
from drake_rho.campaigns.runs import Run, generators, run_keys
from drake_rho.campaigns.sources import AnySource, FromFile, Repetitions
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.errors import ScenarioError, Words
from drake_rho.scenario.fields import NO_TRUTH, Name, record, scenario_error
from drake_rho.scenario.files import yaml_content

_DRAWS = 100
"""Draws of a source of which one has to be a scenario, or its study is refused."""


@record
class Study:
    """Scenarios, methods that plan or fly each of them, and how often."""

    name: Name
    """shown in tables and figures"""
    scenarios: Annotated[tuple[AnySource, ...], Field(min_length=1)]
    """where they come from: generators, files, or one with distributions on its fields"""
    methods: Annotated[tuple[AnyMethod, ...], Field(min_length=1)]
    """every one is given the same scenarios and the same winds; the first is what others are
    compared with"""
    repetitions: Repetitions = 1
    """how many scenarios are drawn of each source"""
    seed: Annotated[int, Field(ge=0), NO_TRUTH] = 0
    """where all chance comes from"""
    plans: bool = False
    """whether plans, flights and simulations are kept too"""

    if TYPE_CHECKING:

        def __init__(
            self,
            name: str,
            scenarios: Sequence[Any],
            methods: Sequence[Any],
            repetitions: int = 1,
            seed: int = 0,
            plans: bool = False,
        ) -> None: ...

    @model_validator(mode="after")
    def _named_apart(self) -> Self:
        for field in ("scenarios", "methods"):
            names = [each.name for each in getattr(self, field)]
            for index, name in enumerate(names):
                if name in names[:index]:
                    raise ScenarioError(f"{field}[{index}].name", name, "a name of its own")
        return self

    def resolved(self, folder: str | Path = ".") -> Study:
        """The same study with the scenarios of files in it, so that no run needs a file.

        Raises:
            ScenarioError: there is no such file, or no scenario in it.
        """
        found = list[Any]()
        for index, source in enumerate(self.scenarios):
            try:
                found.append(source.given(Path(folder)) if isinstance(source, FromFile) else source)
            except ScenarioError as error:
                raise error.inside(f"scenarios[{index}]") from None
        return dataclasses.replace(self, scenarios=tuple(found))

    def check_draws(self) -> None:
        """See that the scenarios of every source can be drawn, before anything is planned.

        Raises:
            ScenarioError: none of the first draws of a source, nor of all that it is asked for if
                they are fewer, is a scenario that makes sense.
        """
        for index, source in enumerate(self.scenarios):
            if isinstance(source, FromFile):  # as in a study that is not resolved
                continue
            draws = min(self.repetitions_of(index), _DRAWS)
            for repetition in range(draws):
                chance, _ = generators((self.seed, index, repetition))
                try:
                    source.drawn(chance)
                    break
                except ScenarioError as error:
                    reason = error
            else:
                drawn = Words(f"no scenario in {draws} draws of {source.name!r}")
                expected = f"at least one that makes sense; the last one: {reason}"
                raise ScenarioError(f"scenarios[{index}]", drawn, expected)

    def repetitions_of(self, index: int) -> int:
        """How many scenarios are drawn of one source."""
        return self.scenarios[index].repetitions or self.repetitions

    def __len__(self) -> int:
        """How many runs it consists of."""
        sources = range(len(self.scenarios))
        return len(self.methods) * sum(self.repetitions_of(index) for index in sources)

    def runs(self) -> Iterator[Run]:
        """All runs, one repetition of everything after another.

        The runs of a study that is longer, with more repetitions or with more scenarios or methods
        behind, are the same and some more.
        """
        content = json.loads(study_to_json(self))
        sources = [_text(each, "repetitions") for each in content["scenarios"]]
        methods = [_text(each) for each in content["methods"]]
        names = [each.name for each in self.scenarios], [each.name for each in self.methods]
        counts = [self.repetitions_of(index) for index in range(len(sources))]
        keys = {
            (i, j): run_keys(source, method, self.seed, i)
            for i, source in enumerate(sources)
            for j, method in enumerate(methods)
        }
        for repetition in range(max(counts)):
            for i, source in enumerate(sources):
                if repetition >= counts[i]:
                    continue
                for j, method in enumerate(methods):
                    yield Run(
                        key=keys[i, j](repetition),
                        scenario=names[0][i],
                        method=names[1][j],
                        source_json=source,
                        method_json=method,
                        seed=(self.seed, i, repetition),
                        keep=self.plans,
                    )


@checked
def load_study(path: str | Path) -> Study:
    """Read a study from a YAML file, scenarios of files included.

    Raises:
        ScenarioError: there is no such file, or it is no valid study.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "not a UTF-8 text file"
        raise ScenarioError("study", str(path), f"a readable YAML file; {reason}") from None
    try:
        return study_from_yaml(text).resolved(Path(path).parent)
    except ScenarioError as error:
        where = f"{path}: {error.field}" if error.field else str(path)
        raise ScenarioError(where, error.value, error.expected) from None


def study_from_yaml(text: str) -> Study:
    """The study that some text describes.

    Raises:
        ScenarioError: the text is not YAML, or no valid study.
    """
    try:
        return _adapter().validate_python(yaml_content(text))
    except ValidationError as error:
        raise scenario_error(error, Study) from None


def study_to_json(study: Study) -> str:
    """A study as one line of JSON, every number exact."""
    return _adapter().dump_json(study, exclude_none=True).decode()


def study_schema() -> dict[str, Any]:
    """JSON schema of a study file, with the units of every field."""
    return _adapter().json_schema()


def example_study() -> str:
    """The YAML text of a complete study."""
    return (files("drake_rho.campaigns") / "library" / "example.yaml").read_text(encoding="utf-8")


def continues(new: str, old: str) -> bool:
    """Whether a study has all runs of another one, both as JSON, so that it can go on from there.

    It may have more repetitions, more scenarios behind, and other methods beside.
    """
    now, then = json.loads(new), json.loads(old)
    if any(now[field] != then[field] for field in ("seed", "plans")):
        return False
    if len(now["scenarios"]) < len(then["scenarios"]):
        return False
    if any(method not in now["methods"] for method in then["methods"]):
        return False
    return all(
        _text(one, "repetitions") == _text(other, "repetitions")
        and one.get("repetitions", now["repetitions"])
        >= other.get("repetitions", then["repetitions"])
        for one, other in zip(now["scenarios"], then["scenarios"], strict=False)
    )


def _text(content: Mapping[str, Any], without: str = "") -> str:
    """One line of JSON, the order of the entries kept: in it distributions are drawn."""
    return json.dumps({name: value for name, value in content.items() if name != without})


@cache
def _adapter() -> TypeAdapter[Study]:
    return TypeAdapter(Study)
