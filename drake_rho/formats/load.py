"""`load_trajectories`: read the trajectories of any planner from the files of other programs."""

from __future__ import annotations

import reprlib
from pathlib import Path

from drake_rho.formats.export import FORMATS
from drake_rho.formats.folders import file_names
from drake_rho.formats.format import Format
from drake_rho.motion.files import PlanFileError
from drake_rho.motion.polynomials import Polynomials
from drake_rho.motion.trajectories import Trajectories
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.records import Scenario
from drake_rho.system.files import LARGEST_TEXT, read_bytes, reason_of

_LONGEST_NAME = 80
"""Characters of the longest name that a vehicle of a scenario may have."""


@checked
def load_trajectories(
    path: str | Path, scenario: Scenario | None = None, *, max_acceleration: float | None = None
) -> Trajectories:
    """Read the trajectories of any planner, which `rho.verify(trajectories, scenario)` verifies.

    Files are recognised by their content:

    - polynomials of Crazyswarm (degree 7, with durations), one file for each vehicle;
    - compiled shows of Skybrush (.skyc), of all vehicles;
    - tables of positions with columns time, x, y and z (CSV), of all vehicles with a column vehicle
      or of one, with or without names of columns: those of `rho.export` and of Skybrush as well.

    Args:
        path: path of a file, or of a folder with a file for each vehicle, named after it.
        scenario: scenario of the vehicles. It tells which vehicle a file named after it is of, and
            when polynomials begin that have durations only: without it, at 0.
        max_acceleration: bound on the norm of the acceleration between samples [m/s²]; required for
            tables, not allowed for polynomials.

    Raises:
        PlanFileError: a file cannot be read, is of no known format, or is damaged; or a vehicle is
            in two files.
        ValueError: the bound is missing, not allowed, or not positive.

    Examples:
        >>> plan = rho.plan(rho.load_scenario("paper"))
        >>> folder_of_csv = rho.export(plan, folder / "paper", format="crazyswarm").path
        >>> found = rho.load_trajectories(folder_of_csv, plan.scenario)
        >>> found
        <Trajectories of 4 vehicles from 0 to 49 s, 124 pieces>
        >>> rho.verify(found, plan.scenario).ok
        True
    """
    motions = dict[str, Polynomials]()
    formats = set[Format]()
    for file in _files(Path(path)):
        form, found = _read(file)
        formats.add(form)
        if form.from_zero and scenario is not None:
            begin = scenario.grid.start - scenario.lead
            found = {name: each.delayed(begin) for name, each in found.items()}
        if twice := found.keys() & motions.keys():
            again = reprlib.repr(min(twice))
            raise PlanFileError(f"{file}: got {again} again, expected each vehicle once")
        motions |= found
    motions = _named_as(motions, scenario)
    for name in motions:
        if len(name) > _LONGEST_NAME:
            expected = f"a name of at most {_LONGEST_NAME} characters"
            raise PlanFileError(f"{path}: vehicle: got {reprlib.repr(name)}, expected {expected}")
    sampled = {form.rated for form in formats}
    if len(sampled) > 1:
        raise PlanFileError(f"{path}: got polynomials and samples, expected one of them")
    if sampled == {True} and max_acceleration is None:
        expected = f"a bound between the samples of {path} [m/s²]"
        raise ValueError(f"max_acceleration: got None, expected {expected}")
    if sampled == {False} and max_acceleration is not None:
        expected = f"None: {path} holds polynomials, not samples"
        raise ValueError(f"max_acceleration: got {max_acceleration:g}, expected {expected}")
    try:
        return Trajectories(motions, max_acceleration)
    except ValueError as error:
        raise PlanFileError(f"{path}: {error}") from None


def _files(path: Path) -> list[Path]:
    """Return the files to read: one, or all of a folder but hidden ones.

    Raises:
        PlanFileError: the folder is empty, has a link to a file outside, or cannot be read.
    """
    try:
        if not path.is_dir():
            return [path]
        files = sorted(each for each in path.iterdir() if not each.name.startswith("."))
        inside = path.resolve()
        outside = [each for each in files if each.resolve().parent != inside]
    except (OSError, ValueError) as error:  # ValueError for a path with a null character
        raise PlanFileError(f"{path}: {reason_of(error)}") from None
    if outside:
        raise PlanFileError(f"{outside[0]}: got a link to a file outside its folder")
    if not files:
        raise PlanFileError(f"{path}: got an empty folder, expected a file for each vehicle")
    return files


def _read(file: Path) -> tuple[Format, dict[str, Polynomials]]:
    """Return the format of a file and the motions in it.

    Raises:
        PlanFileError: it cannot be read, is of no known format, or is damaged.
    """
    readers = [each for each in FORMATS.values() if each.reads]
    try:
        content = read_bytes(file, LARGEST_TEXT)
        form = next((each for each in readers if each.recognises(content)), None)
        if form is not None:
            return form, dict(form.read(content, file.stem))
    except (OSError, ValueError) as error:
        raise PlanFileError(f"{file}: {reason_of(error)}") from None
    expected = ", or ".join(each.reads for each in readers)
    raise PlanFileError(f"{file}: got no trajectories, expected {expected}")


def _named_as(motions: dict[str, Polynomials], scenario: Scenario | None) -> dict[str, Polynomials]:
    """Return motions by the vehicles' names, whose files may have other characters in theirs."""
    if scenario is None:
        return motions
    if len(motions) == len(scenario.names) == 1:
        return dict(zip(scenario.names, motions.values(), strict=True))
    names = dict(zip(file_names(scenario.names, ""), scenario.names, strict=True))
    return {
        name if name in scenario.names else names.get(name, name): each
        for name, each in motions.items()
    }
