"""Results: known intervals, summaries consistent with the rows, files, figures."""

from __future__ import annotations

import csv
import dataclasses
import json
import math
from math import comb
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

import drake_rho as rho
from drake_rho.campaigns.statistics import Failure, Proportion, Quantiles, sign_test
from drake_rho.campaigns.store import COLUMNS, StoreError
from drake_rho.campaigns.tables import tables
from drake_rho.display.common.style import MAX_NAMED, vehicle_colours, window_colours, window_greys
from drake_rho.display.plots.campaigns import (
    _few_ticks,
    costs_figure,
    failures_figure,
    success_figure,
    times_figure,
    write_campaign_figures,
)
from tests.studies import small, table


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> rho.Results:
    """Return the results of a small study, some of whose runs have no plan."""
    return rho.campaign(small(5, plans=True), tmp_path_factory.mktemp("store") / "runs.sqlite")


@pytest.mark.parametrize(  # Newcombe, Statistics in Medicine 17 (1998), table I, method 3
    ("successes", "runs", "low", "high"),
    [
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_wilsons_interval_is_the_published_one(
    successes: int, runs: int, low: float, high: float
) -> None:
    found = Proportion(successes, runs).interval
    assert found == pytest.approx((low, high), abs=5e-5)


@given(st.integers(1, 10_000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_wilsons_interval_solves_the_score_equation(counts: tuple[int, int]) -> None:
    found = Proportion(*counts)
    mirrored = Proportion(found.runs - found.successes, found.runs).interval
    assert found.interval == pytest.approx((1.0 - mirrored[1], 1.0 - mirrored[0]))
    for p in found.interval:
        if 0.0 < p < 1.0:
            z = (found.rate - p) / math.sqrt(p * (1.0 - p) / found.runs)
            assert abs(z) == pytest.approx(1.959964, rel=1e-5)
    assert found.interval[0] <= found.rate <= found.interval[1]


@given(st.integers(0, 40), st.integers(0, 40))
def test_the_sign_tests_probability_is_that_of_counting(one: int, other: int) -> None:
    n = one + other
    uneven = [k for k in range(n + 1) if abs(2 * k - n) >= abs(one - other)]
    assert sign_test(one, other) == pytest.approx(sum(comb(n, k) for k in uneven) / 2**n)


def test_quantiles_leave_out_unknown_values() -> None:
    values = np.array([math.nan, *range(11), math.nan], dtype=float)
    assert Quantiles.of(values) == Quantiles(0.0, 1.0, 5.0, 9.0, 10.0)
    assert math.isnan(Quantiles.of(np.array([math.nan])).median)


def test_the_summary_agrees_with_the_rows(results: rho.Results) -> None:
    pytest.importorskip("pandas")
    frame = results.frame()
    assert len(frame) == len(results) == len(small(5))
    assert not frame["verified"].all()
    for group in results.groups:
        rows = frame[(frame["scenario"] == group.scenario) & (frame["method"] == group.method)]
        good = rows[rows["verified"]]
        assert (group.success.successes, group.success.runs) == (len(good), len(rows))
        assert group.cost.median == pytest.approx(good["cost"].median())
        assert group.seconds.greatest == rows["plan_seconds"].max()
    bad = frame[~frame["verified"]]
    assert sum(each.runs for each in results.failures) == len(bad) > 0
    assert {each.status for each in results.failures} == {"infeasible"}


def test_methods_are_compared_on_the_same_runs(results: rho.Results) -> None:
    pytest.importorskip("pandas")
    frame = results.frame().set_index(["scenario", "repetition"]).sort_index()
    one, base = (frame[frame["method"] == name] for name in ("convex", "best"))
    both = one["verified"] & base["verified"]
    ratios = (one["cost"] / base["cost"])[both]
    (*_, found) = results.comparisons
    assert (found.scenario, found.method, found.base) == ("", "convex", "best")
    assert found.both == both.sum() > 0
    assert found.both + found.only_method + found.only_base + found.neither == len(one)
    assert found.cost_ratio.median == pytest.approx(ratios.median())
    assert found.costlier == (ratios > 1.0 + 1e-6).sum() > 0
    back = results.compare("best", "convex")
    assert back is not None
    assert (back.cheaper, back.costlier) == (found.costlier, found.cheaper)
    assert back.cost_ratio.least == pytest.approx(1.0 / found.cost_ratio.greatest)
    with pytest.raises(ValueError, match="method: got 'worst', expected one of best, convex"):
        results.compare("worst", "best")


def test_exports_hold_every_row(results: rho.Results, tmp_path: Path) -> None:
    pd = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    results.export(tmp_path / "runs.csv")
    results.export(tmp_path / "runs.parquet")
    with (tmp_path / "runs.csv").open(encoding="utf-8", newline="") as file:
        head, *rows = csv.reader(file)
    kept = table(results.path, COLUMNS)
    assert tuple(head) == COLUMNS
    assert sorted(rows) == sorted(["" if v is None else str(v) for v in row] for row in kept)
    frame = pd.read_parquet(tmp_path / "runs.parquet")
    pd.testing.assert_frame_equal(frame, results.frame())
    with pytest.raises(ValueError, match=r"expected the ending \.csv or \.parquet"):
        results.export(tmp_path / "runs.xlsx")
    assert not (tmp_path / "runs.xlsx").exists()


def test_rows_are_records(results: rho.Results) -> None:
    rows = [dataclasses.astuple(row) for row in results.rows()]
    assert sorted(rows) == sorted(table(results.path, COLUMNS))
    assert {type(row.verified) for row in results.rows()} == {bool}


def test_plans_are_read_back(results: rho.Results) -> None:
    for key, status, cost in table(results.path, ("key", "status", "cost")):
        if status == "solved":
            plan = results.plan(key)
            assert isinstance(plan, rho.Plan)
            assert plan.cost == cost
        else:
            with pytest.raises(StoreError, match="no plan of run"):
                results.plan(key)


def test_the_summary_is_lossless_json(results: rho.Results) -> None:
    text = json.dumps(results.to_json(), allow_nan=False)
    content = json.loads(text)
    assert content["runs"] == len(results)
    for reported, group in zip(content["groups"], results.groups, strict=True):
        assert reported["success"] == {
            "successes": group.success.successes,
            "runs": group.success.runs,
        }
        assert reported["interval_95"] == list(group.success.interval)


def test_tables_name_sources_and_methods(results: rho.Results) -> None:
    text = str(results)
    for word in ("pair", "past", "best", "convex", "infeasible", "convex / best"):
        assert word in text
    assert all(line == line.rstrip() for line in text.splitlines())


def test_reasons_are_given_in_full() -> None:
    reason = " ".join(f"vehicle-{number} and all of its neighbours;" for number in range(40))
    failures = [Failure("best", "infeasible", reason, 3), Failure("other", "error", "", 12)]
    *_, reported = tables("runs", (), failures, ()).split("\n\n")
    head, *lines = reported.splitlines()
    place = head.index("most often because")
    assert " ".join(line[place:] for line in lines[:-1]) == reason
    assert lines[0][:place].split() == ["best", "infeasible", "3"]
    assert lines[-1].split() == ["other", "error", "12"]
    assert max(map(len, lines)) <= 100


def test_figures_show_the_numbers(results: rho.Results) -> None:
    (success,) = success_figure(results).axes
    containers: Any = success.containers
    shown = {
        (container.get_label(), float(x))
        for container in containers
        for x in container.lines[0].get_xdata()
    }
    assert shown == {(each.method, 100.0 * each.success.rate) for each in results.groups}
    (times,) = times_figure(results).axes
    for line, method in zip(times.lines, results.methods, strict=True):
        rate = 100.0 * len(results.seconds_of(method)) / results.runs_of(method)
        assert float(np.max(np.asarray(line.get_ydata()))) == pytest.approx(rate)
    (costs,) = costs_figure(results).axes
    ratios = results.cost_ratios("convex", "best")
    np.testing.assert_array_equal(costs.lines[0].get_ydata(), ratios)
    (failures,) = failures_figure(results).axes
    bars: Any = failures.patches
    assert [bar.get_width() for bar in bars] == [each.runs for each in results.failures]


def test_figures_are_written(results: rho.Results, tmp_path: Path) -> None:
    paths = write_campaign_figures(results, tmp_path / "new")
    assert [path.stem for path in paths] == ["success", "times", "costs", "failures"]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in paths)


def test_a_store_without_runs_has_results(tmp_path: Path) -> None:
    def interrupt(_: object) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rho.campaign(small(), tmp_path / "runs.sqlite", progress=interrupt)
    results = rho.Results(tmp_path / "runs.sqlite")
    assert "0 runs" in str(results)
    assert results.to_json()["groups"] == []
    write_campaign_figures(results, tmp_path / "figures")


@pytest.mark.parametrize("span", [1.002, 1.2, 1.9, 2.1, 5.0, 19.0, 30.0, 300.0, 1e4, 1e6])
def test_the_axis_of_cost_ratios_has_few_ticks_and_no_double_ones(span: float) -> None:
    ax = Figure().add_subplot()
    ax.set_yscale("log")
    ax.set_ylim(0.93, 0.93 * span)
    ax.yaxis.set_major_locator(_few_ticks(span))
    ticks = [tick for tick in ax.get_yticks() if 0.93 <= tick <= 0.93 * span]
    assert 2 <= len(ticks) <= 11
    assert len({f"{tick:.4g}" for tick in ticks}) == len(ticks)


def test_windows_become_lighter_in_figures_and_have_no_hue_beside_coloured_vehicles() -> None:
    luminances = [np.dot([0.299, 0.587, 0.114], to_rgb(each)) for each in window_colours(12)]
    assert np.all(np.diff(luminances) > 0.02)
    greys = [to_rgb(colour) for colour in window_greys(12)]
    assert all(max(grey) - min(grey) < 1e-6 for grey in greys)
    assert np.all(np.diff([grey[0] for grey in greys]) > 0.0)
    hues = [to_rgb(colour) for colour in vehicle_colours(MAX_NAMED)]
    assert all(max(colour) - min(colour) > 0.1 for colour in hues)
