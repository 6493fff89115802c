#!/usr/bin/env python3
"""Run by roslaunch while it loads jackal_applr.launch: prints "checked", or one line about the wrong argument."""

import sys

sys.path.pop(0)  # this file's folder, whose sim_bridge.py would hide the package of that name

from applr_ros1.common.errors import run_main
from applr_ros1.nodes import arguments


def _check():
    known = arguments.declared()
    given = arguments.parse([word for word in sys.argv[1:] if not word.startswith("_")], known)
    arguments.check(dict({name: default for name, (default, _) in known.items()}, **given))
    print("checked")


sys.exit(run_main(_check, "applr"))
