"""A key in a Meshcat scene, in its upper left as one first looks at it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from itertools import product

import numpy as np
from pydrake.geometry import Meshcat, Rgba

from drake_rho.display.scene import ROOT, Scene
from drake_rho.display.shapes import Mesh, words
from drake_rho.display.style import view

_LINE = 0.03
"""Height of a line, in diagonals of the scene."""
_LETTERS = 0.55
"""Height of letters, in lines."""


@dataclasses.dataclass(frozen=True, eq=False)
class Entry:
    """A line of the key."""

    name: str
    """part of its path in the scene tree"""
    text: str
    """what it says"""
    sign: Mesh
    """what it says that of, around or from the origin along x"""
    colour: Rgba
    """of the sign"""


def add_key(meshcat: Meshcat, scene: Scene, entries: Sequence[Entry], colour: Rgba) -> None:
    """Write the entries below each other, in letters of a colour, at /flight/key/<name>."""
    right, up, _ = view()
    corners = np.array(list(product(*np.array([scene.lower, scene.upper]).T)))
    centre, line = (scene.lower + scene.upper) / 2.0, _LINE * scene.size
    seen = (corners - centre) @ np.array([right, up]).T
    begin = centre + seen[:, 0].min() * right + seen[:, 1].max() * up
    turned = np.column_stack([right, np.cross([0.0, 0.0, 1.0], right), [0.0, 0.0, 1.0]])
    aside = 1.2 * max(float(entry.sign[0][0].max()) for entry in entries)
    for number, entry in enumerate(entries):
        origin, (vertices, faces) = begin - number * line * up, entry.sign
        sign = np.asfortranarray(turned @ vertices + origin[:, None])
        meshcat.SetTriangleMesh(f"{ROOT}/key/{entry.name}/sign", sign, faces, rgba=entry.colour)
        letters, triangles = words(entry.text, _LETTERS * line, np.zeros(3), right, up)
        origin = origin + (aside - (right @ letters).min()) * right - 0.2 * line * up
        letters = np.asfortranarray(letters + origin[:, None])
        meshcat.SetTriangleMesh(f"{ROOT}/key/{entry.name}/words", letters, triangles, rgba=colour)
