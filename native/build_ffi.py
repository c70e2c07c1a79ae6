"""Build zoo._native from native/src with cffi; the declarations are read from the public header."""

import re
import sys
from pathlib import Path

from cffi import FFI

ROOT = Path(__file__).parent
HEADER = (ROOT / "include" / "zoo.h").read_text(encoding="utf-8")
DECLARATIONS = HEADER.split("/* cffi:begin */")[1].split("/* cffi:end */")[0]

# No -march: step.c carries a version for each instruction set and picks one when loaded.
# The two -fno flags only drop errno and trap semantics, which no code here reads.
FLAGS = ["-std=gnu11", "-O3", "-ffp-contract=fast", "-fno-math-errno", "-fno-trapping-math", "-Wno-psabi"]

ffibuilder = FFI()
ffibuilder.cdef(re.sub(r"/\*.*?\*/", "", DECLARATIONS, flags=re.S))
ffibuilder.set_source(
    "zoo._native",
    '#include "zoo.h"',
    sources=[f"native/src/{path.name}" for path in sorted((ROOT / "src").glob("*.c"))],
    include_dirs=["native/include"],
    depends=[f"native/{path.relative_to(ROOT)}" for path in sorted(ROOT.glob("*/*.h"))],
    extra_compile_args=[] if sys.platform == "win32" else FLAGS,
)
