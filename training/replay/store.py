"""Trajectories on disk: one sqlite3 file, written by a training run as it goes, or by bags_to_dataset.

The file is both the run's journal and a dataset: train.py --dataset reads that of a run, or of bags. Every trajectory
is on the disk when append() returns, and nothing is pickled. Every row has a checksum of its other columns and is read
by itself: a damaged episode is named on stderr and left out. In SQL,

    SELECT id, transitions, json_extract(info, '$.return') FROM episodes

lists the episodes of a run.
"""

from __future__ import annotations

import json
import os
import sqlite3
import sys
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Dict, Iterator, List, Optional, Set, Tuple

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import StorageError, sha256
from training.replay.trajectory import Trajectory, TrajectoryError, TransitionLayout

NAME = "replay.sqlite"  # in the folder of a run or of a dataset
VERSION = 2  # of the tables
ROW = 64  # bytes: no row is smaller, its checksum takes so many
TABLES = f"""
BEGIN;
CREATE TABLE episodes (
    id INTEGER PRIMARY KEY,
    actor TEXT NOT NULL,
    episode INTEGER NOT NULL,
    transitions INTEGER NOT NULL,
    info TEXT NOT NULL,  -- JSON
    sum TEXT NOT NULL,
    UNIQUE (actor, episode)
);
-- packed trajectories, until the buffer forgets them
CREATE TABLE arrays (id INTEGER PRIMARY KEY, data BLOB NOT NULL, sum TEXT NOT NULL);
-- JSON values: layout, source, skipped
CREATE TABLE about (name TEXT PRIMARY KEY, value TEXT NOT NULL, sum TEXT NOT NULL);
PRAGMA user_version = {VERSION};
"""


class TrajectoryStore:
    """The trajectories of a run or dataset, in the order in which they were taken.

    Args:
        path: the file, or the folder that holds it as replay.sqlite.
        layout: makes the store where it is not there yet; None only reads.

    Raises:
        StorageError: with one line, where there is no store, where it has another layout, or where it is damaged; a
            reader goes on where it can.
    """

    def __init__(self, path: os.PathLike | str, layout: Optional[TransitionLayout] = None):
        self.path = Path(path) / NAME if Path(path).is_dir() else Path(path)
        if not self.path.is_file() and (layout is None or os.path.lexists(self.path)):
            raise StorageError(f"{path}: holds no trajectories (no {NAME}); train, or make a dataset of bags, first")
        self._named: Set[str] = set()
        self._writes = layout is not None
        with self._refusals():
            address = f"{self.path.absolute().as_uri()}?mode={'rwc' if self._writes else 'ro'}"
            self._db = sqlite3.connect(address, uri=True, isolation_level=None)
            if layout is None:
                self._db.execute("PRAGMA writable_schema = ON")  # else sqlite reads nothing of a file that was cut
            else:
                self._db.execute("PRAGMA journal_mode = WAL")
                self._db.execute("PRAGMA synchronous = FULL")
                if not self._number("SELECT COUNT(*) FROM sqlite_master"):
                    self._db.executescript(TABLES)
                    self.note("layout", layout.to_dict())
                    self._db.execute("COMMIT")
            try:
                known = self._number("PRAGMA user_version") == VERSION and self.about("layout")
                self.layout = TransitionLayout.from_dict(known or {})
            except (KeyError, TypeError):
                raise StorageError(f"{self.path}: not a store of trajectories of this version; make it anew") from None
            if layout is not None and layout != self.layout:
                raise StorageError(f"{self.path}: its layout is {self.layout}, {layout} is needed")
            found = self._db.execute("PRAGMA integrity_check(1)").fetchone()[0].splitlines()[-1]
            if found != "ok" and self._writes:
                raise sqlite3.DatabaseError(found)
        if found != "ok":
            self._name(f"damaged ({found}); episodes may be missing")

    # -- writing -----------------------------------------------------------------------------------
    def append(self, trajectory: Trajectory, blob: Optional[bytes] = None) -> None:
        """Adds a trajectory that has been checked; `blob` is it packed, where that is known.

        Raises:
            TrajectoryError: the episode of that actor is there already.
            StorageError: it cannot be written.
        """
        actor, episode = trajectory.info["actor"], trajectory.info["episode"]
        number, data = self.last + 1, blob or trajectory.pack()
        row = (number, actor, episode, len(trajectory), json.dumps(trajectory.info))
        try:
            with self._refusals(), self._db:
                self._db.execute("BEGIN")
                self._db.execute("INSERT INTO episodes VALUES (?, ?, ?, ?, ?, ?)", (*row, sha256(*row)))
                self._db.execute("INSERT INTO arrays VALUES (?, ?, ?)", (number, data, sha256(number, data)))
        except sqlite3.IntegrityError:
            raise TrajectoryError(f"episode {episode} of actor {actor} came twice") from None

    def note(self, name: str, value: Any) -> None:
        """Keeps a JSON value by name: "source", what the experience was driven with, or "skipped", by reason."""
        with self._refusals():
            row = (name, json.dumps(value))
            self._db.execute("INSERT OR REPLACE INTO about VALUES (?, ?, ?)", (*row, sha256(*row)))

    def forget(self, rows: int) -> None:
        """Drops the arrays of the first episodes that together take at most so many rows of the replay buffer."""
        with self._refusals():
            self._db.execute(
                "DELETE FROM arrays WHERE id <= (SELECT MAX(id) FROM (SELECT id, SUM(transitions + 1) OVER (ORDER BY "
                "id) AS used FROM episodes) WHERE used <= ?)",
                (rows,),
            )

    def close(self) -> None:
        """Close the file; a writer leaves one that can be read from a read-only medium."""
        if self._writes:
            with suppress(sqlite3.Error):  # another process reads it
                self._db.execute("PRAGMA journal_mode = DELETE")
        self._db.close()

    # -- reading -----------------------------------------------------------------------------------
    def about(self, name: str) -> Dict[str, Any]:
        """Return what note() kept by a name; {} where it kept nothing. Raises StorageError where that is damaged."""
        with self._refusals():
            row = self._db.execute("SELECT * FROM about WHERE name = ?", (name,)).fetchone()
            if row and row[-1] != sha256(*row[:-1]):
                raise sqlite3.DatabaseError(f"the checksum of its {name} is wrong")
            return json.loads(row[1]) if row else {}

    def trajectories(self, since: int = 0, until: Optional[int] = None) -> Iterator[Tuple[int, Trajectory]]:
        """(id, trajectory), checked, with since < id <= until, but for those whose arrays were dropped or damaged."""
        for number in range(max(since + 1, self._first), (self.last if until is None else until) + 1):
            row = self._row("arrays", number)
            if row is not None:
                try:
                    yield number, Trajectory.unpack(row[1], self.layout)
                except TrajectoryError as error:
                    self._name(f"episode {number}: damaged and left out ({error})")

    def infos(self, newest: Optional[int] = None) -> List[Dict[str, Any]]:
        """The info of every episode, or of the `newest` ones, oldest first, and its number of "transitions"."""
        last = self.last
        return list(self._infos(1 if newest is None else max(1, last + 1 - newest), last))

    @property
    def last(self) -> int:
        """The id of the newest episode; 0 where there is none. For a reader, of the newest that can be found."""
        try:
            last = self._number("SELECT COALESCE(MAX(id), 0) FROM episodes")
        except StorageError:
            if self._writes:
                raise
            last = max((number for table in ("episodes", "arrays") for number in self._ids(table)), default=0)
        files = self.path, self.path.with_name(self.path.name + "-wal")
        if last > sum(file.stat().st_size for file in files if file.exists()) / ROW:
            raise StorageError(f"{self.path}: damaged (its newest episode is number {last})")
        return last

    @property
    def transitions(self) -> int:
        """Number of transitions ever appended."""
        return sum(info["transitions"] for info in self._infos(1, self.last))

    @property
    def rows(self) -> int:
        """Number of observations: one more than transitions for each episode."""
        return sum(info["transitions"] + 1 for info in self._infos(1, self.last))

    def dropped(self) -> Tuple[int, int]:
        """(episodes, transitions) whose arrays were dropped; they are the first ones."""
        lengths = [info["transitions"] for info in self._infos(1, self._first - 1)]
        return len(lengths), sum(lengths)

    def next_episode(self, actor: str) -> int:
        """The next unused episode number of an actor."""
        return self._number("SELECT COALESCE(MAX(episode) + 1, 0) FROM episodes WHERE actor = ?", actor)

    def digest(self) -> str:
        """A checksum of the trajectories: another one means other experience."""
        with self._refusals():
            return sha256(*(found for (found,) in self._db.execute("SELECT sum FROM arrays ORDER BY id")))

    def _ids(self, table: str) -> Iterator[int]:
        """Those of a table up to the first that cannot be read."""
        with suppress(sqlite3.Error):
            for (number,) in self._db.execute(f"SELECT id FROM {table} ORDER BY id"):
                yield number

    @property
    def _first(self) -> int:
        """The id of the first episode whose arrays are there."""
        return self._number("SELECT COALESCE(MIN(id), 1) FROM arrays")

    def _infos(self, first: int, last: int) -> Iterator[Dict[str, Any]]:
        for number in range(first, last + 1):
            row = self._row("episodes", number)
            if row is not None:
                with self._refusals():
                    yield dict(json.loads(row[4]), transitions=int(row[3]))

    def _row(self, table: str, number: int) -> Optional[Tuple[Any, ...]]:
        """One row of a table; None, and said on stderr, where it is damaged."""
        problem = "it is missing"
        try:
            row = self._db.execute(f"SELECT * FROM {table} WHERE id = ?", (number,)).fetchone()
            if row is not None and row[-1] == sha256(*row[:-1]):
                return row
            problem = "its checksum is wrong" if row else problem
        except (sqlite3.Error, UnicodeDecodeError) as error:
            problem = str(error)
        self._name(f"episode {number}: damaged and left out of {table} ({problem})")
        return None

    def _name(self, damage: str) -> None:
        """Says once on stderr what is damaged."""
        if damage not in self._named:
            self._named.add(damage)
            print(f"{self.path}: {damage}", file=sys.stderr)

    def _number(self, query: str, *values: Any) -> int:
        with self._refusals():
            return int(self._db.execute(query, values).fetchone()[0])

    @contextmanager
    def _refusals(self) -> Iterator[None]:
        """Turns what sqlite refuses into a StorageError of one line."""
        try:
            yield
        except (sqlite3.IntegrityError, ApplrError):
            raise
        # the last three of a stranger's row
        except (sqlite3.Error, OSError, TypeError, ValueError, OverflowError) as error:
            raise StorageError(f"{self.path}: cannot be used ({error}); the last checkpoint is intact") from None
