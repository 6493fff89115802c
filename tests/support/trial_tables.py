"""What stands in the SQLite table of trials that evaluations and searches keep."""

import sqlite3
from contextlib import closing


def kept(path, first=None):
    """The rows (trial, result) of a table; with `first`, all but so many are deleted before."""
    with closing(sqlite3.connect(path, isolation_level=None)) as table:
        if not table.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:
            return []
        if first is not None:
            table.execute("DELETE FROM trials WHERE rowid NOT IN (SELECT rowid FROM trials LIMIT ?)", (first,))
        return table.execute("SELECT * FROM trials ORDER BY trial").fetchall()
