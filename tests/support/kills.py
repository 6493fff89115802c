"""What a kill leaves of a command: its folder as it is at each write, and an exception that nothing survives."""

import os
import shutil

from training.replay.store import TrajectoryStore

WRITES = [(os, "fsync"), (os, "replace"), *((TrajectoryStore, name) for name in ("append", "note", "forget"))]


class Killed(BaseException):
    """What a SIGKILL does: nothing is saved any more."""


def left_at_each_write(command, folder, copies, monkeypatch):
    """Execute a command, and copy its folder before each of its writes to copies/0, copies/1, ...; return their names.

    A write is a file's, of which the bytes are there and the name is not yet, or a store's.
    """
    names = []

    def copying(owner, name):
        real = getattr(owner, name)

        def write(*args, **more):
            folder.exists() and shutil.copytree(folder, copies / str(len(names)))
            names.append(name)
            return real(*args, **more)

        return write

    with monkeypatch.context() as patch:
        for owner, name in WRITES:
            patch.setattr(owner, name, copying(owner, name))
        command()
    return names
