"""The rules of the house that a machine can check: who imports whom, sizes, and what never appears.

They read the source as syntax trees and run nothing of it (but for one import in a fresh process).
"""

import ast
import functools
import importlib.util
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ENGINE, ADDON = ROOT / "jghand_engine", ROOT / "blender_addon"

# rooms in the order in which data walks; a room imports only from rooms above it (and from itself)
ROOMS = (
    ("errors", "files", "lock", "color", "json_files", "npz_files"),
    ("native",),
    ("gpu",),
    ("hand",),
    ("avatar",),
    ("render",),
    ("motion",),
    ("template",),
    ("captures",),
    ("export",),
    ("track",),
    ("learn",),
    ("own",),
    ("study",),
    ("service",),
    ("cli",),
)
MODULE_LINES, PUBLIC_PARAMETERS = 600, 8
# MANO exists as a pickle alone: one reader with a list of what it may name
PICKLE_READER = "jghand_engine/template/mano.py"
# packages that draw: numpy, safetensors and the kernels are all that importing them may load
WITHOUT_TORCH = ("avatar", "export", "gpu", "hand", "motion", "native", "render", "service")
LEARNING_ONLY = ("torch", "scipy", "trimesh")
NEVER_IMPORTED = {"pickle", "cPickle", "dill", "cloudpickle", "joblib", "torchvision"}
SHARED_MODULES = ("jghand_engine.motion.conventions", "jghand_engine.service.protocol")
# what Blender's own process has of the hand, copied into the extension with what it imports
SHARED_HAND = (
    "jghand_engine.errors",
    *(f"jghand_engine.hand.{name}" for name in ("joints", "rotations", "canonical", "kinematics", "shapes")),
)


def python_files(*folders: Path) -> list[Path]:
    return sorted(path for folder in folders for path in folder.rglob("*.py"))


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@functools.cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), str(path))


def imports(path: Path) -> Iterator[tuple[str, int]]:
    """Every absolute module name that a file imports, wherever it stands, with its line; those of the engine also
    where it is named relatively."""
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and (not node.level or path.is_relative_to(ENGINE)):
            above = path.relative_to(ROOT).parts[: -node.level] if node.level else ()
            module = ".".join([*above, node.module])
            yield module, node.lineno
            yield from ((f"{module}.{alias.name}", node.lineno) for alias in node.names)


def room(module: str) -> int | None:
    """Place of an engine module's room in ROOMS; None for the package itself and for foreign modules."""
    parts = module.split(".")
    if parts[0] != "jghand_engine" or len(parts) < 2:
        return None
    return next((place for place, names in enumerate(ROOMS) if parts[1] in names), None)


def offences(found: Iterator[str] | list[str]) -> None:
    listed = list(found)
    assert not listed, "\n" + "\n".join(listed)


def test_every_module_of_the_extensions_core_is_in_its_map():
    written = ast.get_docstring(ast.parse((ADDON / "core" / "__init__.py").read_text(encoding="utf-8"))) or ""
    present = {path.stem for path in (ADDON / "core").glob("*.py")} - {"__init__"}
    assert not sorted(present - set(re.findall(r"\w+", written)))


def test_every_room_of_the_engine_is_in_the_list():
    present = {path.stem for path in ENGINE.iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()}
    known = {name for names in ROOMS for name in names}
    assert present - known <= {"__init__", "__main__"}


def test_a_room_imports_only_from_rooms_above_it():
    offences(
        f"{name_of(path)}:{line} imports {module}"
        for path in python_files(ENGINE)
        # None: the package itself and its __main__
        if (own := room(".".join(path.relative_to(ROOT).with_suffix("").parts))) is not None
        for module, line in imports(path)
        if (other := room(module)) is not None and other > own
    )


def test_no_files_of_the_engine_import_one_another_in_a_circle():
    """Imports inside functions count, those for type checkers alone do not."""
    spec = importlib.util.spec_from_file_location("size_of_house", ROOT / "scripts" / "size.py")
    assert spec is not None
    assert spec.loader is not None
    size = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(size)
    offences([", ".join(circle) for circle in size.import_circles(python_files(ENGINE))])


def test_the_engine_never_imports_blender():
    offences(
        f"{name_of(path)}:{line} imports {module}"
        for path in python_files(ENGINE)
        for module, line in imports(path)
        if module.split(".")[0] in {"bpy", "bmesh", "mathutils", "gpu", "blender_addon"}
    )


def test_the_extension_knows_nothing_of_the_engine_but_what_they_share():
    offences(
        f"{name_of(path)}:{line} imports {module}"
        for path in python_files(ADDON)
        for module, line in imports(path)
        if module.split(".")[0] == "torch"
        or (
            module.split(".")[0] == "jghand_engine"
            and not module.startswith((*SHARED_MODULES, *SHARED_HAND))
            and module not in {shared.rpartition(".")[0] for shared in (*SHARED_MODULES, *SHARED_HAND)}
        )
    )


def test_the_extensions_core_imports_without_blender():
    offences(
        f"{name_of(path)}:{line} imports {module}"
        for path in [*python_files(ADDON / "core"), ADDON / "errors.py"]
        for module, line in imports(path)
        if module.split(".")[0] in {"bpy", "bmesh", "mathutils", "gpu"}
    )


def test_the_photographer_needs_blender_and_nothing_else():
    """It runs in a Python that has bpy and numpy, and is a program apart from the engine and the extension."""
    allowed = {"bpy", "mathutils", "numpy"} | sys.stdlib_module_names
    offences(
        f"{name_of(path)}:{line} imports {module}"
        for path in python_files(ADDON / "capture")
        for module, line in imports(path)
        if module.split(".")[0] not in allowed
    )


def test_what_imports_blender_names_its_license():
    first = "# SPDX-License-Identifier: GPL-3.0-or-later\n"
    offences(name_of(path) for path in python_files(ADDON) if not path.read_text(encoding="utf-8").startswith(first))


def test_what_is_shared_needs_nothing_but_the_standard_library():
    offences(
        f"{shared}:{line} imports {module}"
        for shared in SHARED_MODULES
        for module, line in imports(ROOT / (shared.replace(".", "/") + ".py"))
        if module.split(".")[0] not in sys.stdlib_module_names
    )


def test_what_blender_has_of_the_hand_needs_numpy_and_itself_alone():
    offences(
        f"{shared}:{line} imports {module}"
        for shared in SHARED_HAND
        for module, line in imports(ROOT / (shared.replace(".", "/") + ".py"))
        if module.split(".")[0] not in {"numpy", *sys.stdlib_module_names} and not module.startswith(SHARED_HAND)
    )


def test_nothing_imports_what_runs_code_from_files_or_torchvision():
    offences(
        f"{name_of(path)}:{line} imports {module}"
        for path in python_files(ENGINE, ADDON, ROOT / "scripts")
        for module, line in imports(path)
        if module.split(".")[0] in NEVER_IMPORTED and (name_of(path), module) != (PICKLE_READER, "pickle")
    )


def test_no_module_is_longer_than_a_sitting():
    lengths = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in python_files(ENGINE, ADDON)}
    offences(f"{name_of(path)}: {lines} lines" for path, lines in lengths.items() if lines > MODULE_LINES)


def public_functions(path: Path) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and not node.name.startswith("_"):
            yield node


def parameter_count(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    arguments = [*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs]
    return len(arguments) - (bool(arguments) and arguments[0].arg in ("self", "cls"))


def test_public_functions_have_few_parameters():
    offences(
        f"{name_of(path)}:{function.lineno} {function.name} has {parameter_count(function)} parameters"
        for path in python_files(ENGINE, ADDON)
        for function in public_functions(path)
        if parameter_count(function) > PUBLIC_PARAMETERS
    )


def is_swallowing(handler: ast.ExceptHandler) -> bool:
    """Whether a handler catches everything and does nothing with it."""
    catches_all = handler.type is None or (
        isinstance(handler.type, ast.Name) and handler.type.id in ("Exception", "BaseException")
    )
    return catches_all and all(isinstance(statement, ast.Pass) for statement in handler.body)


def test_no_error_is_swallowed():
    offences(
        f"{name_of(path)}:{node.lineno}"
        for path in python_files(ENGINE, ADDON, ROOT / "scripts")
        for node in ast.walk(tree_of(path))
        if isinstance(node, ast.ExceptHandler) and is_swallowing(node)
    )


# the weights of a network that the user installed or chose: loaded as tensors and nothing else
TENSOR_LOADER = "jghand_engine/learn/perceptual.py"


def loads_tensors_only(call: ast.Call) -> bool:
    return any(k.arg == "weights_only" and isinstance(k.value, ast.Constant) and k.value.value is True
               for k in call.keywords)  # fmt: skip


def test_torch_files_are_never_loaded():
    """torch.load and numpy's allow_pickle=True run code of the file; with weights_only torch does not."""
    found = []
    for path in python_files(ENGINE, ADDON, ROOT / "scripts"):
        for node in ast.walk(tree_of(path)):
            if not isinstance(node, ast.Call):
                continue
            unsafe = any(
                keyword.arg == "allow_pickle"
                and not (isinstance(keyword.value, ast.Constant) and not keyword.value.value)
                for keyword in node.keywords
            )
            loads = ast.unparse(node.func) == "torch.load"
            if unsafe or (loads and not (name_of(path) == TENSOR_LOADER and loads_tensors_only(node))):
                found.append(f"{name_of(path)}:{node.lineno}")
    offences(found)


def test_kernels_are_never_built_with_relaxed_arithmetic():
    forbidden = ("-ffast-math", "-Ofast", "-ffinite-math-only", "-funsafe-math-optimizations", "-fassociative-math")
    sources = [path for path in [*python_files(ENGINE), ROOT / "setup.py"] if path.exists()]
    offences(
        f"{name_of(path)}:{node.lineno} {node.value}"
        for path in sources
        for node in ast.walk(tree_of(path))
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value.strip() in forbidden
    )
    offences(
        name_of(path)
        for path in [*ENGINE.rglob("*.cpp"), *ENGINE.rglob("*.h")]
        if "pragma float_control" in path.read_text(encoding="utf-8")
    )


def test_importing_the_package_loads_nothing_heavy():
    """Blender's Python has neither torch nor numpy 2; it imports the package for the shared modules alone."""
    code = (
        "import sys; import jghand_engine.motion.conventions, jghand_engine.service.protocol; "
        "print([m for m in ('torch', 'numpy', 'scipy', 'pxr', 'PIL', 'tyro', 'rich') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("package", WITHOUT_TORCH)
def test_what_draws_loads_nothing_that_only_learning_needs(package):
    modules = [name_of(path).removesuffix(".py").replace("/", ".") for path in python_files(ENGINE / package)]
    code = (
        f"import importlib, sys\nfor module in {modules}: importlib.import_module(module)\n"
        f"print([m for m in {LEARNING_ONLY} if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_package_imports_where_torchvision_and_the_optional_packages_are_missing():
    code = (
        "import sys\n"
        "absent = ('torchvision', 'mediapipe', 'bpy', 'anny', 'imageio_ffmpeg', 'trimesh')\n"
        "sys.modules.update(dict.fromkeys(absent))\n"
        "import jghand_engine.cli, jghand_engine.export.pictures, jghand_engine.render.camera\n"
    )
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)


def test_no_two_test_files_share_a_name():
    """pytest imports them by their bare names; the second one would stop the whole run."""
    names: dict[str, list[str]] = {}
    for path in python_files(ROOT / "tests"):
        if path.name.startswith("test_") and "blender" not in path.parts:
            names.setdefault(path.name, []).append(name_of(path))
    offences([" and ".join(paths) for paths in names.values() if len(paths) > 1])


def test_scripts_that_import_blender_or_the_extension_say_that_they_are_gpl_and_stand_in_the_notice():
    scripts = ROOT / "scripts"
    found = {
        name_of(path)
        for path in python_files(scripts)
        if {"bpy", "blender_addon"} & {module.split(".")[0] for module, _ in imports(path)}
    }
    assert found == set(
        re.findall(r"scripts/\w+\.py", (ROOT / "NOTICE").read_text(encoding="utf-8").split("Files made")[0])
    )
    offences([name for name in found if "GPL-3.0-or-later" not in (ROOT / name).read_text(encoding="utf-8")[:60]])
