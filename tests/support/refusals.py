"""What a person's mistake ends with: an error of this project, in one line."""

import re

import pytest

from applr_ros1.common.errors import ApplrError


def refused(call, *words, kind=ApplrError):
    """Return the line with which call() is refused, in which each of the regular expressions is found."""
    with pytest.raises(kind) as found:
        call()
    line = str(found.value)
    assert "\n" not in line, line
    assert all(re.search(word, line) for word in words), line
    return line
