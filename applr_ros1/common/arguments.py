"""Command lines of programs that ROS may start."""

from __future__ import annotations

import sys
from typing import List, Optional, Sequence


def without_remappings(arguments: Optional[Sequence[str]] = None) -> List[str]:
    """A command line (sys.argv's if None) without ROS's remapping arguments (NAME:=VALUE), as rospy.myargv does."""
    return [word for word in (sys.argv[1:] if arguments is None else arguments) if ":=" not in word]
