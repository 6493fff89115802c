"""Programs for a desk computer: a room per command, started as `python -m training.ROOM`."""

import sys

from applr_ros1.common.errors import ApplrError

if sys.version_info < (3, 10):
    python_version = f"{sys.version_info.major}.{sys.version_info.minor}"
    problem = f"training needs Python 3.10 or later, this is {python_version}"
    raise ApplrError(f"{problem}: use a desk computer")
