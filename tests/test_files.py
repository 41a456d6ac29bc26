"""Plans and flights are read back unchanged, and other files are refused."""

from __future__ import annotations

import dataclasses
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import drake_rho as rho
from drake_rho.system.files import atomic_write, check_replaceable
from tests.scenarios import single


def _same(one: rho.Plan, other: rho.Plan) -> bool:
    return (
        one.scenario == other.scenario
        and one.statistics == other.statistics
        and np.array_equal(one.positions, other.positions)
        and np.array_equal(one.velocities, other.velocities)
        and np.array_equal(one.accelerations, other.accelerations)
    )


def test_a_plan_is_read_back_unchanged(paper: rho.Scenario, tmp_path: Path) -> None:
    plan = rho.plan_convex(paper)
    rho.save(plan, tmp_path / "plan.npz")
    loaded = rho.load(tmp_path / "plan.npz")
    assert isinstance(loaded, rho.Plan)
    assert _same(loaded, plan)
    assert [path.name for path in tmp_path.iterdir()] == ["plan.npz"]


def test_a_flight_is_read_back_unchanged(paper: rho.Scenario, tmp_path: Path) -> None:
    flight = rho.plan_rho(paper)
    rho.save(flight, tmp_path / "flight")
    loaded = rho.load(tmp_path / "flight")
    assert isinstance(loaded, rho.Flight)
    assert _same(loaded.plan, flight.plan)
    for one, other in zip(loaded.windows, flight.windows, strict=True):
        assert (one.first_knot, one.infeasible) == (other.first_knot, other.infeasible)
        assert _same(one.plan, other.plan)
        assert _same(one.reference, other.reference)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", ["positions", "velocities", "accelerations"])
def test_a_plan_with_nan_is_refused_by_name(name: str, value: float) -> None:
    plan = rho.plan_convex(single())
    array = getattr(plan, name).copy()
    array[0, 3, 1] = value
    words = rf"^{name}: got {value} for solo at knot 3 \(from 0\), expected finite numbers$"
    with pytest.raises(ValueError, match=words):
        dataclasses.replace(plan, **{name: array})


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e308])
def test_invalid_accelerations_are_refused(value: float) -> None:
    accelerations = np.zeros((1, 16, 3))
    accelerations[0, 3:, 2] = value
    with pytest.raises(ValueError, match=r"s: got .* for solo at knot .*, expected finite numbers"):
        rho.Plan.from_accelerations(single(), accelerations)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the bytes of a valid file."""
    path = tmp_path_factory.mktemp("plans") / "plan.npz"
    rho.save(rho.plan_convex(single()), path)
    return path.read_bytes()


@given(data=st.data())
@settings(max_examples=50)
def test_a_damaged_file_is_refused_or_unaffected(
    whole: bytes, tmp_path: Path, data: st.DataObject
) -> None:
    at = data.draw(st.integers(0, len(whole) - 1))
    if data.draw(st.booleans()):
        damaged = whole[:at]
    else:
        byte = data.draw(st.integers(0, 255))
        damaged = whole[:at] + bytes([byte]) + whole[at + 1 :]
    path = tmp_path / "damaged.npz"
    path.write_bytes(damaged)
    try:
        loaded = rho.load(path)
    except rho.PlanFileError:
        return
    assert isinstance(loaded, rho.Plan)
    rho.save(loaded, path)
    assert path.read_bytes() == whole


@pytest.mark.parametrize(
    "changes",
    [
        {"format": "something else"},
        {"plan.positions": np.zeros((1, 5, 3))},
        {"plan.accelerations": np.full((1, 16, 3), np.nan)},
        {"plan.accelerations": np.full((1, 16, 3), 1e308)},
        {"plan.positions": np.full((1, 17, 3), -1.1e12)},
        {"plan.velocities": np.array("words")},
        {"plan.scenario": "{}"},
        {"plan.scenario": "not json"},
        {"plan.statistics": '{"bogus": 1, "steps_tried": []}'},
        {"plan.statistics": "[]"},
        {"plan.statistics": '{"seconds": null}'},
        {"plan.accelerations": np.zeros((1, 16, 3), dtype=complex)},
        {"plan.accelerations": np.full((1, 16, 3), 1e300, dtype=np.longdouble)},
        {"first_knots": np.array([0])},
        {"surplus": np.array([0])},
        {"plan.velocities": np.array([None, object()])},
    ],
)
def test_a_file_with_other_content_is_refused(
    whole: bytes, tmp_path: Path, changes: dict[str, Any]
) -> None:
    path = tmp_path / "plan.npz"
    path.write_bytes(whole)
    with np.load(path) as content:
        changed = dict(content) | changes
    np.savez(path, **changed)
    with pytest.raises(rho.PlanFileError, match=r"plan\.npz"):
        rho.load(path)


def test_other_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "text").write_text("hello")
    (tmp_path / "empty").write_text("")
    np.save(tmp_path / "array.npy", np.zeros(3))
    with zipfile.ZipFile(tmp_path / "other.zip", "w") as other:
        other.writestr("hello", "world")
    for name in ("text", "empty", "array.npy", "other.zip", "missing", "."):
        with pytest.raises(rho.PlanFileError):
            rho.load(tmp_path / name)


def test_a_file_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_text("before")
    with pytest.raises(TypeError), atomic_write(path) as file:  # noqa: PT012  # halfway
        file.write(b"after")
        file.write("text where bytes belong")  # type: ignore[call-overload]  # tested
    assert path.read_text() == "before"
    with atomic_write(path) as file:
        file.write(b"after")
    assert path.read_text() == "after"
    assert [entry.name for entry in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize("name", ["room.csv", "room.npz.gz", "room.json"])
def test_an_ending_of_another_format_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=rf"{name}: .* expected the ending \.npz or none"):
        rho.save(rho.plan_convex(single()), tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_data_that_could_not_be_read_back_are_not_written(tmp_path: Path) -> None:
    plan = rho.Plan.from_accelerations(single(), np.full((1, 16, 3), 1.1e12))
    with pytest.raises(ValueError, match=r"plan\.positions has values that are not numbers up to"):
        rho.save(plan, tmp_path / "far.npz")
    assert not list(tmp_path.iterdir())


def test_a_loop_of_links_is_an_error_and_left_unchanged(tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    with pytest.raises(OSError, match="symbolic links"), atomic_write(tmp_path / "loop"):
        pass
    assert (tmp_path / "loop").is_symlink()


def test_a_missing_folder_is_an_error(tmp_path: Path) -> None:
    planned = rho.plan_convex(single())
    (tmp_path / "file").touch()
    writers: list[Callable[[Path], None]] = [
        partial(rho.save, planned),
        lambda path: rho.save_scenario(planned.scenario, path.with_suffix(".yaml")),
        check_replaceable,
    ]
    for write in writers:
        for folder, error in (("nowhere", FileNotFoundError), ("file", NotADirectoryError)):
            with pytest.raises(error) as caught:
                write(tmp_path / folder / "plan.npz")
            named = Path(str(caught.value.filename))  # the requested file, not a temporary one
            assert named in {tmp_path / folder, tmp_path / folder / "plan.npz"} or (
                named == tmp_path / folder / "plan.yaml"
            )
    assert [each.name for each in tmp_path.iterdir()] == ["file"]


@pytest.fixture(scope="module")
def whole_flight(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the bytes of a valid flight."""
    path = tmp_path_factory.mktemp("flights") / "flight.npz"
    rho.save(rho.plan_rho(single(), replan_every=8), path)
    return path.read_bytes()


@pytest.mark.parametrize(
    "first_knots", [[], [0], [0, -8], [0, 8.5], [0, 9], [8, 0], [0, 16], [0, 8, 12]]
)
def test_windows_that_do_not_make_up_the_flight_are_refused(
    whole_flight: bytes, tmp_path: Path, first_knots: list[float]
) -> None:
    path = tmp_path / "flight.npz"
    path.write_bytes(whole_flight)
    assert isinstance(rho.load(path), rho.Flight)
    with np.load(path) as content:
        changed = dict(content) | {"first_knots": np.array(first_knots)}
    np.savez(path, **changed)
    with pytest.raises(rho.PlanFileError):
        rho.load(path)


def test_a_flight_with_one_damaged_name_is_no_plan(whole_flight: bytes, tmp_path: Path) -> None:
    path = tmp_path / "flight.npz"
    damaged = bytearray(whole_flight)
    damaged[damaged.rfind(b"first_knots.npy")] ^= 1
    path.write_bytes(damaged)
    with pytest.raises(rho.PlanFileError):
        rho.load(path)


def test_links_are_followed_modes_kept_and_devices_refused(tmp_path: Path) -> None:
    target, link = tmp_path / "target", tmp_path / "link"
    target.write_text("before")
    target.chmod(0o600)
    link.symlink_to(target)
    with atomic_write(link) as file:
        file.write(b"after")
    assert link.is_symlink()
    assert target.read_text() == "after"
    assert target.stat().st_mode & 0o777 == 0o600
    for nothing in (tmp_path, Path("/dev/null")):
        with pytest.raises(OSError, match="not a regular file"), atomic_write(nothing):
            pass


_PART = {
    "scenario": ("U", ()),
    "statistics": ("U", ()),
    "positions": ("f", (1, 17, 3)),
    "velocities": ("f", (1, 17, 3)),
    "accelerations": ("f", (1, 16, 3)),
}
_WINDOW = {
    name: (kind, (1, shape[1] - 8, 3) if shape else ()) for name, (kind, shape) in _PART.items()
}


def _parts(prefix: str, parts: dict[str, Any]) -> dict[str, Any]:
    return {f"{prefix}.{name}": part for name, part in parts.items()}


def test_the_layout_of_files_is_that_of_the_documents(tmp_path: Path) -> None:
    """Other programs read these files: the layout pinned here is a promise."""
    flight = rho.plan_rho(single(), replan_every=8)
    times = flight.scenario.grid.times
    still = np.zeros((17, 1, 3))
    flown = rho.Simulation(flight, times, still, still, still, still)
    plans = {"format": ("U", ())} | _parts("plan", _PART)
    flights = plans | {"first_knots": ("i", (2,)), "infeasible": ("U", (2,))}
    flights |= dict.fromkeys(("learned", "not_avoided", "kept", "off_tube"), ("U", ()))
    for kind in ("plan", "reference"):
        flights |= _parts(f"window0.{kind}", _PART) | _parts(f"window1.{kind}", _WINDOW)
    simulations = flights | {"plant": ("U", ()), "simulation.times": ("f", (17,))}
    for name in ("positions", "velocities", "wind", "commands"):
        simulations[f"simulation.{name}"] = ("f", (17, 1, 3))
    for planned, form, expected in (
        (flight.plan, "drake_rho plan 1", plans),
        (flight, "drake_rho flight 1", flights),
        (flown, "drake_rho simulation 1", simulations),
    ):
        rho.save(planned, tmp_path / "kept.npz")
        with np.load(tmp_path / "kept.npz", allow_pickle=False) as content:
            assert str(content["format"]) == form
            found = {name: (array.dtype.kind, array.shape) for name, array in content.items()}
            assert found == expected
            assert all(
                each.dtype == np.float64 for each in content.values() if each.dtype.kind == "f"
            )
