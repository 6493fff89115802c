"""Trajectories on disk: one sqlite3 file, written by a training run as it goes, or by bags_to_dataset.

The file is both the run's journal and a dataset: train.py --dataset reads that of a run, or of bags. Every trajectory
is committed the moment it is taken, so a killed process loses none, and nothing is pickled. Every row has a checksum of
its other columns; a damaged episode is named on stderr and left out. In SQL,

    SELECT id, transitions, json_extract(info, '$.return') FROM episodes

lists the episodes of a run.
"""

from __future__ import annotations

import hashlib
import json
import os
import sqlite3
import sys
import threading
import time
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Dict, Iterator, List, Optional, Set, Tuple

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import StorageError, sha256
from training.replay.trajectory import Trajectory, TrajectoryError, TransitionLayout

NAME = "replay.sqlite"  # in the folder of a run or of a dataset
VERSION = 2  # of the tables; 1 had no checksums
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
INSERT INTO about VALUES ('layout', ':layout', sha256('layout', ':layout'));
COMMIT;
"""
WHOLE = """
CREATE TEMP VIEW whole AS SELECT * FROM episodes WHERE sum = sha256(id, actor, episode, transitions, info)
"""


class TrajectoryStore:
    """The trajectories of a run or dataset, in the order in which they were taken.

    Args:
        path: the file, or the folder that holds it as replay.sqlite.
        layout: makes the store where it is not there yet; None only reads.

    Raises:
        StorageError: with one line, where there is no store, where it has another layout, or where its tables are
            damaged, which a reader is told on stderr as long as it can go on.
    """

    def __init__(self, path: os.PathLike | str, layout: Optional[TransitionLayout] = None):
        self.path = Path(path) / NAME if Path(path).is_dir() else Path(path)
        if not self.path.is_file() and (layout is None or os.path.lexists(self.path)):
            raise StorageError(f"{path}: holds no trajectories (no {NAME}); train, or make a dataset of bags, first")
        self._writes = layout is not None
        self._said: Set[str] = set()
        self._lock = (
            threading.RLock()
        )  # sqlite calls sha256 with its own lock held: a second thread would wait for ever
        with self._refusals():
            mode = "rwc" if layout is not None else "ro"
            self._db = sqlite3.connect(
                f"{self.path.absolute().as_uri()}?mode={mode}", uri=True, isolation_level=None, check_same_thread=False
            )
            self._db.create_function("sha256", -1, sha256, deterministic=True)
            version = self._number("PRAGMA user_version")
            if layout is not None:
                self._db.execute("PRAGMA journal_mode = WAL")
                self._db.execute("PRAGMA synchronous = NORMAL")  # survives a kill; sync() survives a loss of power
                if not version and not self._number("SELECT COUNT(*) FROM sqlite_master"):
                    self._db.executescript(TABLES.replace(":layout", json.dumps(layout.to_dict())))
                    version = VERSION
            if version == 1:
                raise sqlite3.DatabaseError("an earlier version wrote it, without checksums: use that, or make it anew")
            self._db.execute(WHOLE)
        try:
            self.layout = TransitionLayout.from_dict(self.about("layout"))
        except (TypeError, KeyError):
            version = 0
        if version != VERSION:
            raise StorageError(f"{self.path}: not a store of trajectories of this version")
        if layout is not None and layout != self.layout:
            raise StorageError(f"{self.path}: its layout is {self.layout}, {layout} is needed")
        self._look_for_damage()

    def _look_for_damage(self) -> None:
        """Names what is damaged, on stderr; StorageError where it would be written to."""
        with self._refusals():
            (found,) = self._db.execute("PRAGMA integrity_check(1)").fetchone()
            if found != "ok" and self._writes:
                raise sqlite3.DatabaseError(found.splitlines()[-1])
            if found != "ok":
                self._say(f"damaged ({found.splitlines()[-1]}); episodes may be missing")
            for (number,) in self._db.execute("SELECT id FROM episodes EXCEPT SELECT id FROM whole"):
                self._say(f"episode {number}: its row is damaged and left out of figures and counts")

    def _say(self, text: str) -> None:
        if text not in self._said:
            self._said.add(text)
            print(f"{self.path}: {text}", file=sys.stderr)

    # -- writing -----------------------------------------------------------------------------------
    def append(self, trajectory: Trajectory, blob: Optional[bytes] = None) -> None:
        """Adds a trajectory; `blob` is it packed, where that is known.

        Raises:
            TrajectoryError: it is malformed, or the episode of that actor is there already.
            StorageError: it cannot be written.
        """
        trajectory.check(self.layout)
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
        """What note() kept by a name; {} where it kept nothing. Raises StorageError where that is damaged."""
        with self._refusals():
            found = self._db.execute("SELECT value, sum FROM about WHERE name = ?", (name,)).fetchone()
            if found and found[1] != sha256(name, found[0]):
                raise sqlite3.DatabaseError(f"the checksum of its {name} is wrong")
            return json.loads(found[0]) if found else {}

    def trajectories(self, since: int = 0, until: Optional[int] = None) -> Iterator[Tuple[int, Trajectory]]:
        """(id, trajectory), checked, with since < id <= until, but for those whose arrays were dropped or damaged."""
        last = self.last if until is None else until
        with self._refusals():
            found = self._db.execute("SELECT id FROM arrays WHERE id > ? AND id <= ? ORDER BY id", (since, last))
            numbers = [number for (number,) in found]
        for number in numbers:
            try:
                data, found = self._db.execute("SELECT data, sum FROM arrays WHERE id = ?", (number,)).fetchone()
                if found != sha256(number, data):
                    raise TrajectoryError("its checksum is wrong")
                trajectory = Trajectory.unpack(data)
                trajectory.check(self.layout)
            except (TrajectoryError, TypeError, UnicodeDecodeError, sqlite3.Error) as error:  # TypeError: no such row
                self._say(f"episode {number}: damaged and left out ({error})")
            else:
                yield number, trajectory

    @property
    def last(self) -> int:
        """The id of the newest episode; 0 where there is none."""
        return self._number("SELECT COALESCE(MAX(id), 0) FROM episodes")

    @property
    def transitions(self) -> int:
        """Number of transitions ever appended."""
        return self._number("SELECT COALESCE(SUM(transitions), 0) FROM whole")

    @property
    def rows(self) -> int:
        """Number of observations: one more than transitions for each episode."""
        return self._number("SELECT COALESCE(SUM(transitions + 1), 0) FROM whole")

    def dropped(self) -> Tuple[int, int]:
        """(episodes, transitions) whose arrays were dropped; they are the first ones."""
        with self._refusals():
            counts = "COUNT(*), COALESCE(SUM(transitions), 0)"
            rest = "id NOT IN (SELECT id FROM arrays)"
            return self._db.execute(f"SELECT {counts} FROM whole WHERE {rest}").fetchone()

    def next_episode(self, actor: str) -> int:
        """The next unused episode number of an actor."""
        return self._number("SELECT COALESCE(MAX(episode) + 1, 0) FROM episodes WHERE actor = ?", actor)

    def infos(self, newest: Optional[int] = None) -> List[Dict[str, Any]]:
        """The info of every episode, or of the `newest` ones, oldest first, and its number of "transitions"."""
        with self._refusals():
            rows = self._db.execute(
                "SELECT info, transitions FROM whole ORDER BY id DESC LIMIT ?", (-1 if newest is None else newest,)
            ).fetchall()
        return [dict(json.loads(info), transitions=transitions) for info, transitions in reversed(rows)]

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
        """One thread at a time; turns what sqlite refuses into a StorageError of one line."""
        try:
            with self._lock:
                yield
        except sqlite3.IntegrityError:
            raise
        except (sqlite3.Error, OSError, UnicodeDecodeError) as error:
            raise StorageError(f"{self.path}: cannot be used ({error}); the last checkpoint is intact") from None


def dataset(path: os.PathLike | str, layout: Optional[TransitionLayout] = None) -> TrajectoryStore:
    """A store to learn from offline, read whole and checked.

    Raises:
        ApplrError: with one line, where it is none, damaged, empty, or of another layout than the one given.
    """
    store = TrajectoryStore(path)
    if layout is not None and store.layout != layout:
        raise ApplrError(f"{path}: its layout is {store.layout}, this training has {layout}")
    if not sum(len(trajectory) for _, trajectory in store.trajectories()):
        raise ApplrError(f"{path}: holds no transitions")
    return store
