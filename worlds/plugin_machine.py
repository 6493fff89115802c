"""Constants and pointers in x86-64 machine code, followed through registers and memory without executing anything.

`plugin_frames` asks for the arguments of calls with it. One pass over the instructions in the order of their addresses:
where two paths meet, what both agree on is kept; what a loop changes is not followed. Anything that is not a constant,
a pointer to the file's image, to the stack or to a call's result plus a constant is unknown (None).
"""

from __future__ import annotations

import struct
from typing import Callable, Dict, List, Optional, Tuple

import capstone
from capstone import x86

from .plugin_file import PluginError, PluginFile

Value = Tuple[str, int]  # (region, offset); region "" is a plain 64-bit number, "image" an address in the file

MAX_INSTRUCTIONS = 60_000  # of all runs together; a plugin of DynaBARN has 6,000
BATCH = 4096
MAX_JUMPS = 1000  # whose targets lie further on
MAX_CELLS = 2000  # of memory that are known at a time
WRITTEN_BY_A_CALL = 40  # bytes behind a pointer argument that an unknown function may change: a string, a Quaternion
_MASK = 2**64 - 1
_ARGUMENTS = ("rdi", "rsi", "rdx", "rcx", "r8", "r9")
_CALLER_SAVED = ("rax", "rcx", "rdx", "rsi", "rdi", "r8", "r9", "r10", "r11")
_LOW_HALVES = {"e" + r: "r" + r for r in ("ax", "bx", "cx", "dx", "si", "di", "bp", "sp")}
_LOW_HALVES.update({"r%dd" % n: "r%d" % n for n in range(8, 16)})
_WIDE = ("rax", "rbx", "rcx", "rdx", "rsi", "rdi", "rbp", "rsp") + tuple("r%d" % n for n in range(8, 16))
_PARTS = {"r%d%s" % (n, end): "r%d" % n for n in range(8, 16) for end in "wb"}
_PARTS.update({r: "r" + r for r in ("ax", "bx", "cx", "dx", "si", "di", "bp", "sp")})
_PARTS.update({r + end: "r%sx" % r for r in "abcd" for end in "lh"})
_PARTS.update({r + "l": "r" + r for r in ("si", "di", "bp", "sp")})

_CLEAR = ("pxor", "xorps", "xorpd")
_SCALAR_MOVES = ("movsd", "movq", "movlpd", "movlps")
_PAIR_MOVES = ("movapd", "movaps", "movupd", "movups", "movdqa", "movdqu")
_ARITHMETIC = {
    "addsd": lambda a, b: a + b,
    "subsd": lambda a, b: a - b,
    "mulsd": lambda a, b: a * b,
    "divsd": lambda a, b: a / b if b else None,
}


def number_of(value: Optional[Value]) -> Optional[int]:
    """The 64-bit number that a value is, None for a pointer or something unknown."""
    return value[1] & _MASK if value is not None and value[0] == "" else None


def _as_double(value: Optional[Value]) -> Optional[float]:
    bits = number_of(value)
    return None if bits is None else struct.unpack("<d", struct.pack("<Q", bits))[0]


def _from_double(number: Optional[float]) -> Optional[Value]:
    return None if number is None else ("", struct.unpack("<Q", struct.pack("<d", number))[0])


class _State:
    """Registers and memory at one point of the code; what is not in them is unknown."""

    def __init__(self, address: int):
        self.reached = False  # from where the run began; exception handlers are not
        self.registers: Dict[str, Value] = {"rsp": ("stack%x" % address, 0), "rbp": ("frame%x" % address, 0)}
        self.vectors: Dict[str, Tuple[Optional[Value], Optional[Value]]] = {}  # xmm registers: low and high half
        self.memory: Dict[Value, Tuple[int, Value]] = {}  # by address: size in bytes and what is there

    def copy(self) -> _State:
        twin = _State(0)
        twin.reached = self.reached
        twin.registers, twin.vectors, twin.memory = dict(self.registers), dict(self.vectors), dict(self.memory)
        return twin

    def joined(self, other: Optional[_State]) -> _State:
        """The state where two paths meet: what is the same in both. A path that is never taken does not count."""
        if other is None or other.reached != self.reached:
            return self if self.reached or other is None else other
        _keep_equal(self.registers, other.registers)
        _keep_equal(self.vectors, other.vectors)
        _keep_equal(self.memory, other.memory)
        return self


def _keep_equal(mine: dict, theirs: dict) -> None:
    for key in [key for key, value in mine.items() if theirs.get(key) != value]:
        del mine[key]


class Machine:
    """Runs over code ranges of `file` and tells of every call.

    loops: (first, last) addresses of every loop met since begin().
    """

    def __init__(self, file: PluginFile):
        self.file = file
        self.loops: List[Tuple[int, int]] = []
        self.state = _State(0)
        self._budget = MAX_INSTRUCTIONS
        self._decoder = capstone.Cs(capstone.CS_ARCH_X86, capstone.CS_MODE_64)
        self._decoder.detail = True
        self._decoder.skipdata = True
        self._stubs: Dict[int, str] = {}

    def begin(self, on_call: Callable[[str, "Machine", int], bool]) -> None:
        """Tell `on_call` from now on.

        on_call(name, machine, address) hears the called function's symbol ("" where unknown) before the call takes
        effect, and returns whether the function leaves the memory behind its pointer arguments alone.
        """
        self.on_call, self.loops = on_call, []

    # -- for on_call -------------------------------------------------------------------------------
    def register(self, name: str) -> Optional[Value]:
        """What a 64-bit register holds."""
        return self.state.registers.get(name)

    def double(self, name: str) -> Optional[float]:
        """The floating-point number in an xmm register."""
        return _as_double(self.state.vectors.get(name, (None, None))[0])

    def double_at(self, where: Optional[Value]) -> Optional[float]:
        """The floating-point number in memory at `where`."""
        return _as_double(self._load(where, 8))

    def result_region(self, address: int) -> str:
        """The region of pointers that the call at `address` returns."""
        return "result%x" % address

    def forget(self, where: Optional[Value], size: int) -> None:
        """Nothing is known any more of `size` bytes at `where`."""
        if where is not None:
            region, offset = where
            for start in range(offset - 7, offset + size):
                cell = self.state.memory.get((region, start))
                if cell is not None and start + cell[0] > offset:
                    del self.state.memory[region, start]

    # -- the pass ----------------------------------------------------------------------------------
    def run(self, start: int, end: int) -> None:
        """Follow the code from address `start` up to `end` (exclusive)."""
        for base, content in self.file.code:
            if base <= start < base + len(content):
                code = content[start - base : end - base]
                break
        else:
            return
        waiting: Dict[int, _State] = {}  # states of jumps to addresses further on
        self.state, alive = _State(start), True
        self.state.reached = True
        for instruction in self._instructions(code, start):
            self._budget -= 1
            if self._budget < 0 or len(waiting) > MAX_JUMPS:
                raise PluginError("%s has too much code to be a plugin of DynaBARN" % self.file.path)
            if instruction.id == 0:
                continue
            address = instruction.address
            met = waiting.pop(address, None)
            if not alive:
                self.state, alive = met or _State(address), True
            elif met is not None:
                self.state = self.state.joined(met)
            if capstone.CS_GRP_JUMP in instruction.groups:
                target, conditional = instruction.operands[0], instruction.mnemonic.split()[-1] != "jmp"
                if target.type == x86.X86_OP_IMM:
                    if target.imm > address:
                        waiting[target.imm] = self.state.copy().joined(waiting.get(target.imm))
                    elif self.state.reached or conditional:  # handlers jump back to clean up, that is no loop
                        self.loops.append((target.imm, address))
                alive = conditional
            elif capstone.CS_GRP_CALL in instruction.groups:
                self._call(instruction)
            elif capstone.CS_GRP_RET in instruction.groups:
                alive = False
            else:
                self._step(instruction)

    def _instructions(self, code: bytes, start: int):
        """All instructions; decoded in batches, since the decoder holds a whole batch in memory (2 kB each)."""
        position = 0
        while position < len(code):
            last = None
            batch = code[position : position + 16 * BATCH]  # no instruction is longer than 15 bytes
            for last in self._decoder.disasm(batch, start + position, BATCH):
                yield last
            if last is None:
                return
            position = last.address + last.size - start

    def _call(self, instruction) -> None:
        target = instruction.operands[0]
        if target.type == x86.X86_OP_IMM:
            name = self._name(target.imm)
        else:
            where = self._address(instruction, target) if target.type == x86.X86_OP_MEM else None
            name = self.file.slot(where[1]) if where and where[0] == "image" else ""
        harmless = self.on_call(name, self, instruction.address)
        for register in () if harmless else _ARGUMENTS:
            self.forget(self.state.registers.get(register), WRITTEN_BY_A_CALL)
        for register in _CALLER_SAVED:
            self.state.registers.pop(register, None)
        self.state.vectors.clear()
        self.state.registers["rax"] = (self.result_region(instruction.address), 0)

    def _name(self, target: int) -> str:
        """The symbol of the function at an address: one of the file's own, or one that a linkage stub jumps to."""
        if target in self.file.functions:
            return self.file.functions[target][0]
        if target not in self._stubs:
            self._stubs[target] = ""
            stub = self.file.constant(target, 16) or b""
            for instruction in self._decoder.disasm(stub, target, 2):
                if instruction.id and capstone.CS_GRP_JUMP in instruction.groups:
                    operand = instruction.operands[0]
                    where = self._address(instruction, operand) if operand.type == x86.X86_OP_MEM else None
                    if where is not None and where[0] == "image":
                        self._stubs[target] = self.file.slot(where[1])
                    break
        return self._stubs[target]

    # -- operands ----------------------------------------------------------------------------------
    def _address(self, instruction, operand) -> Optional[Value]:
        memory = operand.mem
        if memory.segment:
            return None
        where: Optional[Value] = ("", memory.disp)
        if memory.base == x86.X86_REG_RIP:
            return "image", instruction.address + instruction.size + memory.disp
        if memory.base:
            base = self.state.registers.get(instruction.reg_name(memory.base))
            where = None if base is None else (base[0], base[1] + memory.disp)
        if memory.index and where is not None:
            index = number_of(self.state.registers.get(instruction.reg_name(memory.index)))
            where = None if index is None else (where[0], where[1] + memory.scale * index)
        return where

    def _load(self, where: Optional[Value], size: int) -> Optional[Value]:
        if where is None:
            return None
        if where[0] == "image":
            content = self.file.constant(where[1], size)
            return None if content is None else ("", int.from_bytes(content, "little"))
        stored, value = self.state.memory.get(where, (0, None))
        if stored == size:
            return value
        number = number_of(value)
        return ("", number & (2 ** (8 * size) - 1)) if stored > size and number is not None else None

    def _store(self, where: Optional[Value], size: int, value: Optional[Value]) -> None:
        if where is not None and where[0] not in ("", "image"):
            self.forget(where, size)
            if len(self.state.memory) >= MAX_CELLS:
                self.state.memory.clear()
            if value is not None:
                self.state.memory[where] = (size, value)

    def _read(self, instruction, operand) -> Optional[Value]:
        """The value of an integer operand."""
        if operand.type == x86.X86_OP_IMM:
            return "", operand.imm & _MASK
        if operand.type == x86.X86_OP_MEM:
            return self._load(self._address(instruction, operand), operand.size)
        name = instruction.reg_name(operand.reg)
        if name in _WIDE:
            return self.state.registers.get(name)
        number = number_of(self.state.registers.get(_LOW_HALVES.get(name, "")))
        return None if number is None else ("", number & 0xFFFFFFFF)

    def _write(self, instruction, operand, value: Optional[Value]) -> None:
        """Set an integer operand."""
        if operand.type == x86.X86_OP_MEM:
            self._store(self._address(instruction, operand), operand.size, value)
            return
        name = instruction.reg_name(operand.reg)
        if name in _LOW_HALVES:
            number = number_of(value)
            value = None if number is None else ("", number & 0xFFFFFFFF)
        elif name not in _WIDE:
            value = None
        wide = _LOW_HALVES.get(name) or _PARTS.get(name, name)
        if value is None:
            self.state.registers.pop(wide, None)
        else:
            self.state.registers[wide] = value

    def _pair(self, instruction, operand) -> Tuple[Optional[Value], Optional[Value]]:
        """Low and high half of an xmm register or of 16 bytes in memory."""
        if operand.type == x86.X86_OP_REG:
            return self.state.vectors.get(instruction.reg_name(operand.reg), (None, None))
        where = self._address(instruction, operand)
        above = None if where is None else (where[0], where[1] + 8)
        return self._load(where, 8), self._load(above, 8) if operand.size >= 16 else None

    # -- instructions ------------------------------------------------------------------------------
    def _step(self, instruction) -> None:
        name, operands = instruction.mnemonic, instruction.operands
        vector = bool(operands) and any(
            o.type == x86.X86_OP_REG and instruction.reg_name(o.reg).startswith("xmm") for o in operands
        )
        if vector and self._vector_step(instruction, name[1:] if name[0] == "v" else name, operands):
            return
        registers = self.state.registers
        if name in ("mov", "movabs") and not vector:
            self._write(instruction, operands[0], self._read(instruction, operands[1]))
        elif name == "lea":
            self._write(instruction, operands[0], self._address(instruction, operands[1]))
        elif (
            name in ("xor", "sub")
            and operands[0].type == operands[1].type == x86.X86_OP_REG
            and (operands[0].reg == operands[1].reg)
        ):
            self._write(instruction, operands[0], ("", 0))
        elif name in ("add", "sub"):
            self._add(instruction, operands, 1 if name == "add" else -1)
        elif name == "push":
            pushed = self._read(instruction, operands[0])
            self._move_stack(-8)
            self._store(registers.get("rsp"), 8, pushed)
        elif name == "pop":
            self._write(instruction, operands[0], self._load(registers.get("rsp"), 8))
            self._move_stack(8)
        elif name == "leave":
            registers.pop("rsp", None)
            if "rbp" in registers:
                registers["rsp"] = registers["rbp"]
                self._move_stack(8)
            registers.pop("rbp", None)
        elif name == "and" and instruction.reg_name(operands[0].reg) == "rsp":
            registers["rsp"] = ("stack%x" % instruction.address, 0)  # aligned: how far it moved is not known
        elif name not in ("cmp", "test", "nop", "endbr64"):
            self._unknown(instruction, operands)

    def _move_stack(self, by: int) -> None:
        if "rsp" in self.state.registers:
            region, offset = self.state.registers["rsp"]
            self.state.registers["rsp"] = (region, offset + by)

    def _add(self, instruction, operands, sign: int) -> None:
        first, second = self._read(instruction, operands[0]), number_of(self._read(instruction, operands[1]))
        total = None
        if first is not None and second is not None:
            second = second - 2**64 if second >= 2**63 else second
            total = (first[0], first[1] + sign * second)
            total = ("", total[1] & _MASK) if total[0] == "" else total
        self._write(instruction, operands[0], total)

    def _vector_step(self, instruction, name: str, operands) -> bool:
        """An instruction on xmm registers; False where its effect is not followed."""
        first, last = operands[0], operands[-1]
        vectors = self.state.vectors
        to_register = first.type == x86.X86_OP_REG
        target = instruction.reg_name(first.reg) if to_register else ""
        if (
            name in _CLEAR
            and to_register
            and len(operands) > 1
            and operands[-2].type == last.type
            and (last.type == x86.X86_OP_REG and operands[-2].reg == last.reg)
        ):
            vectors[target] = (("", 0), ("", 0))
        elif name == "movq" and to_register and not target.startswith("xmm"):
            self._write(instruction, first, self._pair(instruction, last)[0])
        elif name == "movq" and last.type == x86.X86_OP_REG and not instruction.reg_name(last.reg).startswith("xmm"):
            vectors[target] = (self._read(instruction, last), ("", 0))
        elif name in _SCALAR_MOVES and len(operands) == 2:
            low = self._pair(instruction, last)[0]
            if not to_register:
                self._store(self._address(instruction, first), 8, low)
            elif last.type == x86.X86_OP_MEM and name in ("movsd", "movq") or name == "movq":
                vectors[target] = (low, ("", 0))
            else:
                vectors[target] = (low, vectors.get(target, (None, None))[1])
        elif name in _PAIR_MOVES and len(operands) == 2:
            pair = self._pair(instruction, last)
            if to_register:
                vectors[target] = pair
            else:
                where = self._address(instruction, first)
                if where is not None:
                    self._store(where, 8, pair[0])
                    self._store((where[0], where[1] + 8), 8, pair[1])
        elif name in ("movhpd", "movhps") and len(operands) == 2:
            if to_register:
                vectors[target] = (vectors.get(target, (None, None))[0], self._pair(instruction, last)[0])
            else:
                self._store(self._address(instruction, first), 8, self._pair(instruction, last)[1])
        elif name in ("unpcklpd", "punpcklqdq", "movlhps") and to_register:
            vectors[target] = (self._pair(instruction, operands[-2])[0], self._pair(instruction, last)[0])
        elif name in ("unpckhpd", "punpckhqdq") and to_register:
            vectors[target] = (self._pair(instruction, operands[-2])[1], self._pair(instruction, last)[1])
        elif name == "movddup" and to_register:
            vectors[target] = (self._pair(instruction, last)[0],) * 2
        elif name in _ARITHMETIC and to_register:
            a, b = (_as_double(self._pair(instruction, o)[0]) for o in operands[-2:])
            result = None if a is None or b is None else _ARITHMETIC[name](a, b)
            vectors[target] = (_from_double(result), vectors.get(target, (None, None))[1])
        elif name == "cvtsi2sd" and to_register:
            whole, bits = number_of(self._read(instruction, last)), 8 * last.size
            if whole is not None and whole >= 2 ** (bits - 1):
                whole -= 2**bits
            converted = None if whole is None else _from_double(float(whole))
            vectors[target] = (converted, vectors.get(target, (None, None))[1])
        elif name == "movss" and to_register and last.type == x86.X86_OP_MEM:
            vectors[target] = (self._load(self._address(instruction, last), 4), ("", 0))
        elif name == "cvtss2sd" and to_register:
            single = (
                number_of(self._load(self._address(instruction, last), 4))
                if last.type == x86.X86_OP_MEM
                else number_of(self._pair(instruction, last)[0])
            )
            number = None if single is None else struct.unpack("<f", struct.pack("<I", single & 0xFFFFFFFF))[0]
            vectors[target] = (_from_double(number), vectors.get(target, (None, None))[1])
        else:
            return False
        return True

    def _unknown(self, instruction, operands) -> None:
        """An instruction that is not followed: nothing is known of what it writes."""
        for register in instruction.regs_access()[1]:
            name = instruction.reg_name(register)
            self.state.vectors.pop(name.replace("ymm", "xmm").replace("zmm", "xmm"), None)
            self.state.registers.pop(_LOW_HALVES.get(name) or _PARTS.get(name, name), None)
        for operand in operands[:1]:
            if operand.type == x86.X86_OP_MEM:
                where = self._address(instruction, operand)
                self.forget(where, 256 if instruction.mnemonic.startswith("rep") else max(operand.size, 1))
