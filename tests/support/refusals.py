"""Check that a user's mistake ends with a one-line error of this project."""

import re

import pytest

from applr_ros1.common.errors import ApplrError


def refused(call, *words, kind=ApplrError):
    """Return the error message of call(), after checking that it is one line and matches all
    regular expressions.
    """
    with pytest.raises(kind) as raised:
        call()
    message = str(raised.value)
    assert "\n" not in message, message
    for pattern in words:
        assert re.search(pattern, message), message
    return message
