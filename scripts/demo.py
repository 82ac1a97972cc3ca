"""Sets everything up, then runs the main job: 21 joints become a rendered, animated hand and a USD file.

    python scripts/demo.py                     the result lies in demo_output/
    python scripts/demo.py --help              what the demo can be told

Needs nothing but Python 3.11 or newer. Options are handed to `jghand demo`. With --blender-python no environment for
Blender is set up: that Python is taken.
"""

import sys

if sys.version_info < (3, 11):  # noqa: UP036  (the very message this line is for)
    sys.exit("Python 3.11 or newer is needed, this is " + sys.version.split()[0])

import ast
import subprocess

import environments
from environments import BLENDER, ENGINE, ROOT, SetupError

# where the options are declared
CLI = ROOT / "jghand_engine" / "cli"
OPTION_CLASSES = {"demo.py": ("Demo",), "options.py": ("AvatarOptions", "ReportOptions")}


def main() -> int:
    given = sys.argv[1:]
    if {"--help", "-h"} & set(given):
        print(f"{__doc__}\nOptions:\n{option_list()}")
        return 0
    engine = environments.ensure(ENGINE)
    command = [str(engine), "-m", "jghand_engine", "demo", *given]
    if not names(given, "--out"):
        command += ["--out", str(ROOT / "demo_output")]
    if not names(given, "--blender-python"):
        try:
            command += ["--blender-python", str(environments.ensure(BLENDER))]
        except SetupError as error:
            print(f"\n{error}\n\nThe demo goes on without Blender.", flush=True)
    return subprocess.run(command, env=environments.clean_variables(), check=False).returncode


def names(arguments: list[str], option: str) -> bool:
    """Whether the option is among the arguments, as `--an-option X` or `--an_option=X`."""
    return any(argument.partition("=")[0].replace("_", "-") == option for argument in arguments)


def option_list() -> str:
    """The options of `jghand demo`, one per line, read from its source: help must not wait for an environment."""
    lines = []
    for file, classes in OPTION_CLASSES.items():
        tree = ast.parse((CLI / file).read_text(encoding="utf-8"))
        for one in tree.body:
            if isinstance(one, ast.ClassDef) and one.name in classes:
                lines += [f"  --{name.replace('_', '-'):<18}{text}" for name, text in documented_fields(one)]
    return "\n".join(lines)


def documented_fields(one: ast.ClassDef) -> list[tuple[str, str]]:
    """Name and docstring of every field of a dataclass that has one, and what it is when left out."""
    found = []
    for field, after in zip(one.body, one.body[1:], strict=False):
        match field, after:
            case ast.AnnAssign(target=ast.Name(id=name), value=default), ast.Expr(value=ast.Constant(value=text)):
                known = default.value if isinstance(default, ast.Constant) else None
                found.append((name, f"{text} ({known})" if known else str(text)))
    return found


if __name__ == "__main__":
    try:
        sys.exit(main())
    except SetupError as problem:
        sys.exit(f"\n{problem}")
    except KeyboardInterrupt:
        sys.exit(130)
