"""Folders that the files of a world may be in, and models in them by their names."""

from __future__ import annotations

import dataclasses
import os
import re
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import unquote

from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.maps.source import named

VARIABLES = ("GZ_SIM_RESOURCE_PATH", "SDF_PATH", "GAZEBO_MODEL_PATH")
"""Environment variables with folders of models, as Gazebo and SDFormat read them."""

_LOCAL = re.compile(r"(?:package|model)://(?P<name>[\w-][\w. -]*)(?P<rest>/.*)?$")
"""Reference to a file of a model or a package by its name."""

_ON_SERVER = re.compile(
    r"https?://[^/]+/(?:[\d.]+/)?[^/]+/models/(?P<name>[\w-][\w. -]*)"
    r"(?:/(?:\d+|tip))?(?:/files(?P<rest>/.*))?/?$"
)
"""Reference to a model on a server such as Gazebo Fuel, or to a file of it."""


@dataclasses.dataclass(frozen=True)
class Named:
    """Reference to a file of a model or a package by its name."""

    name: str
    """name of the model or package"""
    rest: str
    """path of the file in its folder; empty for the model itself"""
    is_on_server: bool
    """whether the reference is the address of a server"""

    @classmethod
    def of(cls, text: str) -> Named | None:
        """Return the parts of a reference; None if it is of another form."""
        given = unquote(text)
        if found := _LOCAL.match(given):
            return cls(found["name"], (found["rest"] or "").lstrip("/"), False)
        if found := _ON_SERVER.match(given):
            return cls(found["name"], (found["rest"] or "").lstrip("/"), True)
        return None


@dataclasses.dataclass(frozen=True)
class Resources:
    """Folders from which a world is read, the world's own first."""

    folders: tuple[Path, ...]
    """absolute paths without links, in the order in which they are searched"""

    @classmethod
    def of(cls, world: Path, given: Sequence[str | Path]) -> Resources:
        """Return the folder of a world, given ones, `models` beside it and those of Gazebo.

        Args:
            world: absolute path of the world's file.
            given: further folders.

        Raises:
            ScenarioError: a given folder is not there.
        """
        for each in given:
            if not Path(each).is_dir():
                raise ScenarioError("resource_path", Description(named(each)), "a folder")
        listed = [each for key in VARIABLES for each in os.environ.get(key, "").split(os.pathsep)]
        # an empty or relative path would mean the working directory, which is not the world's
        absolute = [Path(each) for each in listed if Path(each).is_absolute()]
        beside = [world.parent / "models", world.parent.parent / "models"]
        folders = [world.parent, *map(Path, given), *beside, *absolute]
        there = [each.resolve() for each in folders if each.is_dir()]
        return cls(tuple(dict.fromkeys(there)))

    def __str__(self) -> str:
        """Return the list of folders for errors."""
        return ", ".join(named(each) for each in self.folders)

    def has(self, path: Path) -> bool:
        """Return whether a path, with links followed, is in one of the folders."""
        there = path.resolve()
        return any(there.is_relative_to(each) for each in self.folders)

    def folder_of(self, name: str) -> Path | None:
        """Return the folder of a model or package: one in a folder, or itself; None if missing."""
        for folder in self.folders:
            for path in (folder / name, folder):
                if path.name == name and path.is_dir() and path.resolve().is_relative_to(folder):
                    return path
        return None
