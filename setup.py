"""The part of the package build that pyproject.toml cannot say: compile the native library, tag the wheel.

`pip wheel .` puts the libraries of this machine into a wheel `py3-none-<platform>` (they are loaded with ctypes, so one
wheel serves every Python); `pip install -e .` builds them in place. Where no compiler is found the package still
installs, and the first command that draws tries again; JGHAND_REQUIRE_NATIVE=1 makes that an error.
"""

import os
import sys
from pathlib import Path

from setuptools import Distribution, setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_py import build_py

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))  # build isolation starts without the project's folder on the path

from jghand_engine.errors import JGHandError  # noqa: E402
from jghand_engine.native import build  # noqa: E402


class BuildWithNative(build_py):
    """Compiles the native library beside the Python files: in the source tree for an editable install."""

    def run(self) -> None:
        super().run()
        package = HERE if self.editable_mode else Path(self.build_lib).resolve()
        try:
            for path in build.build_all(build.host_targets(), package / "jghand_engine" / "native" / "lib"):
                print(f"built {path.name}")
        except JGHandError as error:
            if os.environ.get("JGHAND_REQUIRE_NATIVE") == "1":
                raise
            print(f"warning: no kernels, nothing can be drawn before they are built: {error}", file=sys.stderr)


class PlatformWheel(bdist_wheel):
    """One wheel per platform, for every Python 3."""

    def get_tag(self) -> tuple[str, str, str]:
        platform = super().get_tag()[2]
        stamps = [build.read_stamp(path) for path in Path(self.bdist_dir or ".").glob("jghand_engine/native/lib/*")]
        # only zig links against the old C library that the wider tag promises
        if stamps and all(stamp and stamp.compiler.startswith("zig") for stamp in stamps):
            platform = build.host_targets()[0].wheel_tag
        return "py3", "none", platform


class NativeDistribution(Distribution):
    """Tells setuptools that the wheel is not pure, although there is no extension module."""

    def has_ext_modules(self) -> bool:
        return True


setup(cmdclass={"build_py": BuildWithNative, "bdist_wheel": PlatformWheel}, distclass=NativeDistribution)
