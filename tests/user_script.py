"""Script as a user would write it: `make lint` checks it with `mypy --strict`, a test runs it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import drake_rho as rho


def mission(side: float) -> rho.Scenario:
    box = rho.Box([side / 3, -1.0, 0.0], [side / 2, 1.0, 3.0])
    start, goal = rho.State([0.0, 0.0, 1.0]), rho.State([side, 0.0, 1.0])
    return rho.Scenario(
        "mine",
        rho.Grid.lasting(12.0, step=0.25),
        [rho.Vehicle("scout", start, goal, radius=0.3)],
        limits=rho.Limits(max_speed=4.0, max_acceleration=3.0),
        obstacles=[box],
        disturbance=rho.Disturbance(acceleration=0.2),
    )


def gust(time: float, positions: np.ndarray, velocities: np.ndarray) -> np.ndarray:
    return np.full_like(positions, 0.1) if time > 2.0 else np.zeros_like(positions)


def main(folder: Path) -> None:
    scenario = mission(20.0)
    try:
        plan: rho.Plan = rho.plan(scenario, options=rho.Options(tolerance=1e-4))
    except rho.InfeasibleError as error:
        print(error, rho.diagnose(scenario).shortest_duration)
        return
    report = rho.verify(plan)
    clearance = report.clearance
    assert clearance is not None
    print(report, clearance.value + clearance.left, report.summary.top_speed)
    samples = plan.at([0.0, 1.0, 2.0], vehicle="scout")
    print(samples.positions.shape, samples.columns()["x [m]"])
    flown = rho.simulate(plan, wind=gust)
    print(rho.verify(flown).ok, flown.errors().max())
    rho.save(plan, folder / "plan.npz")
    loaded = rho.load(folder / "plan.npz")
    rho.save_figure(rho.paths_figure(loaded), folder / "paths.png")
    for row in rho.verify(loaded).checks:
        print(row.what, row.left, row.unit)
    (folder / "page.html").write_text(rho.viewer_page(plan))


if __name__ == "__main__":
    main(Path())
