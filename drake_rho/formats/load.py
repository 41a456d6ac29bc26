"""`load_trajectories`: read the trajectories of any planner from the files of other programs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from itertools import chain
from pathlib import Path

from drake_rho.formats.archives import is_archive, names_in, open_archive
from drake_rho.formats.bags import ZSTD
from drake_rho.formats.export import FORMATS
from drake_rho.formats.folders import file_names
from drake_rho.formats.mcap import ros_names
from drake_rho.formats.reader import Reader, naming
from drake_rho.formats.skyc import SHOW
from drake_rho.formats.ulog import ULog
from drake_rho.motion.documents import is_exported
from drake_rho.motion.files import PlanFileError
from drake_rho.motion.polynomials import Polynomials
from drake_rho.motion.trajectories import Trajectories
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.errors import shorten
from drake_rho.scenario.records import Scenario
from drake_rho.system.files import LARGEST_TEXT, read_bytes, reason_of

READERS: tuple[Reader, ...] = (
    FORMATS["skybrush"],  # whose tables are tables of positions too
    *(each for each in FORMATS.values() if each.reads and each.name != "skybrush"),
    ULog(),
)
"""Formats that are read, the first that recognises a file counts."""
_PACKED = {
    ZSTD: "zstd",
    b"\x04\x22\x4d\x18": "lz4",
    b"\x1f\x8b": "gzip",
    b"\xfd7zXZ": "xz",
    b"BZh": "bzip2",
}
"""Ways of compression by the beginnings of files."""
_METADATA = "metadata.yaml"
"""File of a rosbag2 that says nothing but what its other files hold."""
_LONGEST_NAME = 80
"""Characters of the longest name that a vehicle of a scenario may have."""


@checked
def load_trajectories(
    path: str | Path,
    scenario: Scenario | None = None,
    *,
    max_acceleration: float | None = None,
    topics: Mapping[str, str] | None = None,
) -> Trajectories:
    """Read the trajectories of any planner, which `rho.verify(trajectories, scenario)` verifies.

    Files are recognised by their content:

    - polynomials of Crazyswarm (degree 7, with durations), one file for each vehicle;
    - compiled shows of Skybrush (.skyc), of all vehicles;
    - tables of positions with columns time, x, y and z (CSV), of all vehicles with a column vehicle
      or of one, with or without names of columns: those of `rho.export` and of Skybrush as well,
      whose times count from the beginning;
    - logs of ROS 2 (MCAP, or SQLite of rosbag2; extra `ros`) with positions in the messages
      Odometry, PoseStamped, TFMessage, MultiDOFJointTrajectory or Path, of vehicles named after
      the topic's namespace, or after the child frame;
    - a log of PX4 (ULog), of one vehicle named after the file, in axes east, north and up.

    Args:
        path: path of a file, or of a folder or an archive (zip) with a file for each vehicle, named
            after it, or of a rosbag2, of which other files are left out.
        scenario: scenario of the vehicles. It tells which vehicle a file named after it is of, and
            when trajectories begin whose times count from their beginning, as those of polynomials,
            shows and logs: without it, at 0. They may end later than the scenario by the rounding
            of times in the file, at most a millisecond.
        max_acceleration: bound on the norm of the acceleration between samples [m/s²]; required for
            tables and logs, not allowed for polynomials.
        topics: topic or child frame of each vehicle, for logs of ROS 2; those without are left out.

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
    motions, formats = dict[str, Polynomials](), _recognised(_files(Path(path)))
    for form, contents in formats.items():
        try:
            found = dict(form.read_all(contents, topics))
        except PlanFileError:
            raise
        except ValueError as error:
            raise PlanFileError(f"{path}: {error}") from None
        if form.from_zero and scenario is not None:
            begin = scenario.grid.start - scenario.lead
            found = {name: each.delayed(begin) for name, each in found.items()}
        if twice := found.keys() & motions.keys():
            raise PlanFileError(
                f"{path}: got {shorten(min(twice))} again, expected each vehicle once"
            )
        motions |= found
    motions = _named_as(motions, scenario)
    for name in motions:
        if len(name) > _LONGEST_NAME:
            expected = f"a name of at most {_LONGEST_NAME} characters"
            raise PlanFileError(f"{path}: vehicle: got {shorten(name)}, expected {expected}")
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
        tick = max(form.tick for form in formats)
        return Trajectories(motions, max_acceleration, scenario, tick)
    except ValueError as error:
        raise PlanFileError(f"{path}: {error}") from None


def holds_trajectories(path: str | Path) -> bool:
    """Return whether a file or folder is of a format that `load_trajectories` reads."""
    with suppress(PlanFileError):
        return bool(_recognised(_files(Path(path))))
    return False


def _files(path: Path) -> list[Path]:
    """Return the files to read: one, or all of a folder but hidden ones and metadata.

    Raises:
        PlanFileError: the folder is empty, has a link to a file outside, or cannot be read.
    """
    try:
        if not path.is_dir():
            return [path]
        files = sorted(
            each
            for each in path.iterdir()
            if not each.name.startswith(".") and each.name != _METADATA
        )
        inside = path.resolve()
        outside = [each for each in files if each.resolve().parent != inside]
    except (OSError, ValueError) as error:  # ValueError for a path with a null character
        raise PlanFileError(f"{path}: {reason_of(error)}") from None
    if outside:
        raise PlanFileError(f"{outside[0]}: got a link to a file outside its folder")
    if not files:
        raise PlanFileError(f"{path}: got an empty folder, expected a file for each vehicle")
    return files


def _recognised(files: list[Path]) -> dict[Reader, dict[Path, bytes]]:
    """Return the contents of files by their formats; beside bags, other files are left out.

    Raises:
        PlanFileError: a file cannot be read, or is of no known format.
    """
    found, other = dict[Reader, dict[Path, bytes]](), None
    for file, content in chain.from_iterable(map(_contents, files)):
        form = next((each for each in READERS if each.recognises(content)), None)
        if form is not None:
            found.setdefault(form, {})[file] = content
            continue
        if way := next((_PACKED[each] for each in _PACKED if content.startswith(each)), None):
            got = f"got a whole file compressed by {way}, as bags can be"
            raise PlanFileError(f"{file}: {got}, expected it decompressed")
        other = other or file
    if other is not None and FORMATS["mcap"] not in found:
        expected = ", or ".join(each.reads for each in READERS)
        raise PlanFileError(f"{other}: got no trajectories, expected {expected}")
    return found


def _contents(path: Path) -> Iterator[tuple[Path, bytes]]:
    """Yield the path and the content of a file, or of each file in an archive that is no show.

    Raises:
        PlanFileError: the file cannot be read, or is a result of this package.
    """
    with naming(path):
        content = read_bytes(path, LARGEST_TEXT)
        names = names_in(content)
        if all(name.endswith(".npy") for name in names) if names else _is_exported(content):
            got = "got a saved result, which has its own scenario"
            raise ValueError(f"{got}, expected trajectories of another program; rho.load reads it")
        if not names or SHOW in names:
            yield path, content
            return
        with open_archive(content, "an archive of tables") as archive:
            for name in names:
                inner = archive.read(name)
                if not name.isprintable() or is_archive(inner):
                    expected = "tables, one of each vehicle"
                    raise ValueError(f"got {shorten(name)} in the archive, expected {expected}")
                yield path / name, inner


def _is_exported(content: bytes) -> bool:
    """Return whether a content is a plan that was exported as JSON."""
    return content.lstrip().startswith(b"{") and is_exported(content.decode(errors="replace"))


def _named_as(motions: dict[str, Polynomials], scenario: Scenario | None) -> dict[str, Polynomials]:
    """Return motions by the vehicles' names, whose files may have other characters in theirs."""
    if scenario is None:
        return motions
    if len(motions) == len(scenario.names) == 1:
        return dict(zip(scenario.names, motions.values(), strict=True))
    names = dict(zip(ros_names(scenario.names), scenario.names, strict=True))
    names |= zip(file_names(scenario.names, ""), scenario.names, strict=True)
    return {
        name if name in scenario.names else names.get(name, name): each
        for name, each in motions.items()
    }
