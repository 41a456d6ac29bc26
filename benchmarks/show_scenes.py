"""Random shows: some fifty to three hundred vehicles through random formations."""

from __future__ import annotations

from typing import Any

import numpy as np

import drake_rho as rho
from drake_rho.shows.formations import AnyFormation

APART = rho.Separation(1.0, downwash=2.0)
SPACING = 2.6
"""Distance of points in formations [m]: the separation holds in every direction."""


def random_show(rng: np.random.Generator) -> rho.Show:
    """Draw pads, two to four formations of some or all of the vehicles, limits and times."""
    columns = int(rng.integers(7, 18))
    rows = int(np.ceil(rng.uniform(50, 300) / columns))
    pads = rho.formations.Grid(columns, rows, spacing=rng.uniform(1.2, 2.5))
    count = columns * rows
    scenes = [
        rho.Scene(
            f"scene {number}",
            random_formation(rng, int(rng.integers(max(2, count // 2), count + 1))),
            hold=rng.choice([0.0, rng.uniform(0.5, 4.0)]),
            colours=[f"#{rng.integers(1, 2**24):06x}"],
        )
        for number in range(1, int(rng.integers(3, 6)))
    ]
    at_once = int(rng.integers(1, count + 1)) if rng.random() < 0.5 else None
    every = rng.uniform(0.1, 0.5) if at_once is not None and count / at_once < 20 else 0.0
    return rho.Show(
        "random",
        pads,
        scenes,
        rho.Limits(max_speed=rng.uniform(3, 8), max_acceleration=rng.uniform(2, 5)),
        APART,
        step=float(rng.choice([0.2, 0.25, 0.5])),
        take_off=rho.TakeOff(rng.uniform(1.5, 4.0), at_once, every),
        landing=str(rng.choice(["own", "any"])),
    )


def room(rng: np.random.Generator) -> rho.Show:
    """Draw three formations of 24 Crazyflies in a room of 6 m, with downwash.

    The first is of random points that keep the separation with a tenth to spare.
    """
    apart = rho.Separation(0.4, downwash=rng.uniform(2.0, 3.0))
    forms, placed = rho.formations, {"center": [0, 0, 1.6], "rotation": [0.4, 0, rng.uniform(0, 6)]}
    points = list[Any]()
    while len(points) < 24:
        point = rng.uniform([-2.8, -2.8, 0.4], [2.8, 2.8, 2.8])
        away = apart.scaled(np.array([point, *points]))
        if np.linalg.norm(away[1:] - away[0], axis=1).min(initial=1.0) >= 1.1 * apart.distance:
            points.append(point)
    crowd = forms.Table(points)
    block = forms.Grid(4, 3, 2, spacing=1.25, center=[0, 0, 1.5])
    scenes: dict[str, AnyFormation] = {
        "crowd": crowd,
        "ring": forms.Ring(24, 2.4, **placed),
        "block": block,
    }
    return rho.Show(
        "room",
        forms.Grid(6, 4, spacing=0.5),
        [rho.Scene(name, each, hold=1.0) for name, each in scenes.items()],
        rho.Limits(rho.Box([-3, -3, 0], [3, 3, 3]), max_speed=1.5, max_acceleration=3.0),
        apart,
        step=0.2,
        take_off=rho.TakeOff(1.0),
    )


def random_formation(rng: np.random.Generator, count: int) -> AnyFormation:
    """Draw a formation of about as many points, above everything that waits."""
    forms, side = rho.formations, int(np.floor(np.cbrt(count) + 1e-9))
    radius, turned = SPACING * np.sqrt(count), [0.0, 0.0, rng.uniform(-3, 3)]
    size = SPACING * max(radius, count / 3.0)
    placed: dict[str, Any] = {
        "center": [*rng.uniform(-10, 10, 2), 12.0 + size / 2.0],
        "rotation": turned,
    }
    match rng.integers(5):
        case 0:
            return forms.Ring(count, SPACING * count / 6.0, **placed)
        case 1:
            return forms.Sphere(count, radius, **placed)
        case 2:
            return forms.Grid(side, side, side, spacing=SPACING, **placed)
        case 3:
            wide = int(np.ceil(np.sqrt(count)))
            upright = [np.pi / 2.0, 0.0, turned[2]]
            return forms.Grid(
                wide, count // wide, spacing=SPACING, **placed | {"rotation": upright}
            )
        case _:
            points = [np.zeros(3)]
            while len(points) < count:
                point = rng.uniform(-radius, radius, 3)
                away = np.linalg.norm((np.array(points) - point) / [1.0, 1.0, 2.0], axis=1)
                if away.min() >= 1.1:
                    points.append(point)
            return forms.Table(points, **placed)
