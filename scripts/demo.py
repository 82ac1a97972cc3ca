"""Sets everything up, then runs the main job: 21 joints become a rendered, animated hand and a USD file.

    python scripts/demo.py                     the result lies in demo_output/
    python scripts/demo.py --help              what the demo can be told

Needs nothing but Python 3.11 or newer. Options are those of scripts/demo_job.py. With --blender-python no environment
for Blender is set up: that Python is taken.
"""

import sys

if sys.version_info < (3, 11):  # noqa: UP036  (the very message this line is for)
    sys.exit("Python 3.11 or newer is needed, this is " + sys.version.split()[0])

import subprocess

import environments
from environments import BLENDER, ENGINE, ROOT, SetupError

JOB = ROOT / "scripts" / "demo_job.py"


def main() -> int:
    given = sys.argv[1:]
    if {"--help", "-h"} & set(given):
        # its help is there before any environment is
        return subprocess.run([sys.executable, str(JOB), "--help"], check=False).returncode
    engine = environments.ensure(ENGINE)
    command = [str(engine), str(JOB), *given]
    if not names(given, "--out"):
        command += ["--out", str(ROOT / "demo_output")]
    if not names(given, "--blender-python"):
        try:
            command += ["--blender-python", str(environments.ensure(BLENDER))]
        except SetupError as error:
            print(f"\n{error}\n\nThe demo goes on without Blender.", flush=True)
    return subprocess.run(command, env=environments.clean_variables(), check=False).returncode


def names(arguments: list[str], option: str) -> bool:
    """Whether the option is among the arguments, as `--an-option X` or `--an-option=X`."""
    return any(argument.partition("=")[0] == option for argument in arguments)


if __name__ == "__main__":
    try:
        sys.exit(main())
    except SetupError as problem:
        sys.exit(f"\n{problem}")
    except KeyboardInterrupt:
        sys.exit(130)
