"""The compiled kernels: build, choice of variant, threads.

build      compiles every *.cpp of this folder into one library per variant (C headers only, no std::)
library    loads the right variant, declares its functions (SIGNATURES), checks arrays handed to them
threads    WorkerPool: all threads make one call, which shares its items between them (team.h)

To add a kernel: write name.cpp, mark its functions JG_API (export.h), declare them in library.SIGNATURES, and raise ABI
in library.py and library.cpp when a signature changes.
"""
