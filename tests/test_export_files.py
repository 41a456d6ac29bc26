"""Exports as files: names, atomic writing, and refusal before any work."""

from __future__ import annotations

import contextlib
import csv
import io
import re
import stat
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import drake_rho as rho
from drake_rho.formats import crazyswarm, states
from drake_rho.formats import folders as folder_files
from drake_rho.formats.folders import file_names, write_folder
from drake_rho.system.folders import exchanged
from tests.scenarios import straight
from tests.test_cli import run
from tests.test_names import NAMES

FOLDERS = ("crazyswarm", "skybrush")
ALL = {
    "csv": "x.csv",
    "json": "x.json",
    "crazyswarm": "x",
    "skybrush": "x.zip",
    "px4": "x.csv",
    "skyc": "x.skyc",
    "mcap": "x.mcap",
}
ODD = [*NAMES, "A", "a-2", " ", "...", "\N{GRINNING FACE}", "飛行機" * 26, "\\..\\x", 'q",;']


@pytest.fixture(scope="module")
def plan() -> rho.Plan:
    """Return the plan of two vehicles."""
    return straight(2)


def test_every_name_becomes_a_distinct_file_name() -> None:
    found = file_names(ODD, ".csv")
    assert len({name.casefold() for name in found}) == len(ODD)
    for name in found:
        assert Path(name).name == name
        assert not name.startswith(".")
        assert len(name.encode()) < 255
        assert not set(name) & set('<>:"/\\|?*\n;,')
    assert file_names(["UAV-1", "scout 2", "é"], ".csv") == ["UAV-1.csv", "scout 2.csv", "é.csv"]
    assert file_names(["a/b", "a_b", "A_B"], "") == ["a_b", "a_b-2", "A_B-3"]


@pytest.mark.parametrize("format", FOLDERS)
def test_every_vehicle_of_any_name_has_its_file(format: str, tmp_path: Path) -> None:
    plan = straight(len(ODD), ODD)
    written = rho.export(plan, tmp_path / "out", format=format)
    assert [file.parent for file in written.files] == [tmp_path / "out"] * len(ODD)
    assert {each.name for each in (tmp_path / "out").iterdir()} == {f.name for f in written.files}
    assert [each.name for each in tmp_path.iterdir()] == ["out"]
    columns = [1, 2, 3] if format == "skybrush" else [1, 9, 17]
    for number, file in enumerate(written.files):  # in the order of the vehicles
        first = np.loadtxt(file, delimiter=",", skiprows=1, max_rows=1)
        np.testing.assert_array_equal(first[columns], plan.positions[number, 0])


@pytest.mark.parametrize("format", ["csv", "json", "px4"])
def test_names_are_quoted_as_text_in_tables(format: str, tmp_path: Path) -> None:
    plan = straight(len(ODD), ODD)
    path = tmp_path / ALL[format]
    rho.export(plan, path, format=format)
    if format == "px4":
        with open(path, encoding="utf-8", newline="") as file:
            rows = [row["vehicle"] for row in csv.DictReader(file)]
        assert rows[: len(ODD)] == ODD
    else:
        loaded = rho.load(path, scenario=plan.scenario if format == "csv" else None)
        assert [vehicle.name for vehicle in loaded.scenario.vehicles] == ODD
        assert isinstance(loaded, rho.Plan)
        np.testing.assert_array_equal(loaded.positions, plan.positions)


@pytest.mark.parametrize("format", FOLDERS)
def test_a_folder_of_an_earlier_export_is_replaced(
    format: str, plan: rho.Plan, tmp_path: Path
) -> None:
    folder = tmp_path / "out"
    written = rho.export(plan, folder, format=format)
    before = [file.read_bytes() for file in written.files]
    written.files[0].write_text("old")
    folder.chmod(0o750)
    rho.export(plan, folder, format=format)
    assert [file.read_bytes() for file in written.files] == before
    assert stat.S_IMODE(folder.stat().st_mode) == 0o750
    (tmp_path / "empty").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "empty")
    rho.export(plan, tmp_path / "link", format=format)
    assert (tmp_path / "link").is_symlink()
    assert len(list((tmp_path / "empty").iterdir())) == 2
    assert {each.name for each in tmp_path.iterdir()} == {"out", "empty", "link"}


@pytest.mark.parametrize("format", FOLDERS)
def test_other_files_are_never_lost(format: str, plan: rho.Plan, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / "thesis.csv").write_text("years of work")
    with pytest.raises(ValueError, match=r"path: got .* with 'thesis\.csv' in it, expected"):
        rho.export(plan, folder, format=format)
    assert (folder / "thesis.csv").read_text() == "years of work"
    assert [each.name for each in folder.iterdir()] == ["thesis.csv"]
    assert [each.name for each in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize("old", [{}, {"a": b"old", "b": b"old"}])
@pytest.mark.parametrize("failing", ["write_bytes", "rename"])
def test_a_folder_is_written_whole_or_not_at_all(
    old: dict[str, bytes], failing: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "out"
    if old:
        write_folder(folder, old)
    true: Any = getattr(Path, failing)

    def fails(path: Path, *args: Any) -> Any:
        if path.name == ("b" if failing == "write_bytes" else "new"):
            raise OSError("disk full")
        return true(path, *args)

    with monkeypatch.context() as patched:
        patched.setattr(Path, failing, fails)
        patched.setattr(folder_files, "exchanged", lambda *_: False)  # as on some file systems
        with pytest.raises(OSError, match="disk full"):
            write_folder(folder, {"a": b"new", "b": b"new"})
    found = {each.name: each.read_bytes() for each in folder.iterdir()} if folder.exists() else {}
    assert found == old
    assert [each.name for each in tmp_path.iterdir()] == ["out"] * bool(old)


def test_a_folder_is_there_at_every_instant(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    write_folder(folder, {"a": b"old"})
    if not exchanged(folder, folder):
        pytest.skip("this file system cannot exchange two folders")
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Path, "rename", lambda *_: pytest.fail("a name without a folder"))
        write_folder(folder, {"a": b"new"})
    assert (folder / "a").read_bytes() == b"new"
    assert [each.name for each in tmp_path.iterdir()] == ["out"]


def test_a_file_is_written_whole_or_not_at_all(
    plan: rho.Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "x.csv").write_text("before")

    def half(file: Any, samples: object) -> None:
        file.write(b"half")
        raise OSError("disk full")

    monkeypatch.setattr(states, "write_table", half)
    with pytest.raises(OSError, match="disk full"):
        rho.export(plan, tmp_path / "x.csv", format="csv")
    assert (tmp_path / "x.csv").read_text() == "before"
    assert [each.name for each in tmp_path.iterdir()] == ["x.csv"]


REFUSED: list[tuple[str, str, float | None, str]] = [
    ("xml", "x.xml", None, "format: got 'xml', expected one of csv, json, crazyswarm, skybrush"),
    ("csv", "x.json", None, r"path: got '.*x\.json', expected a file to write, ending in \.csv"),
    ("csv", "x", None, r"expected a file to write, ending in \.csv"),
    ("json", "x.npz", None, r"expected a file to write, ending in \.json"),
    ("px4", "x.zip", None, r"expected a file to write, ending in \.csv"),
    ("crazyswarm", "x.zip", None, "expected a folder, new or of the same files"),
    ("skybrush", "x.csv", None, r"ending in \.zip, or a folder, new or of the same files"),
    ("crazyswarm", "file", None, r"expected a folder, .* \(not a folder\)"),
    ("csv", "folder.csv", None, r"expected a file to write, .* \(not a regular file\)"),
    ("csv", "nowhere/x.csv", None, r"\(No such file or directory\)"),
    ("skybrush", "nowhere/x", None, r"\(No such file or directory\)"),
    ("crazyswarm", "x", 20.0, "rate: got 20, expected none with crazyswarm"),
    ("skyc", "x.skyc", 20.0, "rate: got 20, expected none with skyc"),
    ("skyc", "x", None, r"expected a file to write, ending in \.skyc"),
    ("mcap", "x.zip", None, r"ending in \.mcap, or a folder, new or of the same files"),
    ("mcap", "nowhere/x.mcap", None, r"\(No such file or directory\)"),
    ("csv", "x.csv", 0.0, "rate: got 0, expected above 0 and up to 1000 samples a second"),
    ("px4", "x.csv", -1.0, "rate: got -1, expected above 0"),
    ("json", "x.json", float("nan"), "rate: got nan, expected above 0"),
    ("skybrush", "x.zip", 1001.0, "rate: got 1001, expected above 0 and up to 1000"),
    ("csv", "x\0.csv", None, "null"),
]


@pytest.mark.parametrize(("format", "name", "rate", "words"), REFUSED)
def test_invalid_targets_are_refused_before_any_work(
    format: str, name: str, rate: float | None, words: str, tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("kept")
    (tmp_path / "folder.csv").mkdir()
    unused = object.__new__(rho.Plan)  # it is empty: nothing may read it
    with pytest.raises(ValueError, match=words):
        rho.export(unused, tmp_path / name, format=format, rate=rate)
    assert {each.name for each in tmp_path.iterdir()} == {"file", "folder.csv"}
    assert (tmp_path / "file").read_text() == "kept"


def test_a_folder_with_other_files_is_refused_before_pieces_are_merged(
    plan: rho.Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "other").write_text("")
    monkeypatch.setattr(crazyswarm, "as_pieces", pytest.fail)
    with pytest.raises(ValueError, match="with 'other' in it"):
        rho.export(plan, tmp_path, format="crazyswarm")


def test_the_code_in_the_documents_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (Path(__file__).parent.parent / "docs" / "export.md").read_text()
    (code,) = re.findall(r"^```python\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE)
    monkeypatch.chdir(tmp_path)
    found: dict[str, Any] = {}
    with contextlib.redirect_stdout(io.StringIO()):
        exec(code, found)  # noqa: S102  # of the document
    assert {each.name for each in tmp_path.iterdir()} == {"plan.csv", "plan.json", "courier"}
    np.testing.assert_array_equal(found["again"].positions, found["plan"].positions)


@pytest.fixture
def kept(plan: rho.Plan, tmp_path: Path) -> str:
    """Write the file of a plan."""
    rho.save(plan, tmp_path / "plan.npz")
    return str(tmp_path / "plan.npz")


@pytest.mark.parametrize("format", ALL)
def test_the_command_and_the_function_write_the_same_files(
    format: str,
    plan: rho.Plan,
    kept: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (tmp_path / "one").mkdir()
    (tmp_path / "other").mkdir()
    path = tmp_path / "one" / ALL[format]
    rate = () if format in ("crazyswarm", "skyc") else ("--rate", "12.5")
    words = ("export", kept, "--format", format, "-o", str(path), *rate)
    status, out, err = run(capsys, monkeypatch, *words)
    assert (status, err) == (0, "")
    other = tmp_path / "other" / ALL[format]
    written = rho.export(plan, other, format=format, rate=12.5 if rate else None)
    words_of = out.replace(str(path), str(other)).split()  # long paths have lines of their own
    assert words_of == str(written).split()
    assert _content([path]) == _content([other])


def _content(paths: Iterable[Path]) -> list[bytes]:
    """Return all contents of files and folders."""
    whole = [sorted(path.iterdir()) if path.is_dir() else [path] for path in paths]
    return [path.read_bytes() for each in whole for path in each]


def test_an_exported_json_is_verified_and_exported_again(
    kept: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    path, again = str(tmp_path / "plan.json"), str(tmp_path / "again.json")
    for source, target in ((kept, path), (path, again)):
        words = ("export", source, "--format", "json", "-o", target)
        assert run(capsys, monkeypatch, *words)[0] == 0
    assert Path(path).read_bytes() == Path(again).read_bytes()
    checked = run(capsys, monkeypatch, "verify", path)
    assert checked == run(capsys, monkeypatch, "verify", kept)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--format", "xml", "-o", "x.xml"), "--format: got 'xml', expected one of csv, js"),
        (
            ("--format", "csv", "-o", "x.npz"),
            "--output: got 'x.npz', expected a file to write, end",
        ),
        (("--format", "csv", "-o", "x.csv", "--rate", "inf"), "--rate: got inf"),
        (("--format", "csv"), "--output"),
        (("-o", "x.csv"), "format: got none for 'x.csv', expected one of csv, px4"),
    ],
)
def test_invalid_arguments_are_refused_before_the_file_is_read(
    words: tuple[str, ...],
    expected: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    status, out, err = run(capsys, monkeypatch, "export", "missing.npz", *words)
    assert (status, out) == (2, "")
    assert expected in err
    assert err.count("\n") == 1
    assert not list(tmp_path.iterdir())
