"""Outlines of letters and drawings, and points at equal distances along them."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import FloatArray
from drake_rho.system.files import read_text, reason_of

_PER_CURVE = 400
"""Number of points by which each curve of a drawing is approximated."""

_LARGEST_DRAWING = 10_000_000
"""Largest size of a drawing [bytes]."""


def spread(outlines: list[FloatArray], count: int) -> FloatArray:
    """Return points along outlines, each outline with a number in proportion to its length.

    Args:
        outlines: corners of lines [m], each of shape (M, 2); a closed one ends where it begins.
        count: number of points, at least one for each outline.

    Returns:
        Points, shape (count, 2): on closed outlines equidistant along them, on open ones from end
        to end.

    Raises:
        ScenarioError: there are fewer points than outlines.
    """
    if count < len(outlines):
        expected = f"at least {len(outlines)}, one for each of the outlines"
        raise ScenarioError("count", count, expected)
    lengths = np.array([np.linalg.norm(np.diff(each, axis=0), axis=1).sum() for each in outlines])
    shares = lengths / lengths.sum() * (count - len(outlines))
    numbers = 1 + np.floor(shares).astype(np.int64)
    most_left = np.argsort(np.floor(shares) - shares, kind="stable")
    numbers[most_left[: count - numbers.sum()]] += 1
    return np.concatenate([_along(*each) for each in zip(outlines, numbers, strict=True)])


def _along(outline: FloatArray, count: int) -> FloatArray:
    """Return points at equal distances along one outline, shape (count, 2)."""
    lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(outline, axis=0), axis=1)))
    is_closed = np.array_equal(outline[0], outline[-1])
    at = np.linspace(0.0, lengths[-1], count, endpoint=not is_closed)
    return np.stack([np.interp(at, lengths, each) for each in outline.T], axis=1)


def upright(points: FloatArray, height: float) -> FloatArray:
    """Return flat points as positions in the x-z plane, scaled to a height and centred (M, 3)."""
    low, high = points.min(axis=0), points.max(axis=0)
    tall = high[1] - low[1]
    if not tall > 0.0:
        tall = high[0] - low[0]
    flat = (points - (low + high) / 2.0) * (height / tall)
    return np.stack([flat[:, 0], np.zeros(len(flat)), flat[:, 1]], axis=1)


def of_text(text: str, font: Path | None) -> list[FloatArray]:
    """Return the closed outlines of a text's letters, shape (M, 2) each.

    Args:
        text: letters, in one line.
        font: file of a TrueType or OpenType font; matplotlib's DejaVu Sans if not given.

    Raises:
        ScenarioError: the font cannot be read, or the text is blank.
    """
    if not text.strip():
        raise ScenarioError("text", text, "at least one letter")
    from matplotlib.font_manager import FontProperties  # slow to load, so only where needed
    from matplotlib.textpath import TextPath

    try:
        if font is not None and not font.is_file():
            raise OSError("no such file")
        face = FontProperties(family="DejaVu Sans") if font is None else FontProperties(fname=font)
        path = TextPath((0.0, 0.0), text, size=100.0, prop=face)
    except (OSError, RuntimeError, ValueError) as error:
        expected = f"the file of a TrueType or OpenType font; {error}"
        raise ScenarioError("font", str(font), expected) from None
    polygons = [np.asarray(each, dtype=np.float64) for each in path.to_polygons()]
    return [_closed(each) for each in polygons if len(each) > 2]


def of_drawing(path: Path) -> list[FloatArray]:
    """Return the lines of an SVG drawing's paths and shapes, y upwards, shape (M, 2) each.

    Raises:
        ScenarioError: the file cannot be read, declares entities, or has no paths, or the extra
            `shows` is not installed.
    """
    try:
        from svgelements import SVG, Shape
        from svgelements import Path as Curve
    except ImportError:
        expected = "the extra shows: pip install 'drake-rho[shows]'"
        raise ScenarioError("path", str(path), expected) from None

    try:
        text = read_text(path, _LARGEST_DRAWING)
    except (OSError, ValueError) as error:
        raise ScenarioError("path", str(path), f"a readable SVG file; {reason_of(error)}") from None
    if "<!ENTITY" in text:
        raise ScenarioError("path", str(path), "an SVG file without entities")
    try:
        shapes = [each for each in SVG.parse(str(path)).elements() if isinstance(each, Shape)]
        curves = [Curve(part) for each in shapes for part in Curve(each).as_subpaths()]
    except (ValueError, SyntaxError, TypeError, AttributeError) as error:
        raise ScenarioError("path", str(path), f"an SVG file; {error}") from None
    lines = [_line(each) for each in curves if len(each) > 1]
    if not (lines := [each for each in lines if np.ptp(each, axis=0).any()]):
        raise ScenarioError("path", str(path), "an SVG file with paths or shapes")
    return lines


def _line(curve: object) -> FloatArray:
    """Return points along a drawn curve, y upwards, shape (M, 2)."""
    at = np.linspace(0.0, 1.0, _PER_CURVE + 1)
    points = np.array([(point.x, -point.y) for point in map(curve.point, at)])  # type: ignore[attr-defined]
    return _closed(points) if np.allclose(points[0], points[-1], atol=1e-9) else points


def _closed(points: FloatArray) -> FloatArray:
    """Return points of an outline without repeated ones, the last equal to the first."""
    points = np.asarray(points, dtype=np.float64)
    keep = [True, *(not np.array_equal(a, b) for a, b in pairwise(points))]
    points = points[np.array(keep)]
    if np.allclose(points[0], points[-1]):
        points = points[:-1]
    return np.concatenate([points, points[:1]])
