"""`Study`: scenarios and methods of a campaign, from a file or from Python, and its runs."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

from pydantic import Field, TypeAdapter, ValidationError, model_validator

from drake_rho.campaigns.methods import AnyMethod, in_stored_order
from drake_rho.campaigns.runs import Run, generators, run_keys
from drake_rho.campaigns.sources import AnySource, FromFile, Repetitions
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.fields import NOT_BOOLEAN, Name, record
from drake_rho.scenario.files import parsed_file, yaml_content
from drake_rho.scenario.refusals import scenario_error

_DRAWS = 100
"""Number of draws of a source; if none is a valid scenario, the study is refused."""


@record
class Study:
    """Study: sources of scenarios, methods that plan or fly them, and numbers of repetitions."""

    name: Name
    """name in tables and figures"""
    scenarios: Annotated[tuple[AnySource, ...], Field(min_length=1)]
    """sources of scenarios: generators, files, or scenarios with distributions on their fields"""
    methods: Annotated[tuple[AnyMethod, ...], Field(min_length=1)]
    """methods, which all get the same scenarios and the same winds; the others are compared with
    the first"""
    repetitions: Repetitions = 1
    """number of scenarios drawn from each source"""
    seed: Annotated[int, Field(ge=0), NOT_BOOLEAN] = 0
    """seed of all randomness"""
    plans: bool = False
    """whether to keep plans, flights and simulations"""

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
    def _names_differ(self) -> Self:
        for field in ("scenarios", "methods"):
            names = [each.name for each in getattr(self, field)]
            for index, name in enumerate(names):
                if name in names[:index]:
                    raise ScenarioError(f"{field}[{index}].name", name, "a name of its own")
        return self

    def resolved(self, folder: str | Path = ".") -> Study:
        """Return the study with the contents of its scenario files, so that no run needs a file.

        Raises:
            ScenarioError: there is no such file, or it holds no scenario.
        """
        found = list[Any]()
        for index, source in enumerate(self.scenarios):
            try:
                found.append(source.given(Path(folder)) if isinstance(source, FromFile) else source)
            except ScenarioError as error:
                raise error.inside(f"scenarios[{index}]") from None
        return dataclasses.replace(self, scenarios=tuple(found))

    def check_draws(self) -> None:
        """Check that every source can produce scenarios, before anything is planned.

        Raises:
            ScenarioError: none of the first draws of a source (of all of them, if there are fewer)
                is a valid scenario.
        """
        for index, source in enumerate(self.scenarios):
            if isinstance(source, FromFile):  # the study is not resolved
                continue
            draws = min(self.repetitions_of(index), _DRAWS)
            for repetition in range(draws):
                rng, _ = generators((self.seed, index, repetition))
                try:
                    source.drawn(rng)
                    break
                except ScenarioError as error:
                    reason = error
            else:
                drawn = Description(f"no scenario in {draws} draws of {source.name!r}")
                expected = f"at least one valid scenario; the last draw: {reason}"
                raise ScenarioError(f"scenarios[{index}]", drawn, expected)

    def repetitions_of(self, index: int) -> int:
        """Return the number of scenarios drawn from one source."""
        return self.scenarios[index].repetitions or self.repetitions

    def __len__(self) -> int:
        """Return the number of runs."""
        sources = range(len(self.scenarios))
        return len(self.methods) * sum(self.repetitions_of(index) for index in sources)

    def runs(self) -> Iterator[Run]:
        """Yield all runs, repetition by repetition.

        A study extended by more repetitions, or by scenarios or methods at the end, keeps its runs
        and adds new ones.
        """
        content = json.loads(study_to_json(self))
        sources = [_text(each, "repetitions") for each in content["scenarios"]]
        methods = [_text(in_stored_order(each)) for each in content["methods"]]
        counts = [self.repetitions_of(index) for index in range(len(sources))]
        keys = {
            (i, j): run_keys(source, method, self.seed, i)
            for i, source in enumerate(sources)
            for j, method in enumerate(methods)
        }
        for repetition in range(max(counts)):
            for i, source in enumerate(sources):
                for j, method in enumerate(methods if repetition < counts[i] else ()):
                    yield Run(
                        key=keys[i, j](repetition),
                        scenario=self.scenarios[i].name,
                        method=self.methods[j].name,
                        source_json=source,
                        method_json=method,
                        seed=(self.seed, i, repetition),
                        keep=self.plans,
                    )


@checked
def load_study(path: str | Path) -> Study:
    """Read a study from a YAML file, with the contents of its scenario files.

    Raises:
        ScenarioError: there is no such file, or it is not a valid study.
    """

    def parse(text: str, folder: Path) -> Study:
        return study_from_yaml(text).resolved(folder)

    return parsed_file(path, "study", "a readable YAML file", parse)


def study_from_yaml(text: str) -> Study:
    """Return the study that a YAML text describes.

    Raises:
        ScenarioError: the text is not YAML, or not a valid study.
    """
    try:
        return _adapter().validate_python(yaml_content(text))
    except ValidationError as error:
        raise scenario_error(error, Study) from None


def study_to_json(study: Study) -> str:
    """Return a study as one line of JSON, with every number exact."""
    return _adapter().dump_json(study, exclude_none=True).decode()


def study_schema() -> dict[str, Any]:
    """Return the JSON schema of a study file, with the units of every field."""
    return _adapter().json_schema()


def example_study() -> str:
    """Return the YAML text of a complete example study."""
    return (files("drake_rho.campaigns") / "library" / "example.yaml").read_text(encoding="utf-8")


def continues(new: str, old: str) -> bool:
    """Return whether a study contains all runs of another, so that it can continue in its store.

    Both are given as JSON. The new study may have more repetitions, more scenarios at the end, and
    more methods.
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
    """Return one line of JSON that keeps the order of entries, which is the order of drawing."""
    return json.dumps({name: value for name, value in content.items() if name != without})


@cache
def _adapter() -> TypeAdapter[Study]:
    return TypeAdapter(Study)
