"""Trajectories of other planners, judged at every instant: polynomials exactly, samples in bounds.

Random polynomials are judged beside dense samples of them, computed here by Horner's rule.
"""

from __future__ import annotations

import dataclasses
import json
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.polynomial import Polynomial
from pydrake.trajectories import PiecewisePolynomial

import drake_rho as rho
from drake_rho import cli

Array = np.ndarray[Any, np.dtype[np.float64]]

ROUNDING = 1e-9
"""Relative difference of values computed in two ways."""
DENSE = 401
"""Samples of each piece beside which it is judged."""
FAR = 2.0
"""Distance from which `verify` follows only the vehicle that is closest at a knot [m]."""


def drake(instants: Array, coefficients: Array) -> PiecewisePolynomial:
    """Return a trajectory of Drake from coefficients of shape (J, 3, D + 1)."""
    pieces = [np.array([[Polynomial(axis)] for axis in piece]) for piece in coefficients]
    return PiecewisePolynomial(pieces, instants)


def values(instants: Array, coefficients: Array, order: int) -> tuple[Array, Array]:
    """Return dense times (M,) and values of a derivative (N, M, 3), by Horner's rule."""
    c = coefficients
    for _ in range(order):
        c = c[..., 1:] * np.arange(1.0, c.shape[-1])
    s = np.diff(instants)[:, None] * np.linspace(0.0, 1.0, DENSE)
    found = np.zeros((*c.shape[:3], DENSE))
    for k in range(c.shape[-1] - 1, -1, -1):
        found = found * s[:, None] + c[..., k, None]
    times = (instants[:-1, None] + s).reshape(-1)
    return times, np.moveaxis(found, 2, 3).reshape(len(c), -1, 3)


def field(vehicles: int, seconds: float) -> rho.Scenario:
    """Return a scenario with boxes, norms, obstacles at rest and in motion, and a separation."""
    corner = [(-3.9, -3.5 + 0.7 * n, -3.9) for n in range(vehicles)]
    box = rho.Box((-4.0, -4.0, -4.0), (4.0, 4.0, 4.0))
    moving = rho.Track([0.0, seconds / 3.0, seconds], [(-3, 2, 3), (0, 3, 3), (3, 2, 0)])
    return rho.Scenario(
        name="field",
        grid=rho.Grid(seconds / 8.0, 9),
        vehicles=tuple(
            rho.Vehicle(f"v{n}", rho.State(at), rho.State(at)) for n, at in enumerate(corner)
        ),
        limits=rho.Limits(
            position=box,
            velocity=box,
            acceleration=box,
            jerk=box,
            max_speed=4.0,
            max_jerk=9.0,
            max_tilt=0.5,
        ),
        obstacles=(
            rho.Sphere((2.0, 1.0, 0.0), 1.0),
            rho.Ellipsoid((-2.0, 0.0, 1.0), (0.5, 1.0, 2.0)),
            rho.Obstacle(rho.Box((-0.5, -0.3, -0.3), (0.5, 0.3, 0.3)), track=moving),
        ),
        separation=rho.Separation(0.5, downwash=2.0) if vehicles > 1 else None,
        requirements=(
            rho.KeepIn(rho.Ball((0.0, 0.0, 0.0), 7.0), name="ball"),
            rho.KeepIn(rho.Ball((0.0, 0.0, 0.0), 3.0), of="velocity", name="slow"),
        ),
    )


def random_pieces(rng: np.random.Generator, vehicles: int, pieces: int) -> tuple[Array, Array]:
    """Return instants (J + 1,) and coefficients (N, J, 3, D + 1) of pieces that do not join."""
    durations, degree = rng.uniform(0.1, 2.0, pieces), int(rng.integers(0, 8))
    instants = np.append(0.0, np.cumsum(durations))
    c = rng.normal(size=(vehicles, pieces, 3, degree + 1)) * rng.choice([0.1, 1.0, 3.0])
    return instants, c / durations[:, None, None] ** np.arange(degree + 1.0)


def jerks_of_jumps(scenario: rho.Scenario, instants: Array, c: Array) -> Array:
    """Return jumps of accelerations between pieces, over a step of the grid, (N, J + 1, 3)."""
    if c.shape[-1] < 3:
        return np.zeros((len(c), 1, 3))
    a = values(instants, c, 2)[1].reshape(len(c), -1, DENSE, 3)
    rest = np.zeros((len(c), 1, 3))
    before = np.concatenate([rest, a[:, :, -1]], axis=1)
    after = np.concatenate([a[:, :, 0], rest], axis=1)
    return np.asarray((after - before) / scenario.grid.step)


def dense_excess(scenario: rho.Scenario, instants: Array, c: Array) -> dict[tuple[str, str], Array]:
    """Return the largest excess of each vehicle at dense samples, by constraint, shape (N,)."""
    found: dict[tuple[str, str], Array] = {}
    times, p = values(instants, c, 0)
    for order, quantity in enumerate(("position", "velocity", "acceleration", "jerk")):
        x = values(instants, c, order)[1] if c.shape[-1] > order else np.zeros_like(p)
        if quantity == "jerk":
            x = np.concatenate([x, jerks_of_jumps(scenario, instants, c)], axis=1)
        found[quantity, "box"] = (np.abs(x) - 4.0).max(axis=(1, 2))
        if quantity == "velocity":
            found["max_speed", ""] = np.linalg.norm(x, axis=2).max(axis=1) - 4.0
            found["requirements", "slow"] = np.linalg.norm(x, axis=2).max(axis=1) - 3.0
    found["requirements", "ball"] = np.linalg.norm(p, axis=2).max(axis=1) - 7.0
    for number, body in enumerate(scenario.bodies, start=1):
        x = p - body.centers(times)
        found["obstacles", str(number)] = -body.shape.local_distance(x).min(axis=1)
    if scenario.separation is not None:
        scaled = p / [1.0, 1.0, scenario.separation.downwash]
        apart = np.linalg.norm(scaled[:, None] - scaled, axis=3)
        apart[np.arange(len(p)), np.arange(len(p))] = np.inf
        found["separation", ""] = 0.5 - apart.min(axis=(1, 2))
    return found


def wrong(scenario: rho.Scenario, instants: Array, c: Array) -> list[str]:
    """Return checks of random pieces that a dense sample exceeds, or that no instant attains."""
    named = {f"v{n}": drake(instants, each) for n, each in enumerate(c)}
    report = rho.verify(rho.Trajectories.of(named), scenario)
    dense, bad = dense_excess(scenario, instants, c), list[str]()
    for (kind, word), excess in dense.items():
        for n in range(len(c)):
            checks = [
                each
                for each in report.checks
                if each.kind == kind and word in each.what and each.vehicle == f"v{n}"
            ]
            worst = max(checks, key=lambda each: each.excess)
            if kind == "separation" and worst.value > FAR and excess[n] < worst.limit - FAR:
                continue  # distances beyond are upper bounds
            size = 1.0 + abs(worst.value) + float(np.abs(c).max())
            below = excess[n] - worst.excess
            if not below <= 0.02 * worst.tolerance + ROUNDING * size:
                bad.append(f"{worst}: a sample exceeds it by {below}")
            # the largest of the samples is near the largest value
            if not -below <= 1e-3 * size * c.shape[-1] ** 2:
                bad.append(f"{worst}: no sample is near, by {below}")
    return bad


def test_random_polynomials_are_judged_as_dense_samples_are() -> None:
    rng, pieces = np.random.default_rng(3), 0
    while pieces < 2000:
        vehicles, count = int(rng.integers(1, 6)), int(rng.integers(1, 60))
        instants, c = random_pieces(rng, vehicles, count)
        assert wrong(field(vehicles, float(instants[-1])), instants, c) == []
        pieces += vehicles * count


def along_x(limits: rho.Limits | None = None, **more: Any) -> rho.Scenario:
    """Return a scenario with a vehicle that flies 2 m along x in 2 s, from rest to rest."""
    ends = rho.State((0.0, 0.0, 0.0)), rho.State((2.0, 0.0, 0.0))
    more = dict[str, Any](grid=rho.Grid(0.25, 9)) | more
    return rho.Scenario(
        name="x", vehicles=(rho.Vehicle("a", *ends),), limits=limits or rho.Limits(), **more
    )


def smooth_x() -> rho.Trajectories:
    """Return the cubic from rest to rest, with its largest speed 1.5 m/s at 1 s."""
    cubic = np.zeros((1, 3, 4))
    cubic[0, 0] = [0.0, 0.0, 1.5, -0.5]
    return rho.Trajectories.of({"a": drake(np.array([0.0, 2.0]), cubic)})


@pytest.mark.parametrize("beyond", [1e-6, -1e-6, 1e-4, -1e-4])
def test_a_polynomial_that_touches_a_limit_has_the_known_excess(beyond: float) -> None:
    limits = rho.Limits(max_speed=1.5 - beyond, max_acceleration=3.0 - beyond, max_jerk=13.0)
    report = rho.verify(smooth_x(), along_x(limits))
    found = {each.kind: each for each in report.checks}
    for kind, time in (("max_speed", {1.0}), ("max_acceleration", {0.0, 2.0})):
        each = found[kind]
        assert abs(each.excess - beyond) <= 0.01 * each.tolerance + 1e-12
        assert min(abs(each.time - t) for t in time) < 1e-2
        assert each.holds == (beyond <= each.tolerance)
    assert abs(found["max_jerk"].value - 3.0 / 0.25) < 1e-12  # from rest to 3 m/s² in a step
    assert report.ok == all(each.holds for each in report.checks)


def test_an_obstacle_touched_between_knots_has_the_known_clearance() -> None:
    ball = rho.Sphere((1.1, 0.3, 0.0), 0.3 + 1e-6)
    report = rho.verify(smooth_x(), along_x(obstacles=(ball,)))
    assert report.clearance is not None
    assert abs(report.clearance.value + 1e-6) < 1e-9
    assert abs(smooth_x().at(report.clearance.time).positions[0, 0, 0] - 1.1) < 1e-3


def test_a_jump_a_wrong_start_and_a_wrong_goal_are_found() -> None:
    lines = np.zeros((2, 3, 2))
    lines[:, 0] = [[0.1, 1.0], [1.2, 1.0]]  # jumps by 0.1 m at 1 s, ends at 2.2 m
    found = rho.Trajectories.of({"a": drake(np.array([0.0, 1.0, 2.0]), lines)})
    report = rho.verify(found, along_x())
    assert {each.what: round(each.value, 12) for each in report.violations} == {
        "dynamics position": 0.1,
        "start position": 0.1,
        "start velocity": 1.0,
        "goal position": 0.2,
        "goal velocity": 1.0,
    }


def test_a_vehicle_outside_its_own_time_is_at_rest_and_this_is_told() -> None:
    longer = along_x(grid=rho.Grid(0.25, 13))
    report = rho.verify(smooth_x().delayed(0.5), longer)
    assert report.ok
    assert "taken to be at rest: a until 0.5 s" in report.notes
    assert "taken to be at rest: a from 2.5 s" in report.notes
    cut = np.zeros((1, 3, 4))
    cut[0, 0] = [0.0, 0.0, 1.5, -0.5]
    early = rho.Trajectories.of({"a": drake(np.array([0.0, 1.0]), cut)})
    stops = {each.what: each.value for each in rho.verify(early, longer).violations}
    assert abs(stops["dynamics velocity"] - 1.5) < 1e-12  # it cannot stop at once


def flight(name: str) -> rho.Plan:
    """Return a plan of up to 31 pieces, which files of Crazyswarm hold exactly."""
    if name == "fleet":
        rng = np.random.default_rng(2)
        return rho.plan(rho.random_transitions(4, rng, duration=6.0, step=0.25))
    ends = rho.State((0.0, 0.0, 1.5)), rho.State((5.0, 0.0, 1.5))
    house = rho.Box((2.0, -4.0, 0.0), (3.0, 0.3, 4.0))
    limits = rho.Limits(max_speed=4.0, max_acceleration=4.0, max_jerk=60.0, max_tilt=0.5)
    scenario = rho.Scenario(
        name="flight",
        grid=rho.Grid(0.5, 11, start=100.0),
        vehicles=(rho.Vehicle("a b", *ends, radius=0.2),),
        limits=limits,
        obstacles=(house,),
        between_knots=True,
        smoothing=rho.Smoothing(0.5, 1) if name == "smooth" else None,
        disturbance=rho.Disturbance(0.1) if name == "wind" else None,
    )
    return rho.plan(scenario)


def margins(report: rho.Report) -> Mapping[tuple[str, str], float]:
    """Return the margins of all checks but those of starts, which plans meet by construction."""
    checks = (each for each in report.checks if each.constraint != "start")
    return {(each.vehicle, each.what): each.left for each in checks}


@pytest.mark.parametrize("name", ["fleet", "steps", "smooth", "wind"])
def test_an_exported_plan_holds_with_the_same_margins(name: str, tmp_path: Path) -> None:
    plan = flight(name)
    path = rho.export(plan, tmp_path / "files", format="crazyswarm").path
    found = rho.load_trajectories(path, plan.scenario)
    report, own = rho.verify(found, plan.scenario), rho.verify(plan)
    assert own.ok
    assert report.ok
    read, exact = margins(report), margins(own)
    assert read.keys() == exact.keys()
    for key, left in exact.items():
        assert abs(read[key] - left) < 1e-7 * (1.0 + abs(left)), key
    assert abs(report.summary.top_speed - own.summary.top_speed) < 1e-9
    times = np.linspace(plan.times[0], plan.times[-1], 50)
    np.testing.assert_allclose(found.at(times).states, plan.at(times).states, atol=1e-9)


def sampled_x(rate: float, most: float) -> rho.Trajectories:
    """Return samples of the cubic at a rate, with a bound on the acceleration."""
    times = np.linspace(0.0, 2.0, round(2.0 * rate) + 1)
    table = np.column_stack([times, smooth_x().at(times, vehicle="a").positions])
    return rho.Trajectories.of_samples({"a": table}, max_acceleration=most)


@pytest.mark.parametrize(
    ("gap", "rate", "verdict"),
    [
        (0.1, 50.0, "holds"),
        (0.001, 5.0, "undecided"),
        (-0.001, 5.0, "undecided"),
        (-0.1, 50.0, "violated"),
        (0.001, 50.0, "holds"),
        (-0.001, 50.0, "violated"),
    ],
)
def test_samples_hold_are_violated_or_undecided(gap: float, rate: float, verdict: str) -> None:
    ball = rho.Sphere((1.1, 0.3 + gap, 0.0), 0.3)
    report = rho.verify(sampled_x(rate, 3.0), along_x(obstacles=(ball,)))
    assert report.ok == (verdict == "holds")
    assert bool(report.violations) == (verdict == "violated")
    assert bool(report.undecided) == (verdict == "undecided")
    assert all(each.kind == "obstacles" for each in (*report.violations, *report.undecided))


def test_the_rate_that_is_told_decides() -> None:
    scenario = along_x(
        rho.Limits(max_speed=1.6, position=rho.Box((-1.0, -0.01, -1.0), (3.0, 1.0, 1.0)))
    )
    report = rho.verify(sampled_x(4.0, 3.0), scenario)
    assert {each.kind for each in report.undecided} == {"max_speed", "position"}
    rates = [each.deciding_rate for each in report.undecided]
    assert all(each is not None and 4.0 < each < 200.0 for each in rates)
    enough = 2.0 * max(each for each in rates if each is not None)
    assert rho.verify(sampled_x(enough, 3.0), scenario).ok
    assert "samples a second would decide" in str(report)


def test_what_samples_never_decide_is_told() -> None:
    report = rho.verify(sampled_x(50.0, 3.0), along_x(rho.Limits(max_jerk=50.0)))
    assert [each.kind for each in report.undecided] == ["max_jerk"]
    assert "undecided at any rate of samples: maximum jerk" in str(report)


def test_samples_that_need_more_than_their_bound_are_found() -> None:
    report = rho.verify(sampled_x(50.0, 2.0), along_x())
    assert "dynamics mean acceleration of samples" in {each.what for each in report.violations}


@pytest.mark.parametrize("seed", range(20))
def test_a_motion_between_samples_is_never_judged_wrong(seed: int) -> None:
    """The verdict on samples of a random motion is that on the motion itself, or is left open."""
    rng = np.random.default_rng(seed)
    times = np.sort(rng.uniform(0.0, 8.0, 5))
    knots = rng.uniform(-3.0, 3.0, (3, 5))
    curve = PiecewisePolynomial.CubicShapePreserving(np.append(times[:-1], 8.0), knots)
    truth = rho.Trajectories.of({"v0": curve})
    scenario = field(1, 8.0)
    t = np.unique(np.append(rng.uniform(curve.start_time(), 8.0, 200), [curve.start_time(), 8.0]))
    a = truth.at(np.linspace(curve.start_time(), 8.0, 20001)[:-1]).accelerations
    most = 1.001 * float(np.linalg.norm(a, axis=2).max())
    table = np.column_stack([t, truth.at(t, vehicle="v0").positions])
    seen = rho.Trajectories.of_samples({"v0": table}, max_acceleration=most)
    exact = {each.what: each for each in rho.verify(truth, scenario).checks}
    for each in rho.verify(seen, scenario).checks:
        own = exact.get(each.what.replace("at knots", "at all times")) or exact.get(each.what)
        if own is None or each.constraint in ("start", "goal", "dynamics") or each.is_undecided:
            continue
        if each.part.endswith("at knots") and each.holds:
            continue  # of the samples alone
        assert own.holds == each.holds, (own, each)


def run(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, *words: str
) -> tuple[int, str]:
    """Run `drake-rho words` in this process."""
    monkeypatch.setattr("sys.argv", ["drake-rho", *words])
    with pytest.raises(SystemExit) as left:
        cli.main()
    printed = capsys.readouterr()
    assert isinstance(left.value.code, int)
    return left.value.code, printed.out + printed.err


def write_samples(path: Path, rate: float) -> None:
    """Write samples of the cubic at a rate, with six digits."""
    times = np.linspace(0.0, 2.0, round(2.0 * rate) + 1)
    x = smooth_x().at(times, vehicle="a").positions[:, 0]
    rows = [f"{t:.6f}, {at:.6f}, 0, 0" for t, at in zip(times, x, strict=True)]
    path.write_text("\n".join(["t, x, y, z", *rows, ""]))


@pytest.mark.parametrize(
    ("gap", "rate", "status"), [(0.1, 20.0, 0), (-0.1, 20.0, 1), (0.001, 5.0, 6)]
)
def test_the_command_line_has_a_status_for_each_verdict(
    gap: float,
    rate: float,
    status: int,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    file, scenario = tmp_path / "any.csv", tmp_path / "scenario.yaml"
    rho.save_scenario(along_x(obstacles=(rho.Sphere((1.1, 0.3 + gap, 0.0), 0.3),)), scenario)
    write_samples(file, rate)
    words = ["verify", str(file), "--scenario", str(scenario), "--max-acceleration", "3.1"]
    found, text = run(capsys, monkeypatch, *words)
    assert found == status, text
    assert ("undecided" in text) == (status == 6)
    found, text = run(capsys, monkeypatch, *words, "--json")
    document = json.loads(text)
    assert (found, document["status"], document["ok"]) == (status, status, status == 0)
    assert len(document["undecided"]) == (status == 6)
    for each in document["undecided"]:
        assert each["deciding_rate_hz"] > rate


def test_samples_without_a_bound_are_refused_by_the_option(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "any.csv").write_text(TABLE)
    words = ["verify", str(tmp_path / "any.csv"), "--scenario", "courier"]
    found, text = run(capsys, monkeypatch, *words)
    assert found == 2
    assert text.startswith("drake-rho: --max-acceleration: got None, expected a bound")


TABLE = "time,x,y,z\n0,0,0,0\n1,1,0,0\n2,2,0,0\n"
PIECE = ",".join(["1.0", *["0.0"] * 32])
COEFFICIENTS = ["duration", *(f"{axis}^{k}" for axis in ("x", "y", "z", "yaw") for k in range(8))]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "got no trajectories"),
        ("hello\n", "got no trajectories"),
        ("vehicle,x,y,z\na,1,2,3\n", "got no trajectories"),
        (TABLE.replace("1,1,0,0", "1,one,0,0"), "row 3, column x: got 'one'"),
        (TABLE.replace("1,1,0,0", "1,nan,0,0"), "row 3, column x: got 'nan'"),
        (TABLE.replace("1,1,0,0", "1,1,0"), "row 3: got 3 cells"),
        (TABLE.replace("2,2,0,0", "1,2,0,0"), "row 4: got 1 s, expected a time after 1 s"),
        ("time,x,y,z\n0,0,0,0\n", "expected (M, 4) with two or more rows"),
        (f"duration,x^0\n{PIECE[:-4]}\n", "row 2: got 32 cells"),
        (f"duration,x^0\n{PIECE}\n-{PIECE}\n", "row 3, column duration"),
        (f"duration\n{PIECE.replace('0.0', 'inf', 1)}\n", "row 2, column x^0: got 'inf'"),
        ("duration\n", "got no piece"),
        ("time,x,y,z\n", "got no rows, expected times and positions below the header"),
        (TABLE.replace("x", "x [cm]", 1), "row 1, column 2: got 'x [cm]', expected x [m]"),
        (TABLE.replace("z", "z (ft)", 1), "row 1, column 4: got 'z (ft)', expected z [m]"),
        (TABLE.replace("time", "t [min]", 1), "column 1: got 't [min]', expected time [s] or"),
        (f"duration\n{PIECE},9\n", "row 2: got 34 cells, expected 33, the last one yaw^7"),
        (
            f"{','.join([*COEFFICIENTS, 'x^8'])}\n{PIECE},9\n",
            "row 1, column 34: got 'x^8', expected none after yaw^7",
        ),
        (
            f"{','.join(['duration', *COEFFICIENTS[17:25], *COEFFICIENTS[9:17]])}\n{PIECE}\n",
            "row 1, column 2: got 'z^0', expected x^0",
        ),
    ],
)
def test_a_damaged_file_is_refused_with_its_place_and_reason(
    text: str, reason: str, tmp_path: Path
) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(rho.PlanFileError) as error:
        rho.load_trajectories(path, max_acceleration=1.0)
    assert str(path) in str(error.value)
    assert reason in str(error.value)


def test_a_bound_is_for_samples_alone(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(TABLE)
    (tmp_path / "b.csv").write_text(f"duration\n{PIECE}\n")
    with pytest.raises(ValueError, match="max_acceleration: got None, expected a bound"):
        rho.load_trajectories(tmp_path / "a.csv")
    with pytest.raises(ValueError, match="max_acceleration: got 1, expected None"):
        rho.load_trajectories(tmp_path / "b.csv", max_acceleration=1.0)
    with pytest.raises(rho.PlanFileError, match="got polynomials and samples"):
        rho.load_trajectories(tmp_path, max_acceleration=1.0)
    (tmp_path / "b.csv").unlink()
    outside = tmp_path.parent / f"{tmp_path.name}.csv"
    outside.write_text(TABLE)
    (tmp_path / "b.csv").symlink_to(outside)
    with pytest.raises(rho.PlanFileError, match="got a link to a file outside its folder"):
        rho.load_trajectories(tmp_path, max_acceleration=1.0)


def test_tables_of_any_columns_are_read(tmp_path: Path) -> None:
    path, expected = tmp_path / "a.csv", np.array([[1.0, 0.0, 0.0]])
    for text in (
        TABLE,
        TABLE.partition("\n")[2],
        "\ufeffX [m]; Time [msec]".replace(";", ",") + ",z,y,note\n0,0,0,0,a\n2,2000,0,0,b\n",
        "id,t,x,y,z\na,0,0,0,0\na,2,2,0,0\n",
        "# flown\n\n" + TABLE.replace(",", ";"),
        TABLE.replace(",", "\t"),
        "Time (ms),x (m),y,z [m]\n0,0,0,0\n2000,2,0,0\n",
    ):
        path.write_text(text)
        found = rho.load_trajectories(path, max_acceleration=1.0)
        assert found.names == ("a",)
        np.testing.assert_array_equal(found.at(1.0, vehicle="a").positions, expected)


def hop(step: float, knots: int, **more: Any) -> rho.Plan:
    """Return a plan of 6 m in a time that may be no whole number of milliseconds."""
    ends = rho.State((0.0, 0.0, 1.0)), rho.State((6.0, 1.0, 1.0))
    more["limits"] = rho.Limits(max_acceleration=8.0)
    return rho.plan(rho.Scenario("k", rho.Grid(step, knots), (rho.Vehicle("a", *ends),), **more))


@pytest.mark.parametrize("format", ["skyc", "skybrush", "show.zip", "mcap"])
@pytest.mark.parametrize(
    ("step", "knots", "more"),
    [
        (1.0 / 3.0, 32, {}),
        (1.0 / 3.0, 33, {}),
        (0.1001, 32, {"disturbance": rho.Disturbance(0.01)}),
        (0.12345, 31, {}),
        (1.0 / 3.0, 31, {"smoothing": rho.Smoothing(1.0 / 3.0)}),
    ],
)
def test_exports_whose_end_is_rounded_to_the_clock_of_the_file_hold(
    step: float, knots: int, more: dict[str, Any], format: str, tmp_path: Path
) -> None:
    if format != "skyc":
        more = {name: each for name, each in more.items() if name != "disturbance"}
    plan, name = hop(step, knots, **more), format.rpartition(".")[0] and "skybrush"
    path = rho.export(plan, tmp_path / f"a.{format}", format=name or format).path
    bound = None if format == "skyc" else 8.0
    found = rho.load_trajectories(path, plan.scenario, max_acceleration=bound)
    report = rho.verify(found, plan.scenario)
    assert not report.violations
    assert {each.kind for each in report.undecided} <= {"max_acceleration"}
    end = plan.scenario.grid.end + plan.scenario.lead
    assert abs(found.end - end) < 1e-3
    assert any("the end of the file" in each for each in report.notes) == (found.end > end + 1e-6)


def test_a_goal_is_judged_where_a_file_ends_and_only_within_its_rounding(tmp_path: Path) -> None:
    plan = hop(1.0 / 3.0, 32)
    path = rho.export(plan, tmp_path / "k.skyc").path
    found = rho.load_trajectories(path, plan.scenario)
    elsewhere = rho.Vehicle("a", plan.scenario.vehicles[0].start, rho.State((6.0, 1.001, 1.0)))
    missed = rho.verify(found, dataclasses.replace(plan.scenario, vehicles=(elsewhere,)))
    assert {each.what: round(each.value, 6) for each in missed.violations} == {
        "goal position": 0.001
    }
    with pytest.raises(ValueError, match="or a scenario that lasts as long"):
        found.delayed(0.001).for_scenario(plan.scenario)
    with pytest.raises(ValueError, match=r"tick: got 0.01, expected 0 to 0.001 s"):
        dataclasses.replace(found, tick=0.01)


def test_times_of_skybrush_count_from_the_beginning(tmp_path: Path) -> None:
    plan = hop(0.25, 17)
    late = dataclasses.replace(plan.scenario, grid=rho.Grid(0.25, 17, start=100.0))
    rho.export(plan, tmp_path / "a", format="skybrush")
    found = rho.load_trajectories(tmp_path / "a", late, max_acceleration=8.0)
    assert (found.start, found.end) == (100.0, 104.0)


def write_zip(path: Path, files: Mapping[str, bytes]) -> Path:
    """Write an archive."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return path


def test_jumps_that_rounded_coefficients_explain_are_told_and_do_not_count(tmp_path: Path) -> None:
    scenario = along_x()
    folder = rho.export(rho.plan(scenario), tmp_path / "flight", format="crazyswarm").path
    (file,) = folder.iterdir()
    header, *rows = [each.split(",") for each in file.read_text().splitlines()]
    for digits, by, holds in ((6, 0.0, True), (6, 1e-3, False), (2, 0.0, False)):
        cells = [[f"{float(each):.{digits}f}" for each in row] for row in rows]
        cells[1][1] = f"{float(cells[1][1]) + by:.{digits}f}"  # x at the second piece's beginning
        file.write_text("\n".join(map(",".join, [header, *cells])))
        report = rho.verify(rho.load_trajectories(folder, scenario), scenario)
        assert report.ok == holds, report
        told = any("digits of the file's coefficients" in each for each in report.notes)
        assert told == (digits == 6)  # two digits are taken as exact
        if not holds:
            assert "dynamics" in {each.kind for each in report.violations}


def test_an_archive_of_tables_is_read_like_their_folder(tmp_path: Path) -> None:
    files = {"a.csv": TABLE.encode(), "../b.csv": TABLE.encode(), "__MACOSX/._a.csv": b"x"}
    found = rho.load_trajectories(write_zip(tmp_path / "x.zip", files), max_acceleration=1.0)
    assert found.names == ("a", "b")


@pytest.mark.parametrize(
    ("files", "reason"),
    [
        ({"a.csv": TABLE.encode(), "b/a.csv": TABLE.encode()}, "got 'a' again, expected each"),
        ({"a.csv": TABLE.encode(), "b.txt": b"hello"}, "x.zip/b.txt: got no trajectories"),
        ({"b.zip": b"PK\3\4"}, "got 'b.zip' in the archive, expected tables"),
        ({"a\nb.csv": TABLE.encode()}, "got .* in the archive, expected tables"),
        ({}, r"got an archive without show\.json, expected a Skybrush show"),
        ({"plan.positions.npy": b""}, "got a saved result, which has its own scenario"),
    ],
)
def test_archives_of_anything_else_are_refused(
    files: dict[str, bytes], reason: str, tmp_path: Path
) -> None:
    path = write_zip(tmp_path / "x.zip", files)
    with pytest.raises(rho.PlanFileError, match=reason) as caught:
        rho.load_trajectories(path, max_acceleration=1.0)
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize("ending", ["npz", "json"])
def test_a_plan_is_not_taken_for_trajectories(
    ending: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    plan, file, scenario = hop(0.25, 17), tmp_path / f"two.{ending}", tmp_path / "two.yaml"
    rho.save(plan, file) if ending == "npz" else rho.export(plan, file)
    rho.save_scenario(plan.scenario, scenario)
    for words in (["verify"], ["show", "--html", "x.html"], ["export", "-o", "x.json"]):
        command = [words[0], str(file), "--scenario", str(scenario), *words[1:]]
        status, text = run(capsys, monkeypatch, *command)
        assert status == 2
        assert f"{file}: got a saved result, which has its own scenario" in text


def mutated(rng: np.random.Generator, content: bytes) -> bytes:
    """Return content with some bytes changed, inserted or left out, or cut off."""
    data = bytearray(content)
    for _ in range(int(rng.integers(1, 3))):
        if not data:
            break
        at, what = int(rng.integers(0, len(data))), rng.integers(0, 4)
        if what == 0:
            data[at] = int(rng.integers(0, 256))
        elif what == 1:
            data[at:at] = rng.choice([b",", b"\n", b'"', b"-", b"e9", b"nan", b"\x00", b"\xff"])
        elif what == 2:
            del data[at : at + int(rng.integers(1, 40))]
        else:
            data = data[: at + 1]
    return bytes(data)


def mutants(count: int, seed: int, folder: Path) -> dict[str, int]:
    """Return how many mutated files were read and refused; any other outcome is an error."""
    rng, outcomes = np.random.default_rng(seed), {"read": 0, "refused": 0}
    scenario, file = along_x(), folder / "a.csv"
    polynomials = "\n".join([",".join(["duration", "x^0"]), PIECE, PIECE, ""]).encode()
    for number in range(count):
        content, most = ((polynomials, None), (TABLE.encode(), 1.0))[number % 2]
        file.write_bytes(mutated(rng, content))
        outcome, error = "read", "expected"
        try:
            found = rho.load_trajectories(file, scenario, max_acceleration=most)
            rho.verify(found, scenario)
        except (rho.PlanFileError, ValueError) as refusal:
            outcome, error = "refused", str(refusal)
        assert "\n" not in error
        assert "expected" in error or "not a" in error, error
        outcomes[outcome] += 1
    return outcomes


ONE, PAIR = np.array([0.0, 1.0]), PiecewisePolynomial(np.zeros((2, 1)))
OTHER = rho.Trajectories.of({"b": drake(ONE, np.zeros((1, 3, 1)))})


def test_mutated_files_are_read_or_refused_in_a_line(tmp_path: Path) -> None:
    outcomes = mutants(300, 4, tmp_path)
    assert min(outcomes.values()) > 20


@pytest.mark.parametrize(
    ("call", "reason"),
    [
        (lambda: rho.verify(smooth_x()), "scenario: got None"),
        (lambda: rho.verify(flight("steps"), along_x()), "None for a plan"),
        (
            lambda: rho.verify(smooth_x().delayed(0.5), along_x()),
            "expected times of x, 0 to 2 s, or a scenario that lasts as long",
        ),
        (lambda: rho.verify(OTHER, along_x()), "a is in x, but not"),
        (lambda: rho.Trajectories.of({}), "motions: got none"),
        (lambda: rho.Trajectories.of({"a": PAIR}), r"shape \(2, 1\)"),
        (lambda: rho.Trajectories.of({"a": 3}), "expected a PiecewisePolynomial"),
        (lambda: sampled_x(5.0, -1.0), "expected a positive number"),
        (lambda: smooth_x().at(3.0), "expected times from 0 to 2 s"),
        (lambda: smooth_x().at(1.0, vehicle="b"), "expected one of a"),
    ],
)
def test_what_does_not_fit_is_refused(call: Callable[[], object], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        call()


def test_trajectories_are_drawn_and_planned_from() -> None:
    scenario = along_x(rho.Limits(max_acceleration=5.0), obstacles=(rho.Sphere((1, 0.1, 0), 0.2),))
    plan = rho.plan(scenario, reference=smooth_x())
    assert rho.verify(plan).ok
    drawn = smooth_x().as_plan(scenario)
    assert rho.paths_figure(drawn).axes
    np.testing.assert_allclose(drawn.positions, smooth_x().at(drawn.times).positions, atol=1e-12)


def test_a_long_name_is_not_printed_whole(tmp_path: Path) -> None:
    rows = [f"{name},{t},0,0,0" for name in ("a", "b" * 10_000) for t in (0, 1)]
    (tmp_path / "log.csv").write_text("\n".join(["vehicle,time,x,y,z", *rows]))
    with pytest.raises(rho.PlanFileError, match=r"vehicle: got 'b+\.\.\.b+', expected") as caught:
        rho.load_trajectories(tmp_path / "log.csv", max_acceleration=1.0)
    assert len(str(caught.value)) < 500
    (tmp_path / "log.csv").write_text("\n".join(["vehicle,time,x,y,z", *rows[:3]]))
    with pytest.raises(rho.PlanFileError, match="got shape") as caught:
        rho.load_trajectories(tmp_path / "log.csv", max_acceleration=1.0)
    assert len(str(caught.value)) < 500


def judged(scenario: rho.Scenario, *, samples: bool = False) -> rho.Trajectories:
    """Return the cubic, exact or sampled, as trajectories for a scenario."""
    return (sampled_x(20.0, 3.1) if samples else smooth_x()).for_scenario(scenario)


@pytest.mark.parametrize("samples", [False, True])
def test_trajectories_for_a_scenario_are_shown_and_verified_like_plans(samples: bool) -> None:
    ball = rho.Sphere((1.0, 0.5, 0.0), 0.2)
    scenario = along_x(rho.Limits(max_speed=3.0, max_acceleration=5.0), obstacles=(ball,))
    found = judged(scenario, samples=samples)
    assert found.scenario is scenario
    assert str(rho.verify(found)) == str(rho.verify(found, scenario))
    figures = (rho.paths_figure, rho.distances_figure, rho.velocities_figure)
    assert all(draw(found).axes for draw in (*figures, rho.accelerations_figure))
    assert "<html" in rho.viewer_page(found, heading="velocity").lower()
    lines = rho.distances_figure(found).axes[0].lines
    drawn = [np.array(each.get_xydata(), dtype=float) for each in lines]
    ((x, y),) = (each.T for each in drawn if len(each) > 9)
    at = found.at(x, vehicle="a").positions
    np.testing.assert_allclose(y, np.linalg.norm(at - ball.center, axis=1), atol=1e-3)
    better = rho.plan(scenario, reference=found)
    assert rho.verify(better).ok


@pytest.mark.parametrize("format", ["csv", "px4", "mcap"])
def test_trajectories_are_exported_as_they_are(format: str, tmp_path: Path) -> None:
    found, ending = judged(along_x()), "mcap" if format == "mcap" else "csv"
    heading: Any = None if format == "csv" else "velocity"
    path = tmp_path / f"x.{ending}"
    rho.export(found, path, format=format, rate=50.0, heading=heading)
    if format == "csv":
        again = rho.load_trajectories(path, max_acceleration=3.1)
        np.testing.assert_allclose(again.at(0.5).positions, found.at(0.5).positions, atol=1e-12)
    elif format == "px4":
        table = np.genfromtxt(path, delimiter=",", names=True)
        east = found.at(table["time_boot_ms"] / 1000.0).positions[0, :, 0]
        np.testing.assert_allclose(table["y"], east, atol=1e-12)


@pytest.mark.parametrize(
    ("call", "reason"),
    [
        (lambda path: rho.export(smooth_x(), path / "x.csv", format="csv"), "without a scenario"),
        (lambda path: rho.paths_figure(smooth_x()), r"trajectories.for_scenario\(scenario\)"),
        (
            lambda path: rho.export(judged(along_x()), path / "x.json"),
            "format: got json for trajectories, expected one of csv, px4, mcap",
        ),
        (lambda path: OTHER.for_scenario(along_x()), "a is in x, but not"),
        (lambda path: judged(along_x()).delayed(9.0), "expected times of x, 0 to 2"),
    ],
)
def test_without_their_scenario_or_a_fitting_format_they_are_refused(
    call: Callable[[Path], object], reason: str, tmp_path: Path
) -> None:
    with pytest.raises(ValueError, match=reason):
        call(tmp_path)
    assert not list(tmp_path.iterdir())


def test_what_is_read_as_trajectories_is_listed_and_told(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, text = run(capsys, monkeypatch, "formats", "--json")
    listed = {each["name"]: each["read_by"] or "" for each in json.loads(text)["formats"]}
    read = {name for name, by in listed.items() if "rho.load_trajectories(path)" in by}
    assert read == {"csv", "crazyswarm", "skybrush", "skyc", "mcap"}
    for command in ("verify", "export"):
        _, text = run(capsys, monkeypatch, command, "--help")
        words = " ".join(text.replace("│", " ").split())
        assert "with --scenario trajectories of another program" in words


def test_commands_show_and_export_tables_of_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    table, scenario = tmp_path / "any.csv", tmp_path / "scenario.yaml"
    rho.save_scenario(along_x(), scenario)
    write_samples(table, 20.0)
    words = [str(table), "--scenario", str(scenario), "--max-acceleration", "3.1"]
    for name, more in (("a.html", ["show", "--html"]), ("a.csv", ["export", "--format=px4", "-o"])):
        file = tmp_path / name
        status, text = run(capsys, monkeypatch, more[0], *words, *more[1:], str(file))
        assert (status, file.exists()) == (0, True), text
    for command in ("show", "export"):
        more = ["--topic", "a=/a/pose", "-o" if command == "export" else "--html"]
        path = str(tmp_path / ("x.csv" if command == "export" else "x.html"))
        options = ["--format=px4"] if command == "export" else []
        status, text = run(capsys, monkeypatch, command, str(table), *options, *more, path)
        assert status == 2
        assert "--topic: got no --scenario, expected that of samples" in text
