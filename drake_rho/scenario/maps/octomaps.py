"""OctoMap files, .bt and .ot, as leaves of an octree, and their cells."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path

import numpy as np

from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.fields import LARGEST, BoolArray, FloatArray, IntArray
from drake_rho.scenario.libraries import library
from drake_rho.scenario.maps.source import checked_file, named, unreadable
from drake_rho.scenario.maps.stored import MOST
from drake_rho.system.files import read_bytes

ENDINGS = (".bt", ".ot")
"""Endings of OctoMap files."""

MEANINGS = ("free", "occupied")
"""Treatments of unobserved cells."""

_MOST_NODES = 4 * MOST
"""Largest number of nodes of a tree that is read."""

_DEPTH = 16
"""Number of levels of OctoMap's trees below the root."""

_LARGEST_GRID = 8 * MOST
"""Largest number of cells of a bounding box in which unknown cells are listed (240 MB)."""

_EXPECTED = "an OctoMap file (.bt or .ot) of an OcTree or a ColorOcTree"


@dataclasses.dataclass(frozen=True)
class Leaves:
    """Leaves of an octree: cubes of 1, 2, 4 or more cells a side, each occupied or free."""

    resolution: float
    """side of a cell [m]"""
    lower: IntArray
    """first cell of each leaf, shape (L, 3)"""
    sides: IntArray
    """number of cells along each side of a leaf, shape (L,)"""
    is_occupied: BoolArray
    """whether a leaf is occupied, shape (L,)"""

    @property
    def occupied(self) -> int:
        """Number of occupied cells."""
        return int((self.sides[self.is_occupied] ** 3).sum())

    @property
    def free(self) -> int:
        """Number of free cells."""
        return int((self.sides[~self.is_occupied] ** 3).sum())

    @property
    def unknown(self) -> int:
        """Number of cells in the bounding box of all leaves that no leaf contains."""
        first, last = self.box
        return int(np.prod(last - first)) - self.occupied - self.free

    @property
    def box(self) -> tuple[IntArray, IntArray]:
        """First cell, and cell past the last, of the bounding box of all leaves, (3,) each."""
        last: IntArray = (self.lower + self.sides[:, None]).max(axis=0)
        return self.lower.min(axis=0), last

    def cells(self, unknown: str) -> IntArray:
        """Return the occupied cells, with the unknown ones if they count as occupied, (M, 3).

        Raises:
            ScenarioError: they are too many.
        """
        count = self.occupied + (self.unknown if unknown == "occupied" else 0)
        if count > MOST:
            raise ScenarioError("", Description(f"{count} cells"), f"at most {MOST}")
        if unknown == "occupied":
            return self._not_free()
        found = []
        for side in np.unique(self.sides[self.is_occupied]):
            within = np.argwhere(np.ones((side,) * 3, dtype=bool))
            of_side = self.lower[self.is_occupied & (self.sides == side)]
            found.append((of_side[:, None] + within).reshape(-1, 3))
        return np.concatenate(found) if found else np.zeros((0, 3), dtype=np.int64)

    def _not_free(self) -> IntArray:
        """Return the cells in the bounding box outside all free leaves."""
        first, last = self.box
        if np.prod((last - first).astype(float)) > _LARGEST_GRID:
            given = Description(f"a bounding box of {np.prod(last - first)} cells")
            expected = f"one of at most {_LARGEST_GRID} where unknown cells are occupied"
            raise ScenarioError("", given, expected)
        grid = np.ones(last - first, dtype=bool)
        single = ~self.is_occupied & (self.sides == 1)
        grid[tuple((self.lower[single] - first).T)] = False
        large = ~self.is_occupied & (self.sides > 1)
        for (i, j, k), side in zip(self.lower[large] - first, self.sides[large], strict=True):
            grid[i : i + side, j : j + side, k : k + side] = False
        return np.argwhere(grid) + first


def read_leaves(path: str | Path) -> Leaves:
    """Return the leaves of an OctoMap file.

    Raises:
        ScenarioError: the file cannot be read, is damaged or has no nodes, or the extra `maps` is
            not installed.
    """
    path = checked_file(path, ENDINGS)
    content = read_bytes(path)
    try:
        header = _Header.of(content)
        header.check_body(content)
    except ValueError as error:
        raise unreadable(path, error, _EXPECTED) from None
    octomap = library("octomap")
    name = os.fsencode(path)
    try:
        if header.is_binary:
            tree = octomap.OcTree(header.resolution)
            complete = tree.readBinary(name)
        else:
            tree = getattr(octomap, header.kind).read(name)
            complete = tree.size() == header.nodes
    except Exception as error:  # the library's error, for files that pass the checks above
        raise unreadable(path, error, _EXPECTED) from None
    if not complete:
        raise unreadable(path, "the library reads fewer nodes than there are", _EXPECTED)
    found: FloatArray = np.fromiter(
        (
            (leaf.getX(), leaf.getY(), leaf.getZ(), leaf.getSize(), tree.isNodeOccupied(leaf))
            for leaf in tree.begin_leafs()
        ),
        dtype=np.dtype((np.float64, 5)),
    )
    h = header.resolution
    lower = np.rint((found[:, :3] - found[:, 3:4] / 2.0) / h).astype(np.int64)
    sides = np.rint(found[:, 3] / h).astype(np.int64)
    if len(found) == 0:
        raise ScenarioError(named(path), Description("a tree without nodes"), "at least one cell")
    return Leaves(h, lower, sides, found[:, 4] > 0.0)


@dataclasses.dataclass(frozen=True)
class _Header:
    """Header of an OctoMap file.

    The library prints to standard error if a file is damaged, so everything is checked first.
    """

    is_binary: bool
    """whether leaves are only occupied or free (.bt), without probabilities (.ot)"""
    kind: str
    """type of the tree"""
    nodes: int
    """number of nodes"""
    resolution: float
    """side of a cell [m]"""
    length: int
    """number of bytes before the nodes"""

    @staticmethod
    def of(content: bytes) -> _Header:
        """Return the header of a file.

        Raises:
            ValueError: it has none, or not that of an occupancy octree.
        """
        head, found, _ = content[:4096].partition(b"\ndata\n")
        lines = head.decode("ascii", errors="replace").splitlines()
        first = lines[0].strip() if lines else ""
        if not found or first not in ("# Octomap OcTree binary file", "# Octomap OcTree file"):
            raise ValueError("it has no header of OctoMap")
        words = [line.split() for line in lines if not line.startswith("#")]
        fields = {each[0]: each[1] for each in words if len(each) == 2}
        if len(fields) < len(words) or fields.keys() - {"id", "size", "res"}:
            raise ValueError("its header has further lines")
        kind, nodes, side = (fields.get(key, "") for key in ("id", "size", "res"))
        if kind not in ("OcTree", "ColorOcTree"):
            raise ValueError(f"it holds a tree of type {kind[:40] or 'unknown'}")
        resolution = float(side)
        if not 1.0 / LARGEST <= resolution <= LARGEST:
            raise ValueError(f"its resolution is {resolution:g} m")
        if not nodes.isdecimal() or int(nodes) > _MOST_NODES:
            raise ValueError(f"its number of nodes is {nodes[:40] or 'missing'}")
        length = len(head) + len(b"\ndata\n")
        return _Header("binary" in first, kind, int(nodes), resolution, length)

    def check_body(self, content: bytes) -> None:
        """Check that all nodes are there.

        Nodes follow each other depth first, a record each. A binary file has records of inner
        nodes only, with two bits for each child: 0 if there is none, 3 for an inner node.

        Raises:
            ValueError: the file ends earlier, or has more nodes.
        """
        size = 2 if self.is_binary else 5 if self.kind == "OcTree" else 8
        most = min((len(content) - self.length) // size, max(self.nodes, 1))
        body = np.frombuffer(content, np.uint8, most * size, self.length).reshape(-1, size)
        pairs = np.arange(256)[:, None] >> np.arange(0, 8, 2) & 3
        if self.is_binary:
            children = (pairs != 0).sum(axis=1)[body].sum(axis=1)
            records = (pairs == 3).sum(axis=1)[body].sum(axis=1)
        else:
            children = records = np.bitwise_count(body[:, -1]).astype(np.int64)
        if self.nodes == 0:
            return
        read = _records_of_tree(records.tolist(), _DEPTH + (not self.is_binary))
        if read is None:
            raise ValueError(f"it ends too early: its header says {self.nodes} nodes")
        found = 1 + int(children[:read].sum())
        if found != self.nodes:
            raise ValueError(f"it has {found} nodes, its header says {self.nodes}")


def _records_of_tree(children: list[int], deepest: int) -> int | None:
    """Return the number of records that a tree has, depth first; None if there are too few.

    Args:
        children: number of records that are children of each record.
        deepest: largest number of levels. The library would recurse into any number.

    Raises:
        ValueError: the tree has more levels.
    """
    remaining = [1]  # records still to come on each level
    for number, count in enumerate(children):
        if len(remaining) > deepest:
            raise ValueError(f"its tree has more than {_DEPTH} levels")
        remaining[-1] -= 1
        remaining.append(count)
        while remaining and remaining[-1] == 0:
            remaining.pop()
        if not remaining:
            return number + 1
    return None
