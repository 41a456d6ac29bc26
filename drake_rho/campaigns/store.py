"""Store of a campaign: an SQLite file with a row for every finished run.

Only the campaign's process writes. With write-ahead logging a row is safe once its transaction has
ended, however the process ends, and other processes can read meanwhile.
"""

from __future__ import annotations

import dataclasses
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple, Self

from drake_rho.campaigns.runs import Done, Row, package_version
from drake_rho.campaigns.study import Study, continues, study_to_json
from drake_rho.scenario.errors import DrakeRhoError, shorten, shortened
from drake_rho.system.files import check_readable, reason_of

_APPLICATION = 0x72686F31
"""Application identifier of the SQLite file: 'rho1'."""

FORMAT = 5
"""Version of the tables' format, in the file's `user_version`."""

_PATIENCE = 30.0
"""Longest wait for another writing process [s]."""

_LARGEST = 1 << 40
"""Largest size of a store [bytes]."""

COLUMNS = tuple(field.name for field in dataclasses.fields(Row))
"""Columns of the table `runs`."""

_SHOWN = 100
"""Number of characters of a damaged value that an error message shows."""


class _Column(NamedTuple):
    """Type of the values of a column."""

    sql: str
    """type in SQL"""
    test: str
    """SQL condition for damaged values of the column {0}"""
    expected: str
    """description of valid values"""


_TYPES = {
    "str": _Column(
        "TEXT",
        "typeof({0}) <> 'text' OR length({0}) > 100000",
        "text of at most 100000 characters",
    ),
    "int": _Column(
        "INTEGER",
        "typeof({0}) <> 'integer' OR {0} < 0 OR {0} > 1000000000",
        "a whole number from 0",
    ),
    "bool": _Column("INTEGER", "typeof({0}) <> 'integer' OR {0} NOT IN (0, 1)", "0 or 1"),
    "float": _Column("REAL", "typeof({0}) NOT IN ('real', 'integer')", "a number"),
}
_OPTIONAL = {field.name for field in dataclasses.fields(Row) if field.default is None}
_TYPE_OF = {
    field.name: _TYPES[str(field.type).removesuffix(" | None")] for field in dataclasses.fields(Row)
}
_WRONG = {
    name: f"({kind.test})".format(name) + (f" AND {name} IS NOT NULL" if name in _OPTIONAL else "")
    for name, kind in _TYPE_OF.items()
}
"""SQL conditions for damaged values, by column."""
_COLUMNS = ", ".join(
    f"{name} {kind.sql}"
    + ("" if name in _OPTIONAL else " NOT NULL")
    + (" PRIMARY KEY" if name == "key" else "")
    for name, kind in _TYPE_OF.items()
)
_TABLES = {
    "runs": f"CREATE TABLE runs ({_COLUMNS})",
    "plans": "CREATE TABLE plans (key TEXT PRIMARY KEY, content BLOB NOT NULL)",
    "study": "CREATE TABLE study (study TEXT NOT NULL, version TEXT NOT NULL)",
}
"""Tables of a store. Any other definition may hide a view that never ends."""


class StoreError(DrakeRhoError, ValueError):
    """File that is not a store, belongs to another study or version, or is not accessible."""


class Store:
    """Open store of a campaign, closed by its `with` block.

    Args:
        path: path of the file, created if it does not exist.
        study: study of the store, with the contents of scenario files.

    Raises:
        StoreError: the file is not a store, or that of another study or package version.
    """

    def __init__(self, path: str | Path, study: Study) -> None:
        self.path = Path(path)
        if self.path.exists():
            _check_file(self.path)
        with _told(self.path):
            self._connection = sqlite3.connect(self.path, timeout=_PATIENCE, isolation_level=None)
            try:
                self._begin(study_to_json(study))
            except BaseException:
                self._connection.close()
                raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._connection.close()

    def keys(self) -> set[str]:
        """Return the keys of the finished runs."""
        with _told(self.path):
            return {key for (key,) in self._connection.execute("SELECT key FROM runs")}

    def failures(self) -> int:
        """Return the number of runs that were not solved or violate a constraint."""
        with _told(self.path):
            (count,) = self._connection.execute(
                "SELECT count(*) FROM runs WHERE NOT verified"
            ).fetchone()
        return int(count)

    def write(self, done: Sequence[Done]) -> None:
        """Add finished runs, all or none of them; runs already in the store stay unchanged.

        Raises:
            StoreError: the file cannot be written, as on a full disk.
        """
        marks = ", ".join("?" * len(COLUMNS))
        rows = [tuple(getattr(each.row, name) for name in COLUMNS) for each in done]
        plans = [(each.row.key, each.plan) for each in done if each.plan is not None]
        with _told(self.path), self._transaction():
            self._connection.executemany(f"INSERT OR IGNORE INTO runs VALUES ({marks})", rows)  # noqa: S608
            self._connection.executemany("INSERT OR IGNORE INTO plans VALUES (?, ?)", plans)

    def _begin(self, study: str) -> None:
        """Create the tables, or check that they belong to the study or one that it extends."""
        if not _is_empty(self._connection):  # nothing is written to a foreign file
            check_format(self._connection, self.path)
        self._connection.execute("PRAGMA journal_mode = WAL")
        self._connection.execute("PRAGMA synchronous = NORMAL")
        with self._transaction():
            if _is_empty(self._connection):
                self._make_tables()
            found = self._connection.execute("SELECT study, version FROM study").fetchone()
            if found is not None:
                self._check_continues(study, *found)
            self._connection.execute("DELETE FROM study")
            self._connection.execute("INSERT INTO study VALUES (?, ?)", (study, package_version()))

    def _make_tables(self) -> None:
        for text in _TABLES.values():
            self._connection.execute(text)
        self._connection.execute(f"PRAGMA application_id = {_APPLICATION}")
        self._connection.execute(f"PRAGMA user_version = {FORMAT}")

    def _check_continues(self, study: str, stored: str, version: str) -> None:
        if version != package_version():
            raise StoreError(
                f"{self.path}: got a store of drake_rho {version}, expected one of "
                f"{package_version()}: results of different versions are not comparable"
            )
        try:
            is_continued = continues(study, stored)
        except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
            expected = "the study of its runs"
            raise StoreError(f"{self.path}: got a damaged study, expected {expected}") from None
        if not is_continued:
            raise StoreError(
                f"{self.path}: got the store of another study, expected one of this study, or of "
                "it with fewer repetitions, scenarios or methods"
            )

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        self._connection.execute("BEGIN IMMEDIATE")
        try:
            yield
            self._connection.execute("COMMIT")
        except BaseException:
            if self._connection.in_transaction:
                self._connection.execute("ROLLBACK")
            raise


@contextmanager
def reading(path: str | Path) -> Iterator[sqlite3.Connection]:
    """Open a store for reading, also while a campaign writes to it.

    Raises:
        StoreError: there is no such file, or it is not a store.
    """
    path = Path(path)
    with _told(path):
        _check_file(path)
        # mode=ro would leave log files behind; mode=rw opens write-protected files as well
        connection = sqlite3.connect(
            f"{path.resolve().as_uri()}?mode=rw", timeout=_PATIENCE, uri=True
        )
        try:
            connection.execute("PRAGMA query_only = 1")
            check_format(connection, path)
            yield connection
        finally:
            connection.close()


def _check_file(path: Path) -> None:
    """Check that there is a regular file."""
    try:
        check_readable(path, _LARGEST)
    except (OSError, ValueError) as error:
        absent = isinstance(error, FileNotFoundError | ValueError)
        given = "no such file" if absent else reason_of(error)
        raise StoreError(f"{path}: got {given}, expected the store of a campaign") from None


def check_format(connection: sqlite3.Connection, path: Path) -> None:
    """Check that a file is a store of this version's format.

    Raises:
        StoreError: the file is not one.
    """
    connection.execute("PRAGMA trusted_schema = 0")
    (application,) = connection.execute("PRAGMA application_id").fetchone()
    (number,) = connection.execute("PRAGMA user_version").fetchone()
    if application != _APPLICATION:
        raise StoreError(f"{path}: got another SQLite file, expected the store of a campaign")
    if number != FORMAT:
        raise StoreError(f"{path}: got a store of format {number}, expected format {FORMAT}")
    found = connection.execute("SELECT type, name, sql FROM sqlite_master").fetchall()
    tables = {name: sql for _, name, sql in found if name in _TABLES}
    if tables != _TABLES or any(kind in ("view", "trigger") for kind, *_ in found):
        expected = f"the tables {', '.join(_TABLES)} of the store of a campaign, and no others"
        raise StoreError(f"{path}: got other tables or views, expected {expected}")


def check_rows(connection: sqlite3.Connection, path: Path) -> None:
    """Check that all values of runs match the types of their columns and are not too long.

    Raises:
        StoreError: a value is wrong; the error names its row and column.
    """
    wrong = " OR ".join(_WRONG.values())
    row = connection.execute(f"SELECT rowid FROM runs WHERE {wrong} LIMIT 1").fetchone()  # noqa: S608
    if row is None:
        return
    tests = ", ".join(f"({test})" for test in _WRONG.values())
    (found,) = connection.execute(f"SELECT {tests} FROM runs WHERE rowid = ?", row)  # noqa: S608
    name = next(name for name, is_wrong in zip(_WRONG, found, strict=True) if is_wrong)
    query = f"SELECT substr({name}, 1, {_SHOWN}) FROM runs WHERE rowid = ?"  # noqa: S608
    (value,) = connection.execute(query, row).fetchone()
    given = f"{shorten(value)} as the {name} of run {row[0]}"
    raise StoreError(f"{path}: got {given}, expected {_TYPE_OF[name].expected}")


def _is_empty(connection: sqlite3.Connection) -> bool:
    (tables,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    (application,) = connection.execute("PRAGMA application_id").fetchone()
    return bool(tables == 0 and application == 0)


@contextmanager
def _told(path: Path) -> Iterator[None]:
    """Raise SQLite errors as `StoreError`."""
    try:
        yield
    except sqlite3.Error as error:
        expected = "a file that SQLite can read and write; earlier runs are kept"
        raise StoreError(f"{path}: {shortened(str(error))}; expected {expected}") from None
