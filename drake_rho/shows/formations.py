"""Formations: grids, rings, spheres, letters, drawings and tables of points, at a place."""

from __future__ import annotations

import dataclasses
import io
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import AfterValidator, Field, ValidationInfo

from drake_rho.scenario.context import Context, context_of
from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import (
    Count,
    FloatArray,
    Name,
    Points,
    Positive,
    Vector,
    read_only,
    record,
)
from drake_rho.scenario.rotations import Rotation
from drake_rho.shows.outlines import of_drawing, of_text, spread, upright
from drake_rho.system.files import read_bytes, reason_of

Number = Annotated[Count, Field(ge=1, le=10_000)]
"""Number of points."""


def _beside(path: str, info: ValidationInfo[Context | None]) -> str:
    return str(context_of(info).folder / path)


Beside = Annotated[str, AfterValidator(_beside)]
"""Path of a file, relative to the show's file if it is in one."""

_GOLDEN_ANGLE = np.pi * (1.0 + 5.0**0.5)
"""Angle by which each point of a sphere is turned from the one before [rad]."""

_LARGEST_TABLE = 50_000_000
"""Largest size of a table of points [bytes]."""


@dataclasses.dataclass(frozen=True, eq=False)
class Formation:
    """Base of all formations: points about an origin of their own, which are then placed.

    The points are scaled, rotated about their origin, and moved.
    """

    _: dataclasses.KW_ONLY
    center: Vector = dataclasses.field(default_factory=lambda: read_only(np.zeros(3)))
    """position of the points' origin [m]"""
    rotation: Rotation | None = None
    """rotation about the points' origin: roll, pitch and yaw [rad] or a matrix"""
    scale: Positive = 1.0
    """factor on the points' coordinates"""

    def points(self) -> FloatArray:
        """Return the points about their own origin [m], shape (M, 3)."""
        raise NotImplementedError

    @cached_property
    def positions(self) -> FloatArray:
        """Positions of the points in the world [m], shape (M, 3)."""
        placed = self.points() * self.scale
        if self.rotation is not None:
            placed = placed @ self.rotation.T
        return read_only(placed + self.center)


@record
class Table(Formation):
    """Given points, or those of a file.

    Examples:
        >>> rho.formations.Table([[0, 0, 0], [2, 0, 0]], center=[0, 0, 5]).positions.tolist()
        [[0.0, 0.0, 5.0], [2.0, 0.0, 5.0]]
    """

    coordinates: Points | None = None
    """the points [m]; of the file if not given"""
    path: Beside | None = None
    """CSV file with the columns x, y and z [m], with or without a header, or NPY file of shape
    (M, 3); beside the show's own file unless the path is absolute"""
    kind: Literal["table"] = "table"
    """the kind of formation"""

    if TYPE_CHECKING:

        def __init__(
            self, coordinates: npt.ArrayLike | None = None, path: str | None = None, **placed: Any
        ) -> None: ...

    def __post_init__(self) -> None:
        if (self.coordinates is None) == (self.path is None):
            raise ScenarioError("coordinates", self.coordinates, "either coordinates or a path")

    def points(self) -> FloatArray:
        """Return the points [m], shape (M, 3).

        Raises:
            ScenarioError: the file cannot be read or does not hold such a table.
        """
        if self.coordinates is not None:
            return self.coordinates
        return _table(Path(self.path or ""))


@record
class Grid(Formation):
    """Points of a grid in rows along x, columns along y and layers along z, about its middle.

    Examples:
        >>> len(rho.formations.Grid(4, 3, spacing=2.0).positions)
        12
    """

    columns: Number
    """number of points along x"""
    rows: Number
    """number of points along y"""
    layers: Number = 1
    """number of points along z"""
    spacing: Positive = Field(...)
    """distance of neighbours [m]"""
    kind: Literal["grid"] = "grid"
    """the kind of formation"""

    if TYPE_CHECKING:

        def __init__(
            self, columns: int, rows: int, layers: int = 1, *, spacing: float, **placed: Any
        ) -> None: ...

    def points(self) -> FloatArray:
        """Return the points row by row [m], shape (M, 3)."""
        counts = self.layers, self.rows, self.columns
        along = [self.spacing * (np.arange(each) - (each - 1) / 2.0) for each in counts]
        z, y, x = np.meshgrid(*along, indexing="ij")
        return np.stack([x, y, z], axis=-1).reshape(-1, 3)


@record
class Ring(Formation):
    """Points at equal distances on a circle in the x-y plane, from the x axis anticlockwise."""

    count: Number
    """number of points"""
    radius: Positive
    """radius [m]"""
    kind: Literal["ring"] = "ring"
    """the kind of formation"""

    if TYPE_CHECKING:

        def __init__(self, count: int, radius: float, **placed: Any) -> None: ...

    def points(self) -> FloatArray:
        """Return the points [m], shape (M, 3)."""
        angles = 2.0 * np.pi * np.arange(self.count) / self.count
        return self.radius * np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1)


@record
class Sphere(Formation):
    """Points on a sphere, as evenly as a spiral by the golden angle has them."""

    count: Number
    """number of points"""
    radius: Positive
    """radius [m]"""
    kind: Literal["sphere"] = "sphere"
    """the kind of formation"""

    if TYPE_CHECKING:

        def __init__(self, count: int, radius: float, **placed: Any) -> None: ...

    def points(self) -> FloatArray:
        """Return the points from the lowest to the highest [m], shape (M, 3)."""
        at = np.arange(self.count)
        z = (2.0 * at + 1.0) / self.count - 1.0
        away, angles = np.sqrt(1.0 - z**2), _GOLDEN_ANGLE * at
        return self.radius * np.stack([away * np.cos(angles), away * np.sin(angles), z], axis=1)


@record
class Letters(Formation):
    """Points along the outlines of a text, upright in the x-z plane and legible from negative y."""

    text: Name
    """the letters, in one line"""
    count: Number
    """number of points, at least one for each closed line"""
    height: Positive
    """height of the whole text [m]"""
    font: Beside | None = None
    """file of a TrueType or OpenType font; matplotlib's DejaVu Sans if not given"""
    kind: Literal["letters"] = "letters"
    """the kind of formation"""

    if TYPE_CHECKING:

        def __init__(
            self, text: str, count: int, height: float, font: str | None = None, **placed: Any
        ) -> None: ...

    def points(self) -> FloatArray:
        """Return the points letter by letter [m], shape (M, 3).

        Raises:
            ScenarioError: the font cannot be read, or there are too few points.
        """
        outlines = of_text(self.text, None if self.font is None else Path(self.font))
        return upright(spread(outlines, self.count), self.height)


@record
class Drawing(Formation):
    """Points along the paths and shapes of an SVG file, upright in the x-z plane."""

    path: Beside
    """SVG file, beside the show's own file unless the path is absolute (extra `shows`)"""
    count: Number
    """number of points, at least one for each line"""
    height: Positive
    """height of the drawing [m]"""
    kind: Literal["drawing"] = "drawing"
    """the kind of formation"""

    if TYPE_CHECKING:

        def __init__(self, path: str, count: int, height: float, **placed: Any) -> None: ...

    def points(self) -> FloatArray:
        """Return the points line by line [m], shape (M, 3).

        Raises:
            ScenarioError: the file cannot be read, or there are too few points.
        """
        return upright(spread(of_drawing(Path(self.path)), self.count), self.height)


AnyFormation = Annotated[
    Table | Grid | Ring | Sphere | Letters | Drawing, Field(discriminator="kind")
]
"""One of the formations, distinguished by its kind."""


def _table(path: Path) -> FloatArray:
    """Return the points of a CSV or NPY file [m], shape (M, 3).

    Raises:
        ScenarioError: the file cannot be read, or does not hold three finite numbers a row.
    """
    expected = "a CSV file with columns x, y and z, or an NPY file of shape (M, 3)"
    try:
        content = read_bytes(path, _LARGEST_TABLE)
        if path.suffix.lower() == ".npy":
            points = np.load(io.BytesIO(content), allow_pickle=False)
        else:
            points = _rows(content.decode())
        points = np.asarray(points, dtype=np.float64)
    except (OSError, ValueError) as error:
        raise ScenarioError("path", str(path), f"{expected}; {reason_of(error)}") from None
    if points.ndim != 2 or points.shape[1] != 3 or not len(points):
        raise ScenarioError("path", str(path), f"{expected}; it has shape {points.shape}")
    if not np.isfinite(points).all():
        row = int(np.argwhere(~np.isfinite(points))[0, 0])
        raise ScenarioError("path", str(path), f"finite numbers; row {row + 1} has others")
    return read_only(points)


def _rows(text: str) -> FloatArray:
    """Return the numbers of a CSV text whose first line may be a header, shape (M, 3)."""
    lines = [line for line in text.splitlines() if line.strip()]
    first = lines[0].lower().replace(" ", "") if lines else ""
    return np.loadtxt(lines[1:] if first == "x,y,z" else lines, delimiter=",", ndmin=2)
