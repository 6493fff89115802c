"""What stands in the table of trials that evaluations and searches keep."""


def kept(path, first=None):
    """The rows of a table, in any order; with `first`, all but so many are deleted before."""
    if first is not None:
        path.write_text("".join(path.read_text().splitlines(keepends=True)[: 1 + first]))
    return sorted(path.read_text().splitlines()[1:]) if path.exists() else []
