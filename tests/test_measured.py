"""Measurements of a flight: recorded between windows, judged by themselves, kept in files."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import drake_rho as rho

GRID = rho.Grid(step=0.25, knots=41, start=100.0)
BALL = rho.Obstacle(rho.Sphere([5.0, 1.3, 1.0], 0.5), name="ball")
SAMPLES = "at measured samples"
Array = npt.NDArray[np.float64]


def scene(**changes: Any) -> rho.Scenario:
    """Return two vehicles that fly 10 m along x, 3 m apart."""
    vehicles = [
        rho.Vehicle(name, rho.State([0, y, 1]), rho.State([10, y, 1]), radius=0.2)
        for name, y in (("q1", 0.0), ("q2", 3.0))
    ]
    given: dict[str, Any] = {
        "limits": rho.Limits(max_speed=4.0, position=rho.Box([-1, -2, 0], [11, 5, 3])),
        "separation": rho.Separation(1.0),
        "obstacles": [BALL],
    }
    return rho.Scenario("log", GRID, vehicles, **(given | changes))


def fly(scenario: rho.Scenario) -> rho.Flight:
    """Return a flight on plan, without measurements."""
    return rho.plan_rho(scenario, replan_every=8)


def log_of(flight: rho.Flight, times: Array) -> Array:
    """Return the planned states at times, (M, N, 6)."""
    planned = flight.at(times)
    return np.concatenate([planned.positions, planned.velocities], axis=2).swapaxes(0, 1).copy()


def measured(flight: rho.Flight, times: npt.ArrayLike, states: Array) -> rho.Flight:
    """Return the flight with a log of states (M, N, 6) at times."""
    names = flight.scenario.names
    log = rho.Measurements(names, np.asarray(times), states[..., :3], states[..., 3:])
    return dataclasses.replace(flight, measured=log)


def rows(report: rho.Report) -> list[rho.Check]:
    """Return the checks of measured samples."""
    return [each for each in report.checks if each.is_measured]


TIMES = 100.0 + np.arange(0.0, 10.0, 0.07)
"""Times of a log at a rate of its own, none of them but the first a knot."""


def test_a_log_on_plan_holds_and_changes_nothing_else() -> None:
    flight = fly(scene())
    before = rho.verify(flight)
    report = rho.verify(measured(flight, TIMES, log_of(flight, TIMES)))
    assert before.ok
    assert report.ok
    assert tuple(each for each in report.checks if not each.is_measured) == before.checks
    assert dataclasses.replace(report.summary, largest_deviation=None) == before.summary
    assert rows(before) == []
    assert {each.what for each in rows(report) if each.vehicle == "q1"} == {
        "position box x lower at measured samples",
        "maximum speed at measured samples",
        "obstacle 1 (ball) at measured samples",
        "separation from q2 at measured samples",
    }
    assert report.notes[:1] == ("measured: q1 143 times, q2 143 times, from 100 to 109.94 s",)
    deviation = report.summary.largest_deviation
    assert deviation is not None
    assert deviation.position == 0.0


def test_a_measured_collision_between_knots_is_found_and_named() -> None:
    flight = fly(scene())
    states = log_of(flight, TIMES)
    states[70, 1, :3] = [5.0, 1.5, 1.0]
    report = rho.verify(measured(flight, TIMES, states))
    (check,) = report.violations
    assert not report.ok
    assert (check.vehicle, check.constraint, check.part) == ("q2", "obstacle 1 (ball)", SAMPLES)
    assert check.time == pytest.approx(TIMES[70], abs=1e-9)
    assert check.value == pytest.approx(-0.3)
    assert report.clearance is not None
    assert report.clearance.holds
    text = str(report)
    assert "measured        q2 0.3 m inside obstacle 1 (ball) at 104.9 s; VIOLATED" in text
    assert "largest deviation of a measured sample from the planned motion: that of q2" in text


def test_a_vehicle_that_was_not_seen_neither_fails_nor_counts() -> None:
    flight = fly(scene())
    states = log_of(flight, TIMES)
    states[:, 1] = np.nan
    report = rho.verify(measured(flight, TIMES, states))
    assert report.ok
    assert {each.vehicle for each in rows(report)} == {"q1"}
    assert not any(each.kind == "separation" for each in rows(report))
    assert "q1 143 times, q2 0 times" in str(report)
    states[:, 0] = np.nan
    nothing = rho.verify(measured(flight, TIMES, states))
    assert rows(nothing) == []
    assert "no vehicle was measured during the flight" in nothing.notes


def test_positions_alone_are_judged_without_velocities() -> None:
    flight = fly(scene())
    states = log_of(flight, TIMES)
    states[..., 3:] = np.nan
    found = {each.kind for each in rows(rho.verify(measured(flight, TIMES, states)))}
    assert found == {"position", "obstacles", "separation"}


def test_separation_is_judged_only_among_vehicles_seen_at_the_same_time() -> None:
    flight = fly(scene(obstacles=[]))
    states = log_of(flight, TIMES)
    states[50, 0, :3] = states[50, 1, :3] = [5.0, 1.0, 1.0]
    both = states.copy()
    states[50, 0] = np.nan
    assert rho.verify(measured(flight, TIMES, states)).ok
    report = rho.verify(measured(flight, TIMES, both))
    assert [each.what for each in report.violations] == [
        f"separation from q2 {SAMPLES}",
        f"separation from q1 {SAMPLES}",
    ]
    assert [each.value for each in report.violations] == [0.0, 0.0]


@pytest.mark.parametrize("seed", range(5))
def test_values_are_those_of_plain_numpy(seed: int) -> None:
    """Distances, speeds and a requirement of random logs, by formulas of their own."""
    rng = np.random.default_rng(seed)
    moving = rho.Obstacle(
        rho.Sphere([5, 9, 1], 0.5), velocity=[0.01, 0, 0], active=(102.0, 106.0), position_error=0.1
    )
    inside = rho.KeepIn(
        rho.Ball([0, 0, 0], 3.0), of="velocity", vehicles=("q1",), active=(101.0, 103.0)
    )
    scenario = scene(obstacles=[BALL, moving], requirements=[inside])
    flight = fly(scenario)
    times = np.sort(rng.uniform(100.0, 110.0, 40))
    states = rng.normal([5, 1, 1, 0, 0, 0], 2.0, size=(40, 2, 6))
    states[rng.uniform(size=(40, 2)) < 0.3] = np.nan
    checks = {
        (each.vehicle, each.what.removesuffix(f" {SAMPLES}")): each
        for each in rows(rho.verify(measured(flight, times, states)))
    }
    p, v = states[..., :3], states[..., 3:]
    speeds = np.linalg.norm(v, axis=2)
    far = np.linalg.norm(p - [5.0, 1.3, 1.0], axis=2) - 0.5
    centers = np.array([5, 9, 1]) + times[:, None, None] * [0.01, 0, 0]
    later = np.linalg.norm(p - centers, axis=2) - 0.6
    later[(times < 102.0) | (times > 106.0)] = np.nan
    apart = np.linalg.norm(p[:, 0] - p[:, 1], axis=1)
    for i, name in enumerate(scenario.names):
        assert checks[name, "maximum speed"].value == pytest.approx(np.nanmax(speeds[:, i]))
        assert checks[name, "obstacle 1 (ball)"].value == pytest.approx(np.nanmin(far[:, i]))
        assert checks[name, "obstacle 2"].value == pytest.approx(np.nanmin(later[:, i]))
        other = scenario.names[1 - i]
        assert checks[name, f"separation from {other}"].value == pytest.approx(np.nanmin(apart))
        assert checks[name, f"separation from {other}"].time == pytest.approx(
            times[np.nanargmin(apart)]
        )
        box = np.maximum([-1, -2, 0] - p[:, i], p[:, i] - [11, 5, 3])
        (worst,) = (each for (who, what), each in checks.items() if who == name and "box" in what)
        assert worst.excess == pytest.approx(np.nanmax(box))
    held = np.where((times >= 101.0) & (times <= 103.0), speeds[:, 0] - 3.0, np.nan)
    assert checks["q1", "requirement 1 of velocity"].excess == pytest.approx(np.nanmax(held))
    assert ("q2", "requirement 1 of velocity") not in checks


def test_obstacles_count_once_they_are_known() -> None:
    late = dataclasses.replace(BALL, known_from=104.0)
    flight = fly(scene(obstacles=[late]))
    states = log_of(flight, TIMES)
    states[30, 1, :3] = [5.0, 1.5, 1.0]  # at 102.1 s
    assert rho.verify(measured(flight, TIMES, states)).ok
    states[80, 1, :3] = [5.0, 1.5, 1.0]  # at 105.6 s
    report = rho.verify(measured(flight, TIMES, states))
    assert not report.ok
    assert [each.avoided for each in report.sightings] == [True]  # by the plans


def test_samples_after_the_end_are_kept_and_not_judged() -> None:
    flight = fly(scene())
    times = np.append(TIMES, [111.0, 112.0])
    states = np.concatenate([log_of(flight, TIMES), np.full((2, 2, 6), 5.0)])
    flight = measured(flight, times, states)
    report = rho.verify(flight)
    assert report.ok
    assert "from 100 to 109.94 s; 2 after the end are not judged" in str(report)
    assert flight.measured is not None
    assert len(flight.measured.times) == len(times)


def in_wind(wind: float) -> rho.Flight:
    """Return a flight of a point mass in a steady wind along y, recorded at 50 Hz."""
    disturbance = rho.Disturbance(0.2, feedback_every=0.25)
    scenario = scene(obstacles=[], disturbance=disturbance)
    horizon = rho.RecedingHorizon(scenario, replan_every=1)
    states, h, push = horizon.planned(0), GRID.step, np.array([0.0, wind, 0.0])
    for knot in horizon.knots:
        time = GRID.times[knot]
        a = horizon.step(states, time).plan.accelerations[:, 0] + push
        p, v = states[:, :3], states[:, 3:]
        s = np.arange(0.0, h - 1e-9, 0.02)[:, None, None]
        log = np.concatenate([p + s * v + s**2 / 2 * a, v + s * a], axis=2)
        horizon.record(time + s[:, 0, 0], log)
        states = np.hstack([p + h * v + h**2 / 2 * a, v + h * a])
    horizon.record(GRID.end, states)
    return horizon.flight


def test_a_loop_in_wind_is_recorded_and_stays_in_its_tube() -> None:
    flight = in_wind(0.05)
    report = rho.verify(flight)
    assert report.ok
    assert flight.measured is not None
    assert len(flight.measured.times) == 40 * 13 + 1
    deviation = report.summary.largest_deviation
    assert deviation is not None
    assert deviation.position == pytest.approx(
        0.05 * 0.5**2 / 2
    )  # the last two steps have one plan
    assert deviation.velocity == pytest.approx(0.05 * 0.5)
    assert report.notes[-1].startswith("all measured samples are within the error tube")


def test_samples_outside_the_tube_are_told_with_the_first_time() -> None:
    report = rho.verify(in_wind(0.3))
    told = [each for each in report.notes if each.startswith("measured outside the error tube")]
    assert len(told) == 1
    assert "q1 from 100.02 s, q2 from 100.02 s" in told[0]


def test_the_true_motion_as_a_log_is_judged_as_the_simulation_is() -> None:
    """The worst sample is nearly as bad as the true motion at every instant, and never worse."""
    courier = rho.load_scenario("courier")
    true = rho.simulate(courier, wind=rho.winds.constant(courier, [0, 0.1, 0]))
    log = rho.Measurements(courier.names, true.times, true.positions, true.velocities)
    report = rho.verify(dataclasses.replace(true.flight, measured=log))
    samples = {(each.kind, each.constraint): each for each in rows(report)}
    of_truth = [each for each in rho.verify(true).checks if not each.part.endswith("knots")]
    common = [each for each in of_truth if (each.kind, each.constraint) in samples]
    assert {each.kind for each in common} == {"obstacles", "max_speed"}
    assert len(common) == 4
    for each in common:
        sample = samples[each.kind, each.constraint]
        assert each.excess - 1e-4 <= sample.excess <= each.excess + 1e-9
        assert sample.limit == each.limit
    assert report.notes[-1].startswith("all measured samples are within")


def test_records_are_kept_in_files_with_every_bit(tmp_path: Path) -> None:
    flight = fly(scene())
    states = log_of(flight, TIMES)
    states[10:20, 0], states[30:, 1, 3:] = np.nan, np.nan
    flight = measured(flight, TIMES, states)
    rho.save(flight, tmp_path / "flight.npz")
    read = rho.load(tmp_path / "flight.npz")
    assert isinstance(read, rho.Flight)
    assert read.measured is not None
    assert flight.measured is not None
    for name in ("times", "positions", "velocities"):
        one, other = getattr(read.measured, name), getattr(flight.measured, name)
        assert one.tobytes() == other.tobytes()
        assert not one.flags.writeable
    assert str(rho.verify(read)) == str(rho.verify(flight))
    assert flight.lasting(1.0).measured is flight.measured
    rho.save(fly(scene()), tmp_path / "without.npz")
    with np.load(tmp_path / "without.npz") as content:
        assert not any(name.startswith("measured") for name in content)


def test_exports_are_of_the_planned_motion(tmp_path: Path) -> None:
    flight = fly(scene())
    with_log = measured(flight, TIMES, log_of(flight, TIMES) + 0.01)
    for ending in ("json", "csv"):
        paths = [tmp_path / f"{name}.{ending}" for name in ("with", "without")]
        for path, each in zip(paths, (with_log, flight), strict=True):
            rho.export(each, path, format=ending)
        texts = [path.read_text() for path in paths]
        if ending == "json":
            one, other = (json.loads(text) for text in texts)
            assert one["vehicles"] == other["vehicles"]
        else:
            assert texts[0] == texts[1]


def test_measurements_of_one_vehicle_and_as_columns() -> None:
    unknown = np.full((3, 2, 3), np.nan)
    positions = np.arange(18.0).reshape(3, 2, 3)
    positions[1, 0] = np.nan
    log = rho.Measurements(("q1", "q2"), np.array([1.0, 2.0, 3.0]), positions, unknown)
    assert repr(log) == "<Measurements of 2 vehicles at 3 times, from 1 to 3 s>"
    assert repr(log.of("q1")) == "<Measurements of q1 at 2 times, from 1 to 3 s>"
    assert log.of("q1").positions.tolist() == [[[0, 1, 2]], [[12, 13, 14]]]
    table = log.columns()
    assert table["vehicle"] == ["q1", "q1", "q2", "q2", "q2"]
    assert table["time [s]"] == [1.0, 3.0, 1.0, 2.0, 3.0]
    assert table["z [m]"] == [2.0, 14.0, 5.0, 11.0, 17.0]
    assert len(table) == 8
    with pytest.raises(ValueError, match="vehicle: got 'q3', expected one of q1, q2"):
        log.of("q3")


NAN = np.nan
WRONG: dict[str, tuple[Any, Any]] = {
    "time: got 101 s, expected a time after 101 s": (101.0, np.zeros((2, 6))),
    "time: got nan s, expected a time after 101 s": (NAN, np.zeros((2, 6))),
    "time: got 102 s, expected a time after 103 s": ([103, 102], np.zeros((2, 2, 6))),
    r"time: got shape \(1, 1\), expected \(M,\) or a single": ([[102]], np.zeros((1, 1, 2, 6))),
    r"states: got shape \(1, 6\), expected \(2, 6\)": (102, np.zeros((1, 6))),
    r"states: got shape \(2, 6\), expected \(1, 2, 6\)": ([102], np.zeros((2, 6))),
    "positions: got .*inf.* for q1 at 102 s, expected three numbers": (102, [[np.inf] * 6] * 2),
    "positions: got .1.0, nan, 2.0. for q2 at 102 s": (102, [[0.0] * 6, [1, NAN, 2, 0, 0, 0]]),
    "velocities: got .0.0, 1.0, nan. for q2 at 102 s": (102, [[0.0] * 6, [1, 2, 3, 0, 1, NAN]]),
    "velocities: got .* for q1 at 102 s, .* not seen": (102, [[NAN] * 3 + [0.0] * 3, [0.0] * 6]),
    r"states: got shape \(\), expected \(2, 6\)": (102, None),
    "time: got 'now', expected numbers": ("now", np.zeros((2, 6))),
}


@pytest.mark.parametrize("expected", WRONG)
def test_what_is_no_measurement_is_refused(expected: str) -> None:
    horizon = rho.RecedingHorizon(scene())
    horizon.record(101.0, np.zeros((2, 6)))
    time, states = WRONG[expected]
    with pytest.raises((ValueError, TypeError), match=f"^{expected}"):
        horizon.record(time, states)


def test_a_time_before_the_flight_is_refused() -> None:
    horizon = rho.RecedingHorizon(scene())
    with pytest.raises(ValueError, match=r"times: got 99.9 s, expected .* from 100 s on"):
        horizon.record(99.9, np.zeros((2, 6)))


def test_a_log_of_other_vehicles_is_refused() -> None:
    flight = fly(scene())
    log = rho.Measurements(("q1",), np.array([101.0]), np.zeros((1, 1, 3)), np.zeros((1, 1, 3)))
    with pytest.raises(ValueError, match="measured: got the vehicles q1, expected q1, q2"):
        dataclasses.replace(flight, measured=log)
    with pytest.raises(ValueError, match=r"positions: got shape .*, expected \(1, 1, 3\)"):
        dataclasses.replace(log, positions=np.zeros((1, 2, 3)))


def test_records_may_begin_before_the_first_window() -> None:
    horizon = rho.RecedingHorizon(scene(), replan_every=20)
    horizon.record(100.0, horizon.planned(0))
    for knot in horizon.knots:
        horizon.step(horizon.planned(knot), GRID.times[knot])
    horizon.record([109.0, 110.0], np.zeros((2, 2, 6)))
    measurements = horizon.flight.measured
    assert measurements is not None
    assert measurements.times.tolist() == [100.0, 109.0, 110.0]


def test_figures_and_page_show_measured_samples() -> None:
    flight = fly(scene())
    states = log_of(flight, TIMES) + 0.05
    states[40:50, 0] = np.nan
    with_log = measured(flight, TIMES, states)
    for draw in (rho.distances_figure, rho.separation_figure, rho.velocities_figure):
        (legend,) = draw(with_log).legends
        assert "measured" in [each.get_text() for each in legend.get_texts()]
        before = [each.get_text() for fig in draw(flight).legends for each in fig.get_texts()]
        assert "measured" not in before
    (panel, *_) = rho.distances_figure(with_log).axes
    far = np.linalg.norm(states[:, 0, :3] - [5.0, 1.3, 1.0], axis=1)
    drawn = [np.asarray(line.get_ydata()) for line in panel.lines]
    assert any(len(each) == 143 and np.allclose(each, far, equal_nan=True) for each in drawn)
    assert "black: measured" in "".join(
        each.get_text() for each in rho.paths_figure(with_log).texts
    )
    assert "measured positions" in str(rho.viewer_page(with_log))
    assert "measured positions" not in str(rho.viewer_page(flight))
