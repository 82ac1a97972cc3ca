"""Drawing and its exports need the packages of `pip install jghand` alone: no torch, no scipy, no trimesh."""

import importlib.metadata
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import bundled_engine
import pytest
from small_avatars import coarse_builtin

from jghand_engine.avatar.file import save_avatar

ROOT = Path(__file__).resolve().parents[1]


def base_packages() -> set[str]:
    """What pyproject.toml lists, and what these want in turn; extras and other systems left out."""
    named = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["dependencies"]
    found: set[str] = set()
    wanted = [re.split(r"[<>=!~ ;\[]", one)[0] for one in named]
    while wanted:
        name = re.sub(r"[-_.]+", "-", wanted.pop()).lower()
        if name in found:
            continue
        found.add(name)
        for one in importlib.metadata.requires(name) or ():
            requirement, _, marker = one.partition(";")
            # markers of this system's Python are few; one too many here would only make the test milder
            if not marker:
                wanted.append(re.split(r"[<>=!~ (\[]", requirement.strip())[0])
    return found


@pytest.fixture(scope="module")
def only_base(tmp_path_factory) -> Path:
    """A folder that holds the base packages and nothing else."""
    folder = tmp_path_factory.mktemp("base_packages")
    for name in base_packages():
        link_package(name, folder)
    return folder


@pytest.fixture(scope="module")
def hand(tmp_path_factory) -> str:
    path = tmp_path_factory.mktemp("hand") / "hand.jghand"
    save_avatar(path, coarse_builtin())
    return str(path)


def link_package(name: str, folder: Path) -> None:
    distribution = importlib.metadata.distribution(name)
    for top in {Path(file).parts[0] for file in distribution.files or ()} - {"..", "__pycache__"}:
        if not (folder / top).exists():
            (folder / top).symlink_to(Path(str(distribution.locate_file(top))).resolve())


def run(only_base: Path, *words: str) -> subprocess.CompletedProcess[str]:
    code = f"import sys; sys.path[:0] = [{str(only_base)!r}, {str(ROOT)!r}]; from jghand_engine.cli import main; "
    code += f"sys.exit(main({list(words)!r}))"
    # -S: no site-packages; -I: no PYTHONPATH, nothing of the user's
    return subprocess.run([sys.executable, "-I", "-S", "-c", code], capture_output=True, text=True, check=False)


def test_a_hand_is_drawn_with_the_base_packages_alone(only_base, hand, tmp_path):
    words = ("render", "--poses", "open", "--size", "64x64", "--avatar", hand, "--out", str(tmp_path))
    done = run(only_base, *words)
    assert done.returncode == 0, done.stderr
    assert list(tmp_path.rglob("*.png"))


@pytest.mark.parametrize("kind", ["ply", "usd"])
def test_what_blender_exports_needs_no_more_than_the_zip_carries(hand, kind, tmp_path):
    """Beside numpy, and the USD that Blender has of its own. It carries a part of the base packages."""
    carried = (*bundled_engine.PURE, *bundled_engine.COMPILED)
    assert {name.lower().replace("_", "-") for name in carried} <= base_packages()
    folder = tmp_path / "packages"
    folder.mkdir()
    for name in (*carried, "numpy", "usd-core"):
        link_package(name, folder)
    done = run(folder, "export", kind, "--poses", "open", "--avatar", hand, "--out", str(tmp_path / "out"))
    assert done.returncode == 0, done.stderr


def test_what_learns_says_which_extra_it_wants(only_base, tmp_path):
    done = run(only_base, "evaluate", "builtin", str(tmp_path))
    assert done.returncode == 2
    assert "jghand[learn]" in done.stderr
