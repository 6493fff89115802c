"""Trajectories on disk: one sqlite3 file, written by a training run as it goes, or by bags_to_dataset.

The file is both the run's journal and a dataset: train.py --dataset reads that of a run, or of bags. Every trajectory
is committed the moment it is taken, so a killed process loses none, and nothing is pickled. In SQL,

    SELECT id, transitions, json_extract(info, '$.return') FROM episodes

lists the episodes of a run.
"""

from __future__ import annotations

import hashlib
import json
import os
import sqlite3
import time
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Dict, Iterator, List, Optional, Tuple

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import StorageError
from training.replay.trajectory import Layout, Trajectory, TrajectoryError

NAME = "replay.sqlite"  # in the folder of a run or of a dataset
VERSION = 1  # of the tables
TABLES = f"""
BEGIN;
CREATE TABLE episodes (
    id INTEGER PRIMARY KEY,
    actor TEXT NOT NULL,
    episode INTEGER NOT NULL,
    transitions INTEGER NOT NULL,
    info TEXT NOT NULL,  -- JSON
    UNIQUE (actor, episode)
);
CREATE TABLE arrays (id INTEGER PRIMARY KEY, data BLOB NOT NULL);  -- packed trajectories, until the buffer forgets them
CREATE TABLE about (name TEXT PRIMARY KEY, value TEXT NOT NULL);  -- JSON values: layout, source, skipped
PRAGMA user_version = {VERSION};
INSERT INTO about VALUES ('layout', ':layout');
COMMIT;
"""


class Store:
    """The trajectories of a run or dataset, in the order in which they were taken.

    Args:
        path: the file, or the folder that holds it as replay.sqlite.
        layout: makes the store where it is not there yet; None only reads.

    Raises:
        StorageError: with one line, where there is no store, where it is damaged, or where it has another layout.
    """

    def __init__(self, path: os.PathLike | str, layout: Optional[Layout] = None):
        self.path = Path(path) / NAME if Path(path).is_dir() else Path(path)
        if not self.path.is_file() and (layout is None or os.path.lexists(self.path)):
            raise StorageError(f"{path}: holds no trajectories (no {NAME}); train, or make a dataset of bags, first")
        self._writes = layout is not None
        with self._refusals():
            mode = "rwc" if layout is not None else "ro"
            self._db = sqlite3.connect(
                f"{self.path.absolute().as_uri()}?mode={mode}", uri=True, isolation_level=None, check_same_thread=False
            )
            version = self._number("PRAGMA user_version")
            if layout is not None:
                self._db.execute("PRAGMA journal_mode = WAL")
                self._db.execute("PRAGMA synchronous = NORMAL")  # survives a kill; sync() survives a loss of power
                if not version and not self._number("SELECT COUNT(*) FROM sqlite_master"):
                    self._db.executescript(TABLES.replace(":layout", json.dumps(layout.to_dict())))
                    version = VERSION
        try:
            self.layout = Layout.from_dict(self.about("layout"))
        except (TypeError, KeyError):
            version = 0
        if version != VERSION:
            raise StorageError(f"{self.path}: not a store of trajectories of this version")
        if layout is not None and layout != self.layout:
            raise StorageError(f"{self.path}: its layout is {self.layout}, {layout} is needed")

    # -- writing -----------------------------------------------------------------------------------
    def append(self, trajectory: Trajectory, blob: Optional[bytes] = None) -> None:
        """Adds a trajectory; `blob` is it packed, where that is known.

        Raises:
            TrajectoryError: it is malformed, or the episode of that actor is there already.
            StorageError: it cannot be written.
        """
        trajectory.check(self.layout)
        actor, episode = trajectory.info["actor"], trajectory.info["episode"]
        row = (actor, episode, len(trajectory), json.dumps(trajectory.info))
        try:
            with self._refusals(), self._db:
                self._db.execute("BEGIN")
                added = self._db.execute(
                    "INSERT INTO episodes (actor, episode, transitions, info) VALUES (?, ?, ?, ?)", row
                )
                self._db.execute("INSERT INTO arrays VALUES (?, ?)", (added.lastrowid, blob or trajectory.pack()))
        except sqlite3.IntegrityError:
            raise TrajectoryError(f"episode {episode} of actor {actor} came twice") from None

    def note(self, name: str, value: Any) -> None:
        """Keeps a JSON value by name: "source", what the experience was driven with, or "skipped", by reason."""
        with self._refusals():
            self._db.execute("INSERT OR REPLACE INTO about VALUES (?, ?)", (name, json.dumps(value)))

    def sync(self) -> None:
        """Wait until everything that was appended is on the disk."""
        with self._refusals():
            for last in (False,) * 100 + (True,):
                try:
                    self._db.execute("PRAGMA wal_checkpoint(FULL)").fetchall()
                    return
                except sqlite3.OperationalError as error:  # somebody reads it at this moment
                    if last or "locked" not in str(error):
                        raise
                    time.sleep(0.01)

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
        """What note() kept by a name; {} where it kept nothing."""
        with self._refusals():
            found = self._db.execute("SELECT value FROM about WHERE name = ?", (name,)).fetchone()
            return json.loads(found[0]) if found else {}

    def trajectories(self, since: int = 0, until: Optional[int] = None) -> Iterator[Tuple[int, Trajectory]]:
        """(id, trajectory), checked, with since < id <= until, but for those whose arrays were dropped.

        Raises:
            StorageError: for one that is damaged.
        """
        last = self.last if until is None else until
        while True:
            with self._refusals():
                found = self._db.execute(
                    "SELECT id, data FROM arrays WHERE id > ? AND id <= ? ORDER BY id LIMIT 1",
                    (since, last),
                ).fetchone()
            if found is None:
                return
            since, blob = found
            try:
                trajectory = Trajectory.unpack(blob)
                trajectory.check(self.layout)
            except TrajectoryError as error:
                raise StorageError(f"{self.path}: episode {since}: {error}") from None
            yield since, trajectory

    @property
    def last(self) -> int:
        """The id of the newest episode; 0 where there is none."""
        return self._number("SELECT COALESCE(MAX(id), 0) FROM episodes")

    @property
    def transitions(self) -> int:
        """Number of transitions ever appended."""
        return self._number("SELECT COALESCE(SUM(transitions), 0) FROM episodes")

    @property
    def rows(self) -> int:
        """Number of observations: one more than transitions for each episode."""
        return self._number("SELECT COALESCE(SUM(transitions + 1), 0) FROM episodes")

    def dropped(self) -> Tuple[int, int]:
        """(episodes, transitions) whose arrays were dropped; they are the first ones."""
        with self._refusals():
            counts = "COUNT(*), COALESCE(SUM(transitions), 0)"
            rest = "id NOT IN (SELECT id FROM arrays)"
            return self._db.execute(f"SELECT {counts} FROM episodes WHERE {rest}").fetchone()

    def next_episode(self, actor: str) -> int:
        """The next unused episode number of an actor."""
        return self._number("SELECT COALESCE(MAX(episode) + 1, 0) FROM episodes WHERE actor = ?", actor)

    def infos(self, newest: Optional[int] = None) -> List[Dict[str, Any]]:
        """The info of every episode, or of the `newest` ones, oldest first; "transitions" counts up to its end."""
        with self._refusals():
            rows = self._db.execute(
                "SELECT * FROM (SELECT id, info, SUM(transitions) OVER (ORDER BY id) FROM episodes ORDER BY id DESC "
                "LIMIT ?) ORDER BY id",
                (-1 if newest is None else newest,),
            ).fetchall()
        return [dict(json.loads(info), transitions=transitions) for _, info, transitions in rows]

    def digest(self) -> str:
        """SHA-256 of the trajectories: another one means other experience."""
        found = hashlib.sha256()
        with self._refusals():
            for (blob,) in self._db.execute("SELECT data FROM arrays ORDER BY id"):
                found.update(blob)
        return found.hexdigest()

    def _number(self, query: str, *values: Any) -> int:
        with self._refusals():
            return int(self._db.execute(query, values).fetchone()[0])

    @contextmanager
    def _refusals(self) -> Iterator[None]:
        """Turns what sqlite refuses into a StorageError of one line."""
        try:
            yield
        except sqlite3.IntegrityError:
            raise
        except (sqlite3.Error, OSError) as error:
            raise StorageError(f"{self.path}: cannot be used ({error}); the last checkpoint is intact") from None


def dataset(path: os.PathLike | str, layout: Optional[Layout] = None) -> Store:
    """A store to learn from offline, read whole and checked.

    Raises:
        ApplrError: with one line, where it is none, damaged, empty, or of another layout than the one given.
    """
    store = Store(path)
    if layout is not None and store.layout != layout:
        raise ApplrError(f"{path}: its layout is {store.layout}, this training has {layout}")
    if not sum(len(trajectory) for _, trajectory in store.trajectories()):
        raise ApplrError(f"{path}: holds no transitions")
    return store
