"""Damaged files of other programs are read, or refused in one line that names them."""

from __future__ import annotations

import contextlib
import warnings
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest

import drake_rho as rho
from benchmarks.file_kinds import scenario
from benchmarks.format_kinds import BOUND, Kind, format_kinds

FILES = 2000
"""Number of damaged files of a kind."""
LONGEST = 700
"""Largest number of characters of an error's line."""
NOT_DAMAGED = (zipfile.BadZipFile, zlib.error, NotImplementedError, ValueError)
"""Errors of a second damage to an archive that is none any more."""
NAMES = (
    *("mission (.plan)", "mission (.waypoints)", "waypoints", "show (.skyc)", "polynomials"),
    *("positions", "log of ROS 2 (MCAP)", "log of ROS 2 (MCAP, plain)"),
    *("log of ROS 2 (MCAP, lz4)", "log of ROS 2 (MCAP, zstd)", "log of ROS 2 (SQLite)"),
    "log of PX4 (ULog)",
)


@pytest.fixture(scope="module")
def kinds(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Kind]:
    folder = tmp_path_factory.mktemp("kinds")
    return {each.name: each for each in format_kinds(folder, rho.plan(scenario(folder)))}


def load(kind: Kind, path: Path) -> None:
    """Read a file as its kind says."""
    if kind.command[0] == "mission":
        rho.load_mission(path)
    elif kind.command[0] == "waypoints":
        rho.load_waypoints(path)
    else:
        exact = kind.name in ("show (.skyc)", "polynomials")
        rho.load_trajectories(path, max_acceleration=None if exact else BOUND)


def wrong(kind: Kind, content: bytes, path: Path) -> str:
    """Return what is wrong with the answer to a file; empty if nothing is."""
    path.write_bytes(content)
    try:
        load(kind, path)
    except (rho.PlanFileError, rho.ScenarioError) as error:
        line = str(error)
        named = line.startswith(str(path)) and "\n" not in line and len(line) <= LONGEST
        return "" if named else f"an error {line[:200]!r}"
    except ValueError as error:  # samples need a bound that polynomials must not have
        return "" if str(error).startswith("max_acceleration: ") else repr(error)
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return ""


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_damaged_files_are_read_or_refused(
    name: str, kinds: dict[str, Kind], tmp_path: Path
) -> None:
    kind, rng = kinds[name], np.random.default_rng(50)
    path, found = tmp_path / f"damaged{kind.ending}", list[str]()
    path.write_bytes(kind.content)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rho.MissionWarning)
        load(kind, path)
        for _ in range(FILES):
            content = kind.content
            for _ in range(1 + int(rng.random() < 0.25)):
                chosen = kind.damages[rng.integers(len(kind.damages))]
                with contextlib.suppress(*NOT_DAMAGED):
                    content = chosen(content or b"0", rng)
            found += filter(None, [wrong(kind, content, path)])
    assert found == []


def test_every_kind_is_damaged(kinds: dict[str, Kind]) -> None:
    assert tuple(kinds) == NAMES
