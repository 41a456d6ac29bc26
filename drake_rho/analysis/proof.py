"""What a certificate's file holds: the scenario, the branches and their multipliers, as numbers.

`check_certificate` reads it. Multipliers are those of a Lagrangian in SI units whose rows have
length one in accelerations times the roots of their vehicles' weights.
"""

from __future__ import annotations

import gzip
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from drake_rho.analysis.check_certificate import FORMAT, CheckedBound, digest_of, proved_by
from drake_rho.analysis.nodes import Node, Split
from drake_rho.analysis.proof_scenario import name_of, of_scenario
from drake_rho.analysis.terms import QUANTITIES
from drake_rho.scenario.fields import IntArray
from drake_rho.scenario.records import Scenario
from drake_rho.system.files import atomic_write

Proved = tuple[IntArray, dict[str, Any]]
"""Group of vehicles, and the tree of branches that bounds its cost."""


class Proof:
    """Tree of branches of a group of vehicles, which grows as nodes are split.

    Args:
        root: node of all motions.

    Attributes:
        content: the tree as a certificate's file has it.
    """

    def __init__(self, root: Node) -> None:
        self.content = of_node(root)
        self._of = WeakKeyDictionary({root: self.content})

    def split(self, node: Node, result: Split) -> None:
        """Replace a node by its parts."""
        content, where = self._of.pop(node), result.where
        content.clear()
        if where is None:  # the same motions with a better bound
            (better,) = result.parts
            content.update(of_node(better))
            self._of[better] = content
            return
        parts = [of_node(part) for part in result.parts]
        self._of.update(zip(result.parts, parts, strict=True))
        obstacle = name_of(where.obstacle, where.part)
        at = [where.vehicle, where.partner, obstacle, result.time]
        content.update(at=at, scales=result.scales.tolist(), parts=parts)
        regions = [part.branch[where] for part in result.parts]
        if where not in node.branch and not regions[0].is_beside_box:
            content["cones"] = [each.edges.tolist() for each in regions]


def of_node(node: Node) -> dict[str, Any]:
    """Return a node's terms and multipliers."""
    curved, rows, kept = node.curved, node.affine, node.affine.kept
    weights, multipliers = node.unit**2 * node.weights, node.unit * node.multipliers
    obstacles = [*map(name_of, curved.obstacles.tolist(), curved.sides.tolist())]
    of_curved = [
        *(np.array(obstacles, dtype=object), curved.vehicles, curved.partners, curved.times),
        *(curved.centers, curved.scales, curved.radii, weights),
    ]
    names = np.array(QUANTITIES)[rows.quantities]
    of_rows = [names, rows.vehicles, rows.partners, rows.times, rows.normals, rows.bounds]
    return {
        "curved": _table(each[weights > 0.0] for each in of_curved),
        "rows": _table(each[~kept & (multipliers > 0.0)] for each in [*of_rows, multipliers]),
        "sides": multipliers[kept].tolist(),
    }


def _table(columns: Any) -> list[list[Any]]:
    return [list(row) for row in zip(*(each.tolist() for each in columns), strict=True)]


def _obstacles(tree: dict[str, Any]) -> Iterator[str]:
    """Yield the names of the obstacles that a tree of branches rests on."""
    for part in tree.get("parts", ()):
        yield from _obstacles(part)
    yield from (str(ball[0]) for ball in tree.get("curved", ()))
    if "at" in tree:
        yield str(tree["at"][2])


def written(path: Path, scenario: Scenario, proofs: Sequence[Proved]) -> CheckedBound:
    """Write a certificate, once it has been checked, and return the bound that it proves.

    Raises:
        OSError: the file cannot be written.
        ValueError: the scenario has what certificate files do not hold.
    """
    groups = [{"vehicles": group.tolist(), "tree": tree} for group, tree in proofs]
    obstacles = {name for _, tree in proofs for name in _obstacles(tree)}
    text = json.dumps({"scenario": of_scenario(scenario, obstacles), "groups": groups})
    content = json.loads(text)  # as it will be read
    try:
        proved = proved_by(content)
    except ValueError as error:
        raise ValueError(f"certificate: its files do not hold what it rests on: {error}") from None
    stored = {"format": FORMAT, "digest": digest_of(content), "content": content}
    data = gzip.compress(json.dumps(stored).encode(), mtime=0)
    with atomic_write(path) as file:
        file.write(data)
    return proved
