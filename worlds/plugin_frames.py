"""The key frames in a compiled Gazebo plugin of DynaBARN, read from its machine code without running it.

The plugin's Load makes one PoseAnimation(name, length, repeat) and, for each key frame, calls CreateKeyFrame(time),
builds a Vector3(x, y, z) and hands it to Translation. All arguments are constants. `plugin_machine` follows constants
and pointers through registers and stack; this file knows which call means what. `dynabarn_table` calls `read`.
"""

from __future__ import annotations

import math
import re
from typing import Dict, List, Optional, Tuple

from .movers_table import MAX_KEY_FRAMES, Animation
from .plugin_file import PluginError, PluginFile
from .plugin_machine import Machine, Value, number_of
from .sdf_xml import FAR

# mangled names (Itanium C++ ABI): gazebo::common and ignition::math in all their versions
_NEW_ANIMATION = re.compile(r"13PoseAnimationC[12]E.*db$")
_NEW_KEY = re.compile(r"13PoseAnimation14CreateKeyFrameEd$")
_TRANSLATION = re.compile(r"12PoseKeyFrame\d+(Set)?TranslationE")
_SET_ANIMATION = re.compile(r"12SetAnimationE")
_VECTOR_FROM_REFERENCES = re.compile(r"7Vector3(IdE)?C[12]ERKdS\d*_S\d*_$")
_VECTOR_FROM_VALUES = re.compile(r"7Vector3(IdE)?C[12]Eddd$")
_VECTOR_COPY = re.compile(r"7Vector3(IdE)?C[12]ERKS\d*_$")
_LOAD = re.compile(r"4LoadEN5boost10shared_ptr|4LoadESt10shared_ptr")

MAX_LOADS = 20  # functions called Load that are looked through
OFF_THE_GROUND = 0.5  # [m]; a cylinder whose key frames lie higher or lower is no obstacle on the plane


def read(path: str) -> Animation:
    """The animation in a plugin's file. Raises PluginError, one line, where it is not understood."""
    file = PluginFile(path)
    loads = [(start, size) for start, (name, size) in file.functions.items() if _LOAD.search(name) and size]
    machine = Machine(file)
    for start, size in sorted(loads)[:MAX_LOADS]:
        calls = _Calls(file)
        machine.begin(calls.called)
        machine.run(start, start + size)
        if calls.keys:
            return calls.result(machine.loops)
    calls = _Calls(file)  # no Load by that name: look through all of the code
    machine.begin(calls.called)
    for start, content in file.code:
        machine.run(start, start + len(content))
    return calls.result(machine.loops)


class _Key:
    def __init__(self, address: int, time: Optional[float]):
        self.address, self.time = address, time
        self.point: Optional[Tuple[Optional[float], ...]] = None
        self.built: Optional[Tuple[Optional[float], ...]] = None  # the first vector made after the key


class _Calls:
    """What the calls seen so far amount to."""

    def __init__(self, file: PluginFile):
        self.path = file.path
        self.lengths: List[Tuple[Optional[float], Optional[int]]] = []
        self.keys: List[_Key] = []
        self.key_at: Dict[str, _Key] = {}  # by the region that CreateKeyFrame's result points to
        self.vectors: Dict[Value, Tuple[Optional[float], ...]] = {}

    def called(self, name: str, machine: Machine, address: int) -> bool:
        """Machine tells of a call before it happens. True: the call changes nothing but what this has noted."""
        if _NEW_ANIMATION.search(name):
            self.lengths.append((machine.double("xmm0"), number_of(machine.register("rdx"))))
        elif _NEW_KEY.search(name):
            if len(self.keys) >= MAX_KEY_FRAMES:
                raise PluginError("%s has more than %d key frames" % (self.path, MAX_KEY_FRAMES))
            key = _Key(address, machine.double("xmm0"))
            self.keys.append(key)
            self.key_at[machine.result_region(address)] = key
        elif _VECTOR_FROM_REFERENCES.search(name):
            self._vector(machine, tuple(machine.double_at(machine.register(r)) for r in ("rsi", "rdx", "rcx")))
        elif _VECTOR_FROM_VALUES.search(name):
            self._vector(machine, tuple(machine.double(r) for r in ("xmm0", "xmm1", "xmm2")))
        elif _VECTOR_COPY.search(name):
            self._vector(machine, self._point(machine, machine.register("rsi")))
        elif _TRANSLATION.search(name) and self.keys:
            target = machine.register("rdi")
            key = self.key_at.get(target[0], self.keys[-1]) if target else self.keys[-1]
            key.point = self._point(machine, machine.register("rsi"))
        else:
            return bool(_SET_ANIMATION.search(name))
        return True

    def _vector(self, machine: Machine, point: Tuple[Optional[float], ...]) -> None:
        where = machine.register("rdi")
        if where is not None:
            self.vectors[where] = point
            machine.forget(where, 32)
        if self.keys and self.keys[-1].built is None:
            self.keys[-1].built = point

    def _point(self, machine: Machine, where: Optional[Value]) -> Tuple[Optional[float], ...]:
        """x, y, z of the Vector3 at `where`: one that a constructor built, or one whose constructor was inlined."""
        if where is None:
            return (None, None, None)
        cells = [machine.double_at((where[0], where[1] + 8 * n)) for n in range(4)]
        if cells[1] is not None and cells[2] is not None:  # written by the code itself, after any constructor
            return tuple(
                cells[1:] if cells[0] is None else cells[:3]
            )  # with or without a pointer to a vtable before it
        return self.vectors.get(where, (None, None, None))

    def result(self, loops: List[Tuple[int, int]]) -> Animation:
        """The animation, checked. loops: address ranges of the code that runs more than once."""
        if not self.keys:
            raise PluginError("%s makes no key frames; it is no moving obstacle of DynaBARN" % self.path)
        if any(first <= key.address <= last for key in self.keys for first, last in loops):
            raise PluginError("%s makes its key frames in a loop; only a list of them is understood" % self.path)
        if len(self.lengths) != 1:
            raise PluginError("%s makes %d animations where one is understood" % (self.path, len(self.lengths)))
        length, repeat = self.lengths[0]
        if length is None or repeat is None:
            raise PluginError("%s computes the length of its animation; only constants are understood" % self.path)
        frames = sorted(
            (self._frame(n, key) for n, key in enumerate(self.keys)), key=lambda frame: frame[0]
        )  # as CreateKeyFrame sorts them in: equal times in the order of calls
        values = [length] + [value for frame in frames for value in frame]
        if not all(math.isfinite(v) and abs(v) <= FAR for v in values) or length <= 0.0 or frames[0][0] < 0.0:
            raise PluginError("%s has key frames out of range; times and places must be finite" % self.path)
        if len(frames) < 2:
            raise PluginError("%s has one key frame; an animation has at least two" % self.path)
        return Animation(length, bool(repeat & 1), tuple(frames))

    def _frame(self, n: int, key: _Key) -> Tuple[float, float, float]:
        """Key frame n as (t, x, y)."""
        x, y, z = key.point or key.built or (None, None, None)
        if key.time is None or x is None or y is None or z is None:
            raise PluginError("%s computes its key frame %d; only constants are understood" % (self.path, n))
        if not abs(z) <= OFF_THE_GROUND:
            raise PluginError("%s leaves the ground at key frame %d (z = %g m)" % (self.path, n, z))
        return key.time, x, y
