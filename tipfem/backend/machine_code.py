"""Machine code of kernels by llvmlite: made from Taichi's code in LLVM's language, loaded, and called.

The code calls nothing but functions of the C library for reals, and of Taichi's runtime reads three fields, the threads
and a buffer for values that pass from loop to loop. That is checked before it is compiled.
"""

import ctypes
import platform
import re
from typing import Any

from tipfem.backend import quick_launch, thread_pool

LLVM = 15  # the last version but one that reads the pointers of Taichi's code, and that of llvmlite 0.44
_BUFFER = 1 << 20  # [B] of values that pass from loop to loop, as in Taichi
_POOL, _PARALLEL_FOR, _TEMPORARIES = 9, 10, 14  # fields of Taichi's runtime
_C_LIBRARY = {"sin", "cos", "tan", "asin", "acos", "atan2", "tanh", "exp", "log", "pow", "fmod", "sqrt"}
_C_LIBRARY |= {name + "f" for name in _C_LIBRARY}
# The beginning of the runtime's type in version 1.7.4, without the numbers of types.
_RUNTIME = (
    "type { %struct.PreallocatedMemoryChunk, %struct.PreallocatedMemoryChunk, i8* (i8*, i64, i64)*, void (i8*)*, "
    "void (i8*, ...)*, i32 (i8*, i64, i8*, %struct.__va_list_tag*)*, i8*, [512 x i8*], [512 x i64], i8*, "
    "void (i8*, i32, i32, i8*, void (i8*, i32, i32)*)*, [1024 x %struct.ListManager*], [1024 x %struct.NodeManager*], "
    "[1024 x i8*], i8*, "
)
# All that kernels may do with a pointer to it: load and store it, and take one of the three fields.
_ALLOWED = re.compile(
    r" *%\S+ = load %struct\.LLVMRuntime[.\d]*\*, %struct\.LLVMRuntime[.\d]*\*\* %\S+, align 8(, !.*)?"
    r"| *store %struct\.LLVMRuntime[.\d]*\* %\S+, %struct\.LLVMRuntime[.\d]*\*\* %\S+, align 8(, !.*)?"
    r"| *%\S+ = getelementptr inbounds %struct\.LLVMRuntime[.\d]*, %struct\.LLVMRuntime[.\d]*\* %\S+, i64 0, "
    rf"i32 ({_POOL}|{_PARALLEL_FOR}|{_TEMPORARIES})"
    r"| *%\S+ = phi %struct\.LLVMRuntime[.\d]*\* \[ %\S+, %\S+ \](, \[ %\S+, %\S+ \])*"
)
# They load what does not change once, and change no operation on reals, so that results keep their bits.
_PASSES = ("gvn", "licm", "gvn", "dead_code_elimination")
# Processors with all of these, most since 2013, run the same code: it can be shipped, and gives all the same bits.
_LEVEL_3 = ("avx", "avx2", "bmi", "bmi2", "cx16", "f16c", "fma", "lzcnt", "movbe", "popcnt", "sahf", "sse4.2", "xsave")
_CONTEXT = "type { i8*, %struct.LLVMRuntime*, i32, i64* }"


class Runtime(ctypes.Structure):
    """Taichi's runtime, as far as kernels read it; the other fields are zero."""

    _fields_ = (
        ("before", ctypes.c_uint64 * (2 * 3 + 5 + 512 + 512)),
        ("pool", ctypes.c_void_p),
        ("parallel_for", ctypes.c_void_p),
        ("between", ctypes.c_uint64 * (3 * 1024)),
        ("temporaries", ctypes.c_void_p),
        ("after", ctypes.c_uint64 * 4096),
    )


class Context(ctypes.Structure):
    """Context that a kernel is given."""

    _fields_ = (
        ("arguments", ctypes.c_void_p),
        ("runtime", ctypes.c_void_p),
        ("thread", ctypes.c_int32),
        ("result", ctypes.c_void_p),
    )


class UnsuitableError(Exception):
    """A kernel needs more of Taichi's runtime than there is here, or llvmlite does not do."""


class Machine:
    """The compiler and the loader; `UnsuitableError` without llvmlite, or with another version of LLVM.

    ``name`` differs wherever machine code may. ``quick_launch`` compares a tuple of arguments with the address of a
    `Plan`, and starts its kernel, see `tipfem.backend.quick_launch`: 0 if it did; None where that is not possible.
    """

    def __init__(self) -> None:
        try:
            import llvmlite
            from llvmlite import binding as llvm
        except (ImportError, OSError) as error:
            raise UnsuitableError(f"llvmlite cannot be imported: {error}") from error
        if llvm.llvm_version_info[0] != LLVM:
            raise UnsuitableError(f"llvmlite {llvmlite.__version__} has LLVM {llvm.llvm_version_info[0]}, not {LLVM}")
        self._llvm: Any = llvm
        llvm.initialize()
        llvm.initialize_native_target()
        llvm.initialize_native_asmprinter()
        cpu, present, triple = llvm.get_host_cpu_name(), llvm.get_host_cpu_features(), llvm.get_process_triple()
        features = present.flatten()
        if triple.startswith("x86_64") and all(present.get(feature) for feature in _LEVEL_3):
            cpu, features = "x86-64-v3", ""
        target = llvm.Target.from_triple(triple)
        # Code and constants may be loaded farther from each other than the 2 GB that the small model can span.
        model = {"reloc": "static", "codemodel": "large"}
        self._target = target.create_target_machine(cpu=cpu, features=features, opt=2, **model)
        self._engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), self._target)
        self.name = "\n".join([llvmlite.__version__, triple, cpu, features, *model.values(), *_PASSES])
        self._runtime = Runtime()
        self.quick_launch: Any = None

    def compile(self, text: str) -> bytes:
        """Machine code of a text in LLVM's language; `UnsuitableError` if it is not in it."""
        try:
            module = self._llvm.parse_assembly(with_constant_arguments(text))
            module.verify()
            passes = self._llvm.ModulePassManager()
            self._target.add_analysis_passes(passes)
            for name in _PASSES:
                getattr(passes, f"add_{name}_pass")()
            passes.run(module)
            return bytes(self._target.emit_object(module))
        except RuntimeError as error:
            raise UnsuitableError(f"LLVM: {str(error).splitlines()[0]}") from error

    def load(self, code: bytes, *functions: str) -> list[int]:
        """Load machine code that `compile` has made; the addresses of functions in it."""
        self._engine.add_object_file(self._llvm.ObjectFileRef.from_data(code))
        self._engine.finalize_object()
        return [self._engine.get_function_address(function) for function in functions]

    def start_threads(self, code: bytes, threads: int) -> None:
        """Start the workers of `thread_pool`, and provide `quick_launch`; `UnsuitableError` if there are no more."""
        start, parallel_for, launch = self.load(code, "start", "parallel_for", "quick_launch")
        if quick_launch.layout_is_known():
            kind = ctypes.PYFUNCTYPE(ctypes.c_int32, ctypes.py_object, ctypes.c_void_p)
            self.quick_launch = kind(launch)
        if ctypes.PYFUNCTYPE(ctypes.c_int32, ctypes.c_int32)(start)(threads):
            raise UnsuitableError(f"{threads} threads cannot be started")
        # The workers run this code until the process ends: it must never be freed, not even at the interpreter's end.
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(self))
        self._buffer = ctypes.create_string_buffer(_BUFFER + 64)
        self._runtime.parallel_for = parallel_for
        self._runtime.temporaries = (ctypes.addressof(self._buffer) + 63) // 64 * 64

    def context(self, arguments: ctypes.Structure) -> tuple[Context, Any]:
        """Context of a kernel with such arguments, and the buffer for its return value."""
        result = (ctypes.c_uint64 * 32)()
        return Context(
            ctypes.addressof(arguments), ctypes.addressof(self._runtime), 0, ctypes.addressof(result)
        ), result


def threads_text() -> str:
    """The threads and `quick_launch` in LLVM's language; `UnsuitableError` on an unknown processor."""
    try:
        return thread_pool.text(platform.machine()) + quick_launch.TEXT
    except ValueError as error:
        raise UnsuitableError(str(error)) from error


def with_constant_arguments(text: str) -> str:
    """The text with all loads of a kernel's arguments marked as of what does not change while it runs.

    Taichi loads an array's address and shape again for each of its entries, because a store might have changed them.
    Here LLVM is told that none does; what a function loads from anything but its arguments is left alone.
    """
    found = re.search(r"= bitcast %struct\.RuntimeContext[.\d]*\* %\S+ to (\{.*\})\*\*$", text, re.MULTILINE)
    if found is None:
        return text
    layout = re.escape(found[1])
    place = re.compile(
        rf"  (%\S+) = (?:bitcast %struct\.RuntimeContext[.\d]*\* (%\S+) to {layout}\*\*$"
        rf"|getelementptr (?:inbounds )?{layout}, )"
    )
    load = re.compile(r"  %\S+ = load .*\* (%[\w.]+), align \d+$")
    lines, places, given = text.splitlines(), set[str](), ""
    for i, line in enumerate(lines):
        if line.startswith("define "):
            places, given = set(), line[line.index("(") :]
        elif (at := place.match(line)) and (at[2] is None or re.search(rf"{at[2]}[,)]", given)):
            places.add(at[1])
        elif (at := load.match(line)) and at[1] in places:
            lines[i] += ", !invariant.load !9999"
    return "\n".join([*lines, "!9999 = !{}", ""])


def one_function(text: str, tasks: list[str], name: str) -> str:
    """The text of a kernel as one function ``name``, which runs ``tasks`` one after the other.

    `UnsuitableError` if the code needs more than there is here.
    """
    types = dict(re.findall(r"^(%struct\.[A-Za-z]+)[.\d]* = (type .*)$", text, re.MULTILINE))
    types = {name: re.sub(r"(%struct\.[A-Za-z_]+)[.\d]*", r"\1", fields) for name, fields in types.items()}
    runtime = types.get("%struct.LLVMRuntime", "opaque")
    if types.get("%struct.RuntimeContext") != _CONTEXT or not (runtime == "opaque" or runtime.startswith(_RUNTIME)):
        raise UnsuitableError("Taichi's runtime has other fields than expected")
    body = text[text.index("define ") :]
    for line in body.splitlines():
        if "%struct.LLVMRuntime" in line and not _ALLOWED.fullmatch(line):
            raise UnsuitableError(f"it uses Taichi's runtime otherwise than expected: {line.strip()}")
    for function in re.findall(r"^declare [^@]*@([\w.$]+)\(", body, re.MULTILINE):
        if not function.startswith("llvm.") and function not in _C_LIBRARY:
            raise UnsuitableError(f"it calls {function}")
    calls, context = [], ""
    for number, task in enumerate(tasks):
        head = re.compile(rf"define (?:dso_local )?void @{re.escape(task)}\((%struct\.RuntimeContext(?:\.\d+)?\*)")
        found = head.search(text)
        if found is None:
            raise UnsuitableError(f"it has no function {task}")
        # Tasks may name the type of their argument differently.
        given, context = found[1], context or found[1]
        text = text.replace(found[0], f"define internal void @{name}_{number}({given}")
        calls.append(f"  %context{number} = bitcast {context} %context to {given}")
        calls.append(f"  call void @{name}_{number}({given} %context{number})")
    return f"{text}\ndefine void @{name}({context} %context) {{\n" + "\n".join(calls) + "\n  ret void\n}\n"
