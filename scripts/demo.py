"""Sets everything up, then runs the main job: 21 joints become a rendered, animated hand and a USD file.

    python scripts/demo.py                     the result lies in demo_output/
    python scripts/demo.py --help              what the demo can be told

Needs nothing but Python 3.11 or newer. Options are handed to `jghand demo`.
"""

import sys

if sys.version_info < (3, 11):  # noqa: UP036  (the very message this line is for)
    sys.exit("Python 3.11 or newer is needed, this is " + sys.version.split()[0])

import subprocess

import environments
from environments import BLENDER, ENGINE, ROOT, SetupError


def main() -> int:
    engine = environments.ensure(ENGINE)
    command = [str(engine), "-m", "jghand_engine", "demo", *sys.argv[1:]]
    if not any(argument == "--out" or argument.startswith("--out=") for argument in command):
        command += ["--out", str(ROOT / "demo_output")]
    try:
        command += ["--blender-python", str(environments.ensure(BLENDER))]
    except SetupError as error:
        print(f"\n{error}\n\nThe demo goes on without Blender.", flush=True)
    return subprocess.run(command, env=environments.clean_variables(), check=False).returncode


if __name__ == "__main__":
    try:
        sys.exit(main())
    except SetupError as problem:
        sys.exit(f"\n{problem}")
    except KeyboardInterrupt:
        sys.exit(130)
