"""Makes the table of moving obstacles' key frames from DynaBARN's compiled Gazebo plugins.

Call: python -m worlds.dynabarn_table WORLDS_DIR PLUGINS_DIR [--out TABLE]

Nothing of a plugin is executed: this reads the text that `objdump` (binutils) prints of it. The plugin's function Load
makes one PoseAnimation(name, length, repeat) and, for each key frame, calls CreateKeyFrame(time), builds a
Vector3(x, y, z) and hands it to Translation. DynaBARN's plugins are compiled without optimisation, so that each
argument is a constant that is loaded just before its call. Loading a world finds the table beside it under the name
movers.csv (docs/reference/worlds.md).
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import struct
import subprocess
import sys
from typing import Dict, List, Optional, Tuple, Union

from applr_ros1.common.errors import ApplrError, run_main

from . import dynabarn
from .dynabarn import Animation
from .loading import folder_files
from .sdf import FAR, parse
from .world import WorldError

TIMEOUT = 60.0  # [s] for objdump, which takes .02 s for a plugin of DynaBARN
OFF_THE_GROUND = 0.5  # [m]; a cylinder whose key frames lie higher or lower is no obstacle on the plane

_INSTRUCTION = re.compile(r"^\s*([0-9a-f]+):\s+(\w+)\s*([^#<]*?)\s*(?:<(.*)>|# ([0-9a-f]+) .*)?$")
_SLOT = re.compile(r"-?0x[0-9a-f]+\(%r[bs]p\)|%\w+")  # places whose content is followed: the stack and the registers
_LOST_IN_A_CALL = ("%xmm", "%rax", "%rcx", "%rdx", "%rsi", "%rdi")
Value = Union[int, str]  # the 64 bits of a number, or the place on the stack to which a pointer leads


def read(path: str) -> Animation:
    """The animation in a plugin. Raises WorldError, one line, where it is not understood."""
    constants = _constants(_objdump("-s", "-j", ".rodata", path))
    code = _objdump("-d", "-C", "--no-show-raw-insn", path)
    load = re.search(r"^[0-9a-f]+ <.*::Load\(.*>:\n((?:.+\n)+)", code, re.MULTILINE)
    if load is None:
        raise WorldError(f"{path} has no function Load with symbols; give a compiled plugin of DynaBARN")
    return animation(load.group(1), constants, path)


def animation(load: str, constants: Dict[int, int], path: str) -> Animation:
    """The animation that a plugin's function Load makes.

    load       objdump's lines of the function
    constants  {address: 8 bytes as a number}
    path       names the plugin in the WorldError
    """
    values: Dict[str, Value] = {}
    heads: List[Tuple[float, bool]] = []
    frames: List[List[float]] = []
    key_calls: List[int] = []
    vector: List[float] = []

    def double(value: Optional[Value]) -> float:
        if not isinstance(value, int):
            raise WorldError(f"{path} computes an argument of {called.split('(')[0]}; only constants are understood")
        return struct.unpack("<d", struct.pack("<Q", value))[0]

    for line in load.splitlines():
        found = _INSTRUCTION.match(line)
        if found is None:
            continue
        address, name, called, constant_at = int(found[1], 16), found[2], found[4] or "", found[5]
        operands = re.sub(r"%e(ax|bx|cx|dx|si|di)\b", r"%r\1", found[3])
        source, _, target = operands.rpartition(",")
        if name == "call":
            if "PoseAnimation::PoseAnimation(" in called:
                heads.append((double(values.get("%xmm0")), bool(values.get("%rdx"))))
            elif "PoseAnimation::CreateKeyFrame(" in called:
                frames.append([double(values.get("%xmm0"))])
                key_calls.append(address)
            elif re.search(r"Vector3(<double>)?::Vector3\(double const&, double", called):
                vector = [double(values.get(str(values.get(register)))) for register in ("%rsi", "%rdx", "%rcx")]
            elif "PoseKeyFrame::Translation(" in called and frames:
                frames[-1] = [frames[-1][0], *vector]
            values = {place: value for place, value in values.items() if not place.startswith(_LOST_IN_A_CALL)}
            continue
        if name.startswith("j") and name != "jmp" and any(int(source or target, 16) <= key for key in key_calls):
            raise WorldError(f"{path} makes its key frames in a loop; only a list of them is understood")
        value: Optional[Value] = None
        if name == "lea":
            value = source
        elif name in ("pxor", "xor") and source == target:
            value = 0
        elif name.startswith("mov"):
            value = int(source[1:], 16) & (2**64 - 1) if source.startswith("$") else values.get(source)
            value = value if constant_at is None else constants.get(int(constant_at, 16))
        values.pop(target, None)
        if value is not None and _SLOT.fullmatch(target):
            values[target] = value
    if len(heads) != 1:
        raise WorldError(f"{path} makes {len(heads)} animations; one is understood")
    for frame in frames:
        if len(frame) != 4 or not all(abs(v) <= FAR for v in frame) or abs(frame[3]) > OFF_THE_GROUND:
            raise WorldError(f"{path} has the key frame {frame}; it must be a time and a place on the ground")
    ordered = sorted((frame[:3] for frame in frames), key=lambda frame: frame[0])  # as CreateKeyFrame sorts them in
    return dynabarn.checked(*heads[0], [tuple(frame) for frame in ordered], f"key frames of {path}")


def _objdump(*arguments: str) -> str:
    try:
        done = subprocess.run(["objdump", *arguments], capture_output=True, encoding="latin-1", timeout=TIMEOUT)
    except subprocess.TimeoutExpired:
        raise WorldError(f"objdump takes more than {TIMEOUT:.0f} s for {arguments[-1]}; give a plugin") from None
    if done.returncode:
        raise WorldError(f"{arguments[-1]} cannot be read: {' '.join(done.stderr.split())[:200]}")
    return done.stdout


def _constants(dump: str) -> Dict[int, int]:
    """{address: 8 bytes as a number} for every eighth byte of a section as `objdump -s` prints it."""
    content, start = bytearray(), 0
    for address, digits in re.findall(r"^ ([0-9a-f]+) ((?:[0-9a-f]{2,8} ){1,4})", dump, re.MULTILINE):
        start = start if content else int(address, 16)
        content += bytes.fromhex(digits)
    return {start + n: struct.unpack_from("<Q", content, n)[0] for n in range(-start % 8, len(content) - 7, 8)}


def collect(worlds_folder: str, plugins_folder: str) -> Tuple[Dict[str, Animation], List[str]]:
    """The animations of all plugins that the worlds in a folder name, and one line for each that is not understood."""
    if shutil.which("objdump") is None:
        raise WorldError("reading plugins needs objdump; install the package binutils")
    animations: Dict[str, Animation] = {}
    problems: List[str] = []
    for world in folder_files(worlds_folder):
        for plugin in parse(world).iterfind(".//model/plugin"):
            file = os.path.basename(plugin.get("filename") or "")
            if file not in animations and not any(line.startswith(file + ": ") for line in problems):
                try:
                    animations[file] = read(os.path.join(plugins_folder, file))
                except ApplrError as error:
                    problems.append(f"{file}: {error}")
    return {os.path.splitext(file)[0]: found for file, found in animations.items()}, problems


def main() -> int:
    """Exit status 0: all plugins are in the table. 1: some are not, each named in one line, or nothing was written."""
    parser = argparse.ArgumentParser(prog="python -m worlds.dynabarn_table", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("worlds", metavar="WORLDS_DIR", help="Folder of .world files.")
    parser.add_argument("plugins", metavar="PLUGINS_DIR", help="Folder of the .so files that the worlds name.")
    parser.add_argument("--out", metavar="TABLE", help=f"File to write. Default: WORLDS_DIR/{dynabarn.NAME}.")
    arguments = parser.parse_args()
    out = arguments.out or os.path.join(arguments.worlds, dynabarn.NAME)
    animations, problems = collect(arguments.worlds, arguments.plugins)
    if animations:
        dynabarn.write_table(out, animations)
    for problem in problems:
        print(f"not understood: {problem}", file=sys.stderr)
    found = f"{len(animations)} plugins with {sum(len(a.frames) for a in animations.values())} key frames"
    print(f"{out if animations else 'nothing written'}: {found}; {len(problems)} not understood")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(run_main(main, "dynabarn_table"))
