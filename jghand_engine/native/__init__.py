"""The compiled kernels: build, choice of variant, threads.

build      compiles every *.cpp of this folder into one library per variant (C headers only, no std::)
binding    declares the functions (SIGNATURES), checks arrays handed to them, opens a library file
selftest   does a library compute on this machine what it should
mean       images averaged in linear light, for motion blur and depth of field
tasks      what the calls for skin and shadow take; learned_tasks: those for trained skin
library    chooses, builds and tests: `load` gives the library to use
threads    WorkerPool: all threads make one call, which shares its items between them (team.h)

To add a kernel: write name.cpp, mark its functions JG_API (export.h), declare them in binding.SIGNATURES, and raise ABI
in binding.py and library.cpp when a signature changes.
"""
