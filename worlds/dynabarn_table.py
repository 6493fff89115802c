"""Makes the table of moving obstacles' key frames from compiled Gazebo plugins, without running them.

Call: python -m worlds.dynabarn_table WORLDS_DIR PLUGINS_DIR [--out TABLE]

The table is read when a world is loaded that lies beside it under the name movers.csv (docs/worlds.md).
"""

from __future__ import annotations

import argparse
import os
import re
import sys
from typing import Dict, List, Tuple

from applr_ros1.common.errors import run_main

from . import movers_table
from .loading import folder_files
from .movers_table import Animation
from .sdf_xml import parse
from .world import WorldError

_FILE_NAME = re.compile(r"^[\w.+-]{1,200}\.so$", re.ASCII)


def plugins_of(world_path: str) -> List[str]:
    """File names (no folders) of the plugins that the models of a world file name, each once."""
    names = [
        plugin.get("filename") or "" for model in parse(world_path).iter("model") for plugin in model.iter("plugin")
    ]
    return list(dict.fromkeys(os.path.basename(name) for name in names))


def collect(worlds_folder: str, plugins_folder: str) -> Tuple[Dict[str, Animation], List[str]]:
    """The animations of all plugins that the worlds in a folder name, and one line for each that is not understood."""
    try:
        from . import plugin_frames  # needs the disassembler, which loading worlds does not
    except ImportError as error:
        raise WorldError("plugins cannot be read (%s): run ./applr setup" % error) from None

    if not os.path.isdir(plugins_folder):
        raise WorldError("%s is no folder; give the folder of the compiled plugins" % plugins_folder)
    animations: Dict[str, Animation] = {}
    problems: List[str] = []
    wanted: List[str] = []
    for path in folder_files(worlds_folder):
        try:
            wanted += plugins_of(path)
        except WorldError as error:
            problems.append(str(error))
    for name in dict.fromkeys(wanted):
        if not _FILE_NAME.match(name):
            problems.append("%r is no name of a plugin (.so)" % name[:80])
            continue
        try:
            animations[name[: -len(".so")]] = plugin_frames.read(os.path.join(plugins_folder, name))
        except WorldError as error:
            problems.append(str(error))
    return animations, problems


def main() -> int:
    """Exit status 0: all plugins are in the table. 1: some are not, each named in one line, or nothing was written."""
    parser = argparse.ArgumentParser(
        prog="python -m worlds.dynabarn_table",
        description="Reads the key frames of DynaBARN's moving obstacles out of their compiled Gazebo plugins (x86-64 "
        ".so files), without running them, and writes them into a table of one row per key frame.",
    )
    parser.add_argument("worlds", metavar="WORLDS_DIR", help="Folder of .world files.")
    parser.add_argument("plugins", metavar="PLUGINS_DIR", help="Folder of the .so files that the worlds name.")
    parser.add_argument(
        "--out",
        metavar="TABLE",
        help="File to write. Loading finds it beside the worlds under the name %s. Default: WORLDS_DIR/%s."
        % (movers_table.NAME, movers_table.NAME),
    )
    arguments = parser.parse_args()
    out = arguments.out or os.path.join(arguments.worlds, movers_table.NAME)
    animations, problems = collect(arguments.worlds, arguments.plugins)
    if animations:
        movers_table.write(out, animations)
    for problem in problems:
        print("not understood: %s" % problem, file=sys.stderr)
    found = "%d plugins with %d key frames" % (len(animations), sum(len(a.frames) for a in animations.values()))
    print("%s: %s; %d not understood" % (out if animations else "nothing written", found, len(problems)))
    home = os.path.abspath(os.path.join(arguments.worlds, movers_table.NAME))
    if animations and os.path.abspath(out) != home:
        print("put it beside the worlds as %s to use it" % home)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(run_main(main, "dynabarn_table"))
