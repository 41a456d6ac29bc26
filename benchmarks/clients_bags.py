"""Random plans exported as bags of ROS 2, read by rosbags and by mcap."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

import drake_rho as rho
from benchmarks.tables import Goal, Table
from tests.test_export import rough

SECOND, PLACES, FIFTH = 10**9, 1e-9, 5
"""Nanoseconds of a second, rounding of places [m], and of how many bags mcap reads one."""

_STORE = get_typestore(Stores.ROS2_JAZZY)


def run(count: int) -> Table:
    """Export random plans, and compare stamps and places of every message."""
    rng, began = np.random.default_rng(50), time.monotonic()
    stamps = wrong = others = messages = 0
    apart, again = 0.0, 0
    with tempfile.TemporaryDirectory() as folder:
        for k in range(count):
            plan, rate = _random(rng, k)
            path = Path(folder) / "x.mcap"
            rho.export(plan, path, rate=rate)
            found = _by_rosbags(path)
            wrong += _stamps(plan, rate, found)
            apart = max(apart, _apart(plan, found))
            messages += len(found)
            stamps += sum(topic == "/tf" for topic, _, _ in found)
            if k % FIFTH == 0:
                again += 1
                others += _by_mcap(path) != [(topic, stamp) for topic, stamp, _ in found]
    return Table(
        name="clients_bags",
        title="Bags of ROS 2",
        columns=("read by", "bags", "messages", "times", "bags with wrong stamps", "apart [m]"),
        rows=(
            ("rosbags", count, messages, stamps, wrong, apart),
            ("mcap", again, None, None, others, None),
        ),
        notes=(f"{_WORK} It took {time.monotonic() - began:.0f} s.",),
        goals=(
            Goal("bags with a stamp that is not exact", 0, wrong + others),
            Goal("largest distance of a place from the plan's [m]", PLACES, apart),
        ),
        packages=("drake-rho", "drake", "numpy", "rosbags", "mcap"),
    )


_WORK = """\
Plans of one to four vehicles with random accelerations, steps of 1 to 200 ms, rates of 1 to 50 Hz,
and clocks that begin at 0, in between, or at a Unix time. Exact: every knot has a stamp of a
whole number of milliseconds, no two stamps are further apart than the rate asks, and headers,
paths and trajectories have the same ones. mcap finds the same topics and stamps."""


def _random(rng: np.random.Generator, seed: int) -> tuple[rho.Plan, float]:
    step, start = int(rng.integers(1, 201)) / 1000.0, float(rng.choice([0.0, 1.5, 1.7e9]))
    vehicles, steps = int(rng.integers(1, 5)), int(rng.integers(2, 20))
    plan = rough(vehicles=vehicles, steps=steps, step=step, start=start, seed=seed)
    return plan, float(rng.uniform(1.0, 50.0))


def _by_rosbags(path: Path) -> list[tuple[str, int, Any]]:
    with Reader(path) as bag:
        return [
            (each.topic, stamp, _STORE.deserialize_cdr(data, each.msgtype))
            for each, stamp, data in bag.messages()
        ]


def _by_mcap(path: Path) -> list[tuple[str, int]]:
    with path.open("rb") as file:
        return [(c.topic, m.log_time) for _, c, m in make_reader(file).iter_messages()]


def _time(stamp: Any) -> int:
    return int(stamp.sec) * SECOND + int(stamp.nanosec)


def _stamps(plan: rho.Plan, rate: float, found: list[tuple[str, int, Any]]) -> bool:
    """Return whether a stamp is wrong."""
    grid = plan.scenario.grid
    begin, step = round(1000 * grid.start) * 10**6, round(1000 * grid.step) * 10**6
    stamps = [stamp for topic, stamp, _ in found if topic == "/tf"]
    bad = not {begin + k * step for k in range(grid.knots)} <= set(stamps)
    bad |= stamps != sorted(set(stamps)) or bool(np.diff(stamps).max() > SECOND / rate + 1.0)
    for topic, stamp, message in found:
        if topic == "/tf":
            bad |= any(_time(each.header.stamp) != stamp for each in message.transforms)
        elif topic.endswith("/path"):
            bad |= [_time(each.header.stamp) for each in message.poses] != stamps
        elif topic.endswith("/trajectory"):
            since = [_time(each.time_from_start) for each in message.points]
            bad |= [_time(message.header.stamp) + each for each in since] != stamps
    return bad


def _apart(plan: rho.Plan, found: list[tuple[str, int, Any]]) -> float:
    """Return the largest distance of a place from that of the plan at its stamp [m]."""
    transforms = [(stamp, each) for topic, stamp, each in found if topic == "/tf"]
    places = np.array(
        [
            [[getattr(t.transform.translation, axis) for axis in "xyz"] for t in each.transforms]
            for _, each in transforms
        ]
    )
    begin = round(1000 * plan.scenario.grid.start) * 10**6
    elapsed = np.array([(stamp - begin) / SECOND for stamp, _ in transforms])
    expected = plan.sampled(elapsed).positions
    return float(np.abs(places.swapaxes(0, 1) - expected).max())
