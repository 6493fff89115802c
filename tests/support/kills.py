"""What a kill leaves of a command: its folder as it is at each write."""

import os
import shutil

WRITES = [(os, "fsync"), (os, "replace")]


def left_at_each_write(command, folder, copies, monkeypatch):
    """Execute a command, and copy its folder before each of its writes to copies/0, copies/1, ...; return their names.

    At a write the bytes of a file are there and its name is not yet.
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
