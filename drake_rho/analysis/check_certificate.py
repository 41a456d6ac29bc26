"""`check_certificate`: an independent check of the bound that a certificate's file proves.

It needs numpy only and shares no code with the search that found the bound. So this file may be
copied, read, and run by itself: `python check_certificate.py FILE`. Nothing in a certificate's file
is trusted but the scenario, which is for the reader to compare with the one that is meant:

- Cones of directions from the middle of an obstacle or of another vehicle are checked to cover all
  of them. What is beside the sides, edges and corners of a box, and the halves of a cone, are
  generated here. Each branch has a bound of its own in the file's tree, so that the branches cover
  all motions.
- Every term is recomputed from the scenario. A ball counts with the largest radius with which it
  is known to be inside the space to avoid, and a row with the least value that limits, waypoints
  and requirements imply.
- Multipliers may be any that are not negative. The bound of a branch is the least value of its
  Lagrangian L, a quadratic, for any v as good as found here: with the least eigenvalue m of half
  its Hessian and its gradient g at v, L is at least L(v) - norm(g)² / (4 m) everywhere.

The sets of a cover meet up to rounding, 1e-15 of their size.
"""

from __future__ import annotations

import gzip
import hashlib
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from itertools import combinations, product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

FORMAT = "drake_rho certificate 2"
"""Format of the files."""

_Array = npt.NDArray[np.float64]
_Side = tuple[str, float, int, int, _Array, float]
"""Half-space of a branch: quantity, time, vehicles, normal and bound."""


class _Region(NamedTuple):
    """Cone of directions from the middle of a set, or from the nearest point of a box."""

    edges: _Array
    """directions of its edges in units of scales, shape (3, 3); beside a box (1 to 3, 3)"""
    scales: _Array
    """the scales [m], shape (3,)"""
    signs: _Array | None = None
    """beside a box 1 beyond an axis's upper side, -1 beyond its lower one, 0 between, shape (3,)"""


_Branch = dict[tuple[Any, ...], _Region]
"""Regions of a branch."""

_MOST_VERTICES, _PLANAR = 64, 1e-6
"""Most vertices of a polytope, and part of its size by which vertices may be beyond a facet."""

_FAR, _HALVINGS, _NEWTON_STEPS = 1e4, 60, 50
"""Longest ray, in scales; halvings of a ray; and steps to the nearest point of an ellipsoid."""

_TIMES, _ROUNDED, _CONVEX, _CLOSE, _FLAT = 1e-9, 1e-12, 1e-7, 1e-6, 1e-6
"""Largest difference of equal times [s]; part of the
sizes of a Lagrangian's terms that rounding may take; least curvature of one that is convex;
largest part by which the bound of a row is lowered to what the limits imply; and least volume of
the edges of a cone, as a part of their lengths."""

_TURNED = 1e-9
"""Largest error of the products of a rotation's rows."""


class CheckedBound(NamedTuple):
    """Lower bound that a certificate's file proves, computed anew; prints as one line."""

    scenario: str
    """name of the scenario in the file"""
    lower_bound: float
    """lower bound on the cost of every plan of that scenario [m²/s⁴]"""
    groups: tuple[float, ...]
    """parts of it, one of each group of vehicles [m²/s⁴]"""
    branches: int
    """number of branches that cover all motions"""

    def __str__(self) -> str:
        many = "one branch" if self.branches == 1 else f"{self.branches} branches"
        return f"{self.scenario}: no plan costs less than {self.lower_bound:.6f} m²/s⁴ ({many})"


def check_certificate(path: str | Path) -> CheckedBound:
    """Check the certificate in a file, and return the bound that it proves.

    Args:
        path: file that `Certificate.save` wrote.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is no certificate, was damaged, or does not prove a bound; the message names
            the place.
    """
    if not isinstance(path, (str, Path)):
        raise TypeError(f"path: got an object of type {type(path).__name__}, expected str or Path")
    try:
        with gzip.open(path, "rt", encoding="utf-8") as file:
            stored = json.load(file)
        if stored["format"] != FORMAT:
            raise ValueError(f"got the format {stored['format']!r}, expected {FORMAT!r}")
        if stored["digest"] != digest_of(stored["content"]):
            raise ValueError("its content does not match its digest")
        return proved_by(stored["content"])
    except (gzip.BadGzipFile, EOFError, KeyError, TypeError, IndexError, RecursionError) as error:
        raise ValueError(f"{path}: no certificate, or a damaged one ({error!r})") from None
    except (ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
        raise ValueError(f"{path}: {error}") from None


def digest_of(content: Mapping[str, Any]) -> str:
    """Return the digest of a certificate's content, which tells accidental changes."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def proved_by(content: Mapping[str, Any]) -> CheckedBound:
    """Return the bound that a certificate's content proves.

    Raises:
        ValueError: it proves none.
    """
    scenario, groups = content["scenario"], content["groups"]
    members = sorted(i for each in groups for i in each["vehicles"])
    if members != list(range(len(scenario["vehicles"]))):
        raise ValueError("groups: expected every vehicle in exactly one")
    bounds, branches = list[float](), 0
    for number, each in enumerate(groups):
        group = _Group(scenario, each["vehicles"], f"groups[{number}]")
        bounds.append(group.bound(each["tree"], {}, []))
        branches += group.branches
    return CheckedBound(scenario["name"], float(sum(bounds)), tuple(bounds), branches)


class _Group:
    """Vehicles that are bounded together.

    Accelerations a are u = sqrt(weight) a, so the cost is norm(u)². With u = u_0 + F v, where u_0
    is the least that reaches what is given and F an orthonormal basis of what changes nothing of
    it, the cost is norm(u_0)² + norm(v)².
    """

    def __init__(self, scenario: Mapping[str, Any], group: Sequence[int], where: str) -> None:
        self.scenario, self.group, self.where, self.branches = scenario, group, where, 0
        self.step, self.steps = float(scenario["step"]), int(scenario["steps"])
        self.vehicles = [scenario["vehicles"][i] for i in group]
        if not (self.step > 0.0 and self.steps > 0):
            raise ValueError("scenario: expected steps of more than 0 s")
        self._tick = max(_TIMES, float(scenario["tick"]))
        self._bases, self._least = list[_Array](), list[_Array]()
        self._sets = dict[tuple[int | str, float], _Forbidden]()  # by obstacle and radius
        for each in self.vehicles:
            if not (each["weight"] > 0.0 and each["radius"] >= 0.0):
                raise ValueError("scenario: expected weights above 0 and no negative radius")
            rows = np.zeros((0, self.steps))
            values = np.zeros((0, 3))
            for quantity, time, value in each["given"]:
                row = self._response(quantity, time) / np.sqrt(each["weight"])
                rows = np.vstack([rows, row])
                values = np.vstack([values, _vector(value) - self._free(each, quantity, time)])
            left, sizes, right = np.linalg.svd(rows)
            rank = int(np.sum(sizes > 1e-10 * sizes.max(initial=0.0)))
            inverse = right[:rank].T @ (left[:, :rank].T / sizes[:rank, None])
            self._least.append(inverse @ values)
            self._bases.append(right[rank:].T)
        self._first = np.cumsum([0, *(each.shape[1] for each in self._bases)])
        self._effort = float(sum(np.sum(each**2) for each in self._least))

    def _response(self, quantity: str, time: float) -> _Array:
        """Return the response of a quantity at a time to accelerations, shape (K-1,)."""
        h = self.step
        if not -_TIMES <= time <= self.steps * h + _TIMES:
            raise ValueError(f"{self.where}: got a time of {time} s, which is not in the flight")
        since = np.maximum(time - h * np.arange(self.steps), 0.0)
        step = int(np.floor(time / h + _TIMES))
        if quantity == "position":
            return np.asarray(np.where(since >= h, h * (since - h / 2.0), since**2 / 2.0))
        if quantity == "velocity":
            return np.asarray(np.minimum(since, h))
        if quantity == "acceleration":
            return np.asarray(np.eye(self.steps)[min(step, self.steps - 1)])
        if quantity == "jerk":
            changes = np.diff(np.eye(self.steps), axis=0, prepend=0.0, append=0.0) / h
            return np.asarray(changes[min(step, self.steps)])
        raise ValueError(f"{self.where}: got {quantity}, which certificate files do not hold")

    def _free(self, vehicle: Mapping[str, Any], quantity: str, time: float) -> _Array:
        """Return a vehicle's quantity at a time without accelerations."""
        position, velocity = _vector(vehicle["start"][0]), _vector(vehicle["start"][1])
        if quantity == "jerk":
            step, (before, after) = int(np.floor(time / self.step + _TIMES)), vehicle["outside"]
            if (outside := before if step == 0 else after) is None and step in (0, self.steps):
                raise ValueError(f"{self.where}: the jerk at {time} s is not known")
            sign = {0: -1.0, self.steps: 1.0}.get(step, 0.0) / self.step
            return sign * _vector(outside) if sign != 0.0 else np.zeros(3)
        return {"position": position + time * velocity, "velocity": velocity}.get(
            quantity, np.zeros(3)
        )

    def _of(self, quantity: str, time: float, one: int, other: int) -> tuple[_Array, _Array, float]:
        """Return a quantity, or the difference of two vehicles' positions, as r · v + offset.

        Returns:
            r, shape (M,), the offset, and the length of r before the given values are left out.
        """
        if not (0 <= one < len(self.vehicles) and 0 <= other < len(self.vehicles)):
            raise ValueError(f"{self.where}: got vehicles {one} and {other}")
        whole, offset, square = np.zeros(self._first[-1]), np.zeros(3), 0.0
        for i, sign in [(one, 1.0)] if one == other else [(one, 1.0), (other, -1.0)]:
            vehicle, basis = self.vehicles[i], self._bases[i]
            row = self._response(quantity, time) / np.sqrt(vehicle["weight"])
            whole[self._first[i] : self._first[i + 1]] = sign * row @ basis
            offset = offset + sign * (self._free(vehicle, quantity, time) + row @ self._least[i])
            square += float(row @ row)
        return whole, offset, float(np.sqrt(square))

    def bound(self, tree: Mapping[str, Any], regions: _Branch, sides: list[_Side]) -> float:
        """Return the lower bound of a tree of branches.

        Args:
            tree: a branch with multipliers, or where it is split and the parts.
            regions: regions of the branch so far.
            sides: half-spaces of the branch so far.
        """
        if "parts" not in tree:
            self.branches += 1
            return self._leaf(tree, sides)
        one, other, number, time = tree["at"]
        key, forbidden = (one, other, number, time), self._forbidden(one, other, number, time)
        if key in regions:
            parts = _halves(regions[key])
        elif "cones" in tree:
            parts = _cover(tree["cones"], _vector(tree["scales"]))
        else:
            parts = forbidden.beside_box()
        if len(parts) != len(tree["parts"]):
            raise ValueError(f"{self.where}: got {len(tree['parts'])} parts of {len(parts)}")
        least = np.inf
        for region, each in zip(parts, tree["parts"], strict=True):
            normals, bounds = _half_spaces(region, forbidden)
            bounds = bounds + normals @ self._center(number, time)
            rows = [("position", time, one, other, *of) for of in zip(normals, bounds, strict=True)]
            least = min(least, self.bound(each, {**regions, key: region}, [*sides, *rows]))
        return least

    def _leaf(self, tree: Mapping[str, Any], sides: Sequence[_Side]) -> float:
        """Return the least value of a branch's Lagrangian, less a bound on rounding errors."""
        curved = [self._ball(each) for each in tree["curved"]]
        rows = [self._row(each) for each in tree["rows"]]
        if len(tree["sides"]) != len(sides):
            raise ValueError(f"{self.where}: got {len(tree['sides'])} multipliers of sides")
        rows += [
            self._scaled(side, _multiplier(y)) for side, y in zip(sides, tree["sides"], strict=True)
        ]
        width = int(self._first[-1])
        r = np.array([each[0] for each in curved]).reshape(-1, width)
        o = np.array([each[1] for each in curved]).reshape(-1, 3)
        s = np.array([each[2] for each in curved]).reshape(-1, 3)
        radii, weights = np.array([each[3:] for each in curved]).reshape(-1, 2).T
        a = np.array([each[0] for each in rows]).reshape(-1, width, 3)
        b, y = np.array([each[1:] for each in rows]).reshape(-1, 2).T
        half = weights / radii / 2.0
        v, m = np.zeros((width, 3)), 1.0
        pull = np.einsum("rma,r->ma", a, y) + r.T @ (2.0 * half[:, None] * s**2 * o)
        for axis in range(3):
            hessian = np.eye(width) - (r.T * (half * s[:, axis] ** 2)) @ r
            if width > 0:
                m = min(m, float(np.linalg.eigvalsh(hessian)[0]))
            if m < _CONVEX:
                return -np.inf
            v[:, axis] = np.linalg.solve(hessian, pull[:, axis] / 2.0)
        at = s * (r @ v + o)
        gradient = 2.0 * v - pull - r.T @ (2.0 * half[:, None] * s**2 * (r @ v))
        effort, squares = self._effort + float(np.sum(v**2)), np.sum(at**2, axis=1)
        reached = np.einsum("rma,ma->r", a, v)
        value = effort + half @ (radii**2 - squares) + y @ (b - reached)
        sizes = effort + half @ (radii**2 + squares) + y @ (np.abs(b) + np.abs(reached))
        value -= float(np.sum(gradient**2)) / (4.0 * m) + _ROUNDED * sizes / m
        return float(value) if np.isfinite(value) else -np.inf

    def _ball(self, stored: Sequence[Any]) -> tuple[_Array, _Array, _Array, float, float]:
        """Return a ball or ellipsoid to keep out of: r, offset, scales, radius and multiplier."""
        number, one, other, time, c, s, size, w = stored
        forbidden, scales = self._forbidden(one, other, number, time), _vector(s)
        center = _vector(c) - self._center(number, time)
        if not np.all(scales > 0.0):
            raise ValueError(f"{self.where}: got scales {scales}, expected more than 0")
        inside = forbidden.ball(center, scales)
        if not (inside > 0.0 and size > 0.0):
            raise ValueError(f"{self.where}: a ball at {time} s is not inside what it is to avoid")
        row, offset, _ = self._of("position", time, one, other)
        return row, offset - _vector(c), scales, min(size, inside), _multiplier(w)

    def _row(self, stored: Sequence[Any]) -> tuple[_Array, float, float]:
        """Return a row that limits imply: its matrix, bound and multiplier."""
        quantity, one, other, time, n, b, y = stored
        normal = _vector(n)
        least = self._implied(quantity, one, other, time, normal)
        if b > least + _CLOSE * (1.0 + abs(b)):
            raise ValueError(f"{self.where}: nothing implies a row of {quantity} at {time} s")
        return self._scaled((quantity, time, one, other, normal, min(b, least)), _multiplier(y))

    def _scaled(self, side: _Side, y: float) -> tuple[_Array, float, float]:
        """Return a half-space as a row of length one: its matrix, bound and multiplier."""
        quantity, time, one, other, n, b = side
        row, offset, length = self._of(quantity, time, one, other)
        length = length * float(np.linalg.norm(n)) or 1.0
        return row[:, None] * n / length, (b - float(n @ offset)) / length, y

    def _implied(self, quantity: str, one: int, other: int, time: float, n: _Array) -> float:
        """Return the largest b for which the sets of a quantity imply n · quantity >= b."""
        known = [-np.inf]
        first, second = self.group[one], self.group[other]
        for each in self.scenario["kept"]:
            partner = first if each["partner"] is None else each["partner"]
            of = each["quantity"] == quantity and first in each["vehicles"] and second == partner
            if of and self._is_required(each, one, other, time):
                margin = float(each["margin"]) * float(np.linalg.norm(n))
                known.append(float(n @ _place(each, time)) + _least_along(each["set"], n) + margin)
        return max(known)

    def _is_required(self, kept: Mapping[str, Any], one: int, other: int, time: float) -> bool:
        """Return whether a quantity is to be in a set at a time.

        Accelerations and jerks have one value in a step. States that are given do not count: they
        may be outside, and no plan would change that.
        """
        first, last = kept["active"] or (-np.inf, np.inf)
        if kept["quantity"] in ("acceleration", "jerk"):
            begin = self.step * np.floor(time / self.step + _TIMES)
            return bool(begin <= last + self._tick and begin + self.step > first + self._tick)
        both = (self.vehicles[i]["given"] for i in (one, other))
        given = all(any(kept["quantity"] == kind for kind, *_ in each) for each in both)
        ends = [0.0, self.steps * self.step] if given else [0.0]
        at_end = any(abs(time - end) <= _TIMES for end in ends)
        counts = first == last or self._counts(time)
        return counts and not at_end and first - self._tick <= time <= last + self._tick

    def _counts(self, time: float) -> bool:
        """Return whether positions are constrained at a time: at knots, or at every instant."""
        knot = time / self.step
        return bool(self.scenario["between_knots"]) or abs(knot - round(knot)) <= _TIMES

    def _center(self, number: int | str, time: float) -> _Array:
        """Return the centre of an obstacle at a time; zero for another vehicle."""
        if number == 0:
            return np.zeros(3)
        return _place(self.scenario["obstacles"][str(number)], time)

    def _forbidden(self, one: int, other: int, number: int | str, time: float) -> _Forbidden:
        """Return the space that a position is to be outside of, relative to its centre."""
        if not self._counts(time):
            raise ValueError(f"{self.where}: positions are not constrained at {time} s")
        if number == 0:
            if one == other or self.scenario["separation"] is None:
                raise ValueError(f"{self.where}: got a separation of one vehicle, or none is asked")
            shape = {"kind": "Ellipsoid", "semi_axes": self.scenario["separation"]}
            return self._sets.setdefault((0, 0.0), _Forbidden(shape, 0.0))
        if one != other or not 0 <= one < len(self.vehicles):
            raise ValueError(f"{self.where}: got an obstacle of vehicles {one} and {other}")
        obstacle, radius = self.scenario["obstacles"][str(number)], self.vehicles[one]["radius"]
        first, last = obstacle["active"] or (-np.inf, np.inf)
        if not first - self._tick <= time <= last + self._tick:
            raise ValueError(f"{self.where}: obstacle {number} is not avoided at {time} s")
        rate, since = (float(each) for each in obstacle["growth"])
        radius += float(obstacle["margin"]) + rate * max(time - since, 0.0)
        made = _Forbidden(obstacle["shape"], radius)
        return self._sets.setdefault((number, radius), made)


class _Forbidden:
    """Convex set around zero, enlarged by a radius."""

    def __init__(self, shape: Mapping[str, Any], radius: float) -> None:
        self._kind, self._shape, self._radius = shape["kind"], shape, float(radius)
        known: dict[str, Callable[[_Array], float]] = {
            "Sphere": lambda x: float(shape["radius"]) - float(np.linalg.norm(x)),
            "Box": lambda x: -_beyond(np.abs(x) - _vector(shape["half"])),
            "Cylinder": self._in_cylinder,
            "Ellipsoid": self._in_ellipsoid,
            "Polytope": self._in_polytope,
            "Capsule": lambda x: float(shape["radius"]) - self._from_segments(x),
            "Triangle": self._in_triangle,
            "Posed": lambda x: self._inner.depth((x + self._shift) @ self._turn),
        }
        if self._kind not in known:
            raise ValueError(f"scenario: got a {self._kind}, which certificate files do not hold")
        self.depth = known[self._kind]
        self._rays = dict[bytes, float]()

    @cached_property
    def _inner(self) -> _Forbidden:
        """Set that is posed."""
        return _Forbidden(self._shape["shape"], self._radius)

    @cached_property
    def _turn(self) -> _Array:
        """Rotation of a set that is posed."""
        return _rotation(self._shape["rotation"])

    @cached_property
    def _shift(self) -> _Array:
        """Place of the middle of a posed set from where the middle of the set itself is turned."""
        return _vector(self._shape["shift"])

    def _in_cylinder(self, x: _Array) -> float:
        axis = int(self._shape["axis"])
        across = float(np.linalg.norm(np.delete(x, axis))) - float(self._shape["radius"])
        half = self._shape["half_height"]
        return -_beyond(np.array([across, -np.inf if half is None else abs(x[axis]) - half]))

    def _in_ellipsoid(self, x: _Array) -> float:
        """Return a depth; outside, less the distance from the nearest point.

        It is axes² x / (axes² + t) for the root t of a function that is convex and falls, so that
        Newton steps from zero approach it from one side.
        """
        axes, t = _vector(self._shape["semi_axes"]), 0.0
        if (size := float(np.linalg.norm(x / axes))) <= 1.0:
            return (1.0 - size) * float(axes.min())
        for _ in range(_NEWTON_STEPS):
            squares = (axes * x / (axes**2 + t)) ** 2
            step = float((squares.sum() - 1.0) / (2.0 * squares @ (1.0 / (axes**2 + t))))
            t += step
            if step <= _ROUNDED * t:
                break
        nearest = axes**2 * x / (axes**2 + t)
        return -float(np.linalg.norm(x - nearest / max(float(np.linalg.norm(nearest / axes)), 1.0)))

    @cached_property
    def _facets(self) -> tuple[_Array, _Array]:
        """Planes n · x <= b through three vertices that have hardly any vertex beyond."""
        vertices = np.array([_vector(each) for each in self._shape["vertices"]])
        if not 4 <= len(vertices) <= _MOST_VERTICES:
            raise ValueError(f"scenario: got {len(vertices)} vertices, expected at most 64")
        scale = float(np.abs(vertices).max())
        one, two, three = vertices[np.array(list(combinations(range(len(vertices)), 3))).T]
        normals = np.cross(two - one, three - one)
        sizes = np.linalg.norm(normals, axis=1)
        flat = sizes > _ROUNDED * scale**2
        normals, one = normals[flat] / sizes[flat, None], one[flat]
        normals, offsets = np.vstack([normals, -normals]), np.vecdot(normals, one)
        offsets = np.concatenate([offsets, -offsets])
        outer = (normals @ vertices.T).max(axis=1) <= offsets + _PLANAR * scale
        return normals[outer], offsets[outer]

    def _in_polytope(self, x: _Array) -> float:
        """Return a depth; outside, less the distance from the nearest facet or segment."""
        normals, offsets = self._facets
        over = normals @ x - offsets
        if np.max(over) <= 0.0:
            return -float(np.max(over))
        ahead = over > 0.0
        nearest = x - over[ahead, None] * normals[ahead]  # on the planes of these facets
        inside = np.all(nearest @ normals.T <= offsets + _ROUNDED, axis=1)
        return -min(float(over[ahead][inside].min(initial=np.inf)), self._from_segments(x))

    @cached_property
    def _segments(self) -> tuple[_Array, _Array]:
        """First points and directions of the segments between all vertices, which are inside."""
        vertices = np.array([_vector(each) for each in self._shape["vertices"]])
        one, two = vertices[np.array(list(combinations(range(len(vertices)), 2))).T]
        return one, two - one

    def _from_segments(self, x: _Array) -> float:
        """Return the distance from the nearest of the segments between vertices."""
        first, along = self._segments
        squares = np.maximum(np.vecdot(along, along), np.finfo(float).tiny)
        parts = np.clip(np.vecdot(x - first, along) / squares, 0.0, 1.0)
        return float(np.linalg.norm(x - first - parts[:, None] * along, axis=1).min())

    def _in_triangle(self, x: _Array) -> float:
        """Return less the distance from the foot on the plane, or from the nearest side."""
        one, two, three = (_vector(each) for each in self._shape["vertices"])
        normal = np.cross(two - one, three - one)
        sides = ((one, two), (two, three), (three, one))
        ahead = [float(np.cross(b - a, x - a) @ normal) for a, b in sides]
        if min(ahead) <= 0.0:
            return -self._from_segments(x)
        return -abs(float((x - one) @ normal)) / float(np.linalg.norm(normal))

    def beside_box(self) -> list[_Region]:
        """Return regions beside the sides, edges and corners of a box, which cover its outside."""
        if self._kind == "Posed":
            return self._inner.beside_box()
        if self._kind != "Box" or not np.all(np.isfinite(_vector(self._shape["half"]))):
            raise ValueError("got a branch without cones, expected them for all but bounded boxes")
        every = [np.array(each, dtype=float) for each in product((-1, 0, 1), repeat=3)]
        return [_Region(np.diag(s)[s != 0.0], np.ones(3), s) for s in every if np.any(s)]

    def beside(self, region: _Region) -> tuple[_Array, _Array]:
        """Return half-spaces n · p >= b that contain the outside of a box in a region beside it.

        From the nearest point of the box, p is the sum of λ_i times unit vectors along its axes,
        λ >= 0, so that the sum of λ is at least its length, which is at least the radius.
        """
        if self._kind == "Posed":
            normals, bounds = self._inner.beside(region)
            turned = normals @ self._turn.T
            return turned, bounds - turned @ self._shift
        half, signs = _vector(self._shape["half"]), np.asarray(region.signs)
        beyond = signs != 0.0
        parts = np.zeros((len(region.edges), 3))
        parts[:, beyond] = np.linalg.inv(region.edges[:, beyond]).T
        normals = np.vstack([*(parts if len(parts) > 1 else ()), parts.sum(axis=0)])
        bounds = normals @ (signs * half) + [*np.zeros(len(normals) - 1), self._radius]
        lengths, between = np.linalg.norm(normals, axis=1), np.eye(3)[~beyond]
        slabs = -np.tile(half[~beyond], 2)
        every = np.vstack([between, -between, normals / lengths[:, None]])
        return every, np.concatenate([slabs, bounds / lengths])

    def contains(self, x: _Array) -> bool:
        """Return whether a point is in the enlarged set."""
        return self.depth(x) + self._radius >= 0.0

    def ray(self, direction: _Array, longest: float) -> float:
        """Return a length of a ray from zero that is inside, close to where it leaves the set."""
        if (content := direction.tobytes()) not in self._rays:
            low, high = 0.0, longest
            for _ in range(_HALVINGS):
                half = (low + high) / 2.0
                low, high = (half, high) if self.contains(half * direction) else (low, half)
            self._rays[content] = low
        return self._rays[content]

    def ball(self, center: _Array, scales: _Array) -> float:
        """Return a radius with which a ball, of scaled axes, is in the enlarged set."""
        if self._kind == "Ellipsoid" and not np.any(center):
            axes = _vector(self._shape["semi_axes"]) + self._radius
            return float(np.min(scales * axes))
        return (self.depth(center) + self._radius) * float(scales.min())


def _place(moved: Mapping[str, Any], time: float) -> _Array:
    """Return the centre of an obstacle, or of a set of a quantity, at a time."""
    times = np.array(moved["times"], dtype=float)
    places = np.array([_vector(each) for each in moved["positions"]])
    if len(times) != len(places) or not np.all(np.diff(times) > 0.0):
        raise ValueError("scenario: got times of a track that do not increase, or without places")
    if time > times[-1] and moved["goes_on"] and len(times) > 1:
        speed = (places[-1] - places[-2]) / (times[-1] - times[-2])
        return np.asarray(places[-1] + (time - times[-1]) * speed)
    return np.array([np.interp(time, times, each) for each in places.T])


def _least_along(shape: Mapping[str, Any], n: _Array) -> float:
    """Return the least n · x in a convex set around its centre; minus infinity for none."""
    length = float(np.linalg.norm(n))
    match shape["kind"]:
        case "Sphere":
            return -float(shape["radius"]) * length
        case "Ellipsoid":
            return -float(np.linalg.norm(n * _vector(shape["semi_axes"])))
        case "Bounds":
            low, high = _vector(shape["lower"]), _vector(shape["upper"])
            with np.errstate(invalid="ignore"):
                return float(np.sum(np.where(n > 0.0, n * low, np.where(n < 0.0, n * high, 0.0))))
        case "Box":
            return -float(np.abs(n) @ _vector(shape["half"]))
        case "Polytope" | "Capsule" as kind:
            least = min(float(_vector(each) @ n) for each in shape["vertices"])
            return least - (float(shape["radius"]) * length if kind == "Capsule" else 0.0)
        case "Cylinder":
            across = float(np.linalg.norm(np.delete(n, int(shape["axis"]))))
            along, half = abs(float(n[int(shape["axis"])])), shape["half_height"]
            ends = 0.0 if along == 0.0 else along * (np.inf if half is None else float(half))
            return -float(shape["radius"]) * across - ends
        case "HalfSpace":
            up, across = _parts_along(n, _vector(shape["normal"]))
            least = up * float(shape["offset"]) / float(np.linalg.norm(_vector(shape["normal"])))
            return least if up < 0.0 and across <= _ROUNDED * length else -np.inf
        case "Cone":
            up, across = _parts_along(n, _vector(shape["axis"]))
            least = float(np.cos(shape["half_angle"]) * up - np.sin(shape["half_angle"]) * across)
            return 0.0 if least >= -_ROUNDED * length else -np.inf
        case "Posed":
            inner = _least_along(shape["shape"], n @ _rotation(shape["rotation"]))
            return inner - float(n @ _vector(shape["shift"]))
        case other:
            raise ValueError(f"scenario: got a {other}, which certificate files do not hold")


def _parts_along(n: _Array, axis: _Array) -> tuple[float, float]:
    """Return the component of a vector along an axis, and the length of the rest."""
    unit = axis / np.linalg.norm(axis)
    up = float(n @ unit)
    return up, float(np.linalg.norm(n - up * unit))


def _rotation(rows: Sequence[Any]) -> _Array:
    found = np.array([_vector(each) for each in rows])
    if found.shape != (3, 3) or not np.allclose(found @ found.T, np.eye(3), atol=_TURNED):
        raise ValueError(f"scenario: got {rows!r}, expected a rotation")
    return found


def _beyond(over: _Array) -> float:
    """Return the distance from a set with these distances beyond its sides; negative inside."""
    outside = np.maximum(over, 0.0)
    return float(np.linalg.norm(outside)) + min(float(np.max(over)), 0.0)


def _cover(stored: Sequence[Any], scales: _Array) -> list[_Region]:
    """Return cones from the middle of a set that cover all directions.

    They do if each side of one is also a side of another, in the opposite order, and all are
    right-handed: then as many cones contain one direction as any other.
    """
    cones = [np.array([_vector(edge) for edge in each]) for each in stored]
    edges = [tuple(tuple(edge) for edge in each.tolist()) for each in cones]
    sides = [(each[i], each[i - 2]) for each in edges for i in range(len(each))]
    shared = len(set(sides)) == len(sides) and {side[::-1] for side in sides} == set(sides)
    if not cones or not shared or not all(each.shape == (3, 3) for each in cones):
        raise ValueError("got cones that do not meet, expected some that cover all directions")
    sizes = [np.linalg.norm(each, axis=1).prod() for each in cones]
    if not all(np.linalg.det(c) > _FLAT * size for c, size in zip(cones, sizes, strict=True)):
        raise ValueError("got a cone whose edges are not right-handed")
    return [_Region(each, scales) for each in cones]


def _halves(region: _Region) -> list[_Region]:
    """Return the halves of a region, across its widest side."""
    edges, count = region.edges, len(region.edges)
    first = int(np.argmin(np.vecdot(edges, np.roll(edges, -1, axis=0))))
    middle = edges[first] + edges[(first + 1) % count]
    one, other = edges.copy(), edges.copy()
    one[first] = other[(first + 1) % count] = middle / np.linalg.norm(middle)
    return [region._replace(edges=one), region._replace(edges=other)]


def _half_spaces(region: _Region, forbidden: _Forbidden) -> tuple[_Array, _Array]:
    """Return half-spaces n · p >= b that contain the rest of a region outside of a set.

    A convex function that is at most 1 at three points of a cone's edges is at most the sum of the
    coordinates at every point of the cone, which is at least 1 outside of the set.
    """
    if region.signs is not None:
        return forbidden.beside(region)
    cone = region.edges * region.scales
    edges = cone / np.linalg.norm(cone, axis=1, keepdims=True)
    if not forbidden.contains(np.zeros(3)):
        raise ValueError("a cone begins outside of what is to be avoided")
    far = _FAR * float(np.abs(cone).max())
    low = np.array([forbidden.ray(edge, far) for edge in edges])
    across = np.cross(edges[[1, 2, 0]], edges[[2, 0, 1]]) * np.sign(np.linalg.det(edges))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    beyond = np.linalg.solve(edges, 1.0 / low)
    length = float(np.linalg.norm(beyond))
    return np.vstack([across, beyond / length]), np.array([0.0, 0.0, 0.0, 1.0 / length])


def _vector(values: Any) -> _Array:
    found = np.array(values, dtype=float)
    if found.shape != (3,) or np.any(np.isnan(found)):
        raise ValueError(f"got {values!r}, expected three numbers")
    return found


def _multiplier(value: Any) -> float:
    if not (isinstance(value, (int, float)) and 0.0 <= value < np.inf):
        raise ValueError(f"got a multiplier of {value!r}, expected a number from 0")
    return float(value)


if __name__ == "__main__":
    sys.stdout.write(f"{check_certificate(sys.argv[1])}\n")
