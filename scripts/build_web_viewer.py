"""Builds what `jghand export web` puts beside every hand: jghand_engine/assets/web.

    python scripts/build_web_viewer.py

To be run with the engine's Python. Needs Node and npm, and the registry of npm the first time: the packages are pinned
with their hashes in scripts/web_viewer/package-lock.json and go into .envs/web_viewer (JGHAND_WEB_VIEWER names another
folder).

    index.html     page.html with page.css
    pose.js        scripts/web_viewer/pose, with the engine's kernels compiled to WebAssembly: what poses the hand
    viewer.js      scripts/web_viewer/viewer with three.js, packed: it unpacks itself
    LICENSES.txt   of all that is in them
"""

from __future__ import annotations

import argparse
import base64
import gzip
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ROOT / "scripts" / "web_viewer"
TARGET = ROOT / "jghand_engine" / "assets" / "web"
PACKAGES = Path(os.environ.get("JGHAND_WEB_VIEWER") or ROOT / ".envs" / "web_viewer")
NATIVE = ROOT / "jghand_engine" / "native"
KERNELS = ("skeleton", "skin", "learned", "learned_cast", "learned_correction", "scene_light", "bounce", "detail")
# what pose.js calls of them: nothing else gets into it
CALLED = (
    *("jg_bone_transforms", "jg_skin", "jg_learned_pose", "jg_learned_gloss", "jg_learned_task_bytes"),
    *("jg_detail_vertices", "jg_detail_hand_bytes", "jg_detail_task_bytes"),
)
# of the native library (native/build.py), and what WebAssembly adds; a stack for two layers of a network
FLAGS = (
    *("-O3", "-std=c++17", "-fno-math-errno", "-fno-trapping-math", "-ffp-contract=fast", "-fno-exceptions"),
    *("-fno-rtti", "-fno-threadsafe-statics", "-fvisibility=hidden", "-nostdlib++", "-s"),
    *("-target", "wasm32-wasi", "-mexec-model=reactor", "-mcpu=generic+simd128+bulk_memory"),
    *(f"-Wl,--export={name}" for name in ("__heap_base", *CALLED)),
    "-Wl,-z,stack-size=262144",
)
# browsers of 2023 and later: vectors in WebAssembly and the unpacking of gzip ask for those anyway
BROWSERS = "--target=chrome111,firefox113,safari16.4"
LICENSED = ("three",)
UNPACK = """/*! three.js and JGHand's viewer, MIT: see LICENSES.txt */
(async () => {
  const bytes = Uint8Array.from(atob('@PACKED@'), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('gzip'));
  const text = await new Response(stream).text();
  const script = document.createElement('script');
  script.src = URL.createObjectURL(new Blob([text], { type: 'text/javascript' }));
  document.head.append(script);
})().catch((error) => {
  document.getElementById('message').textContent = `This browser is too old to show the hand.\\n${error.message}`;
});
"""


def source_hash() -> str:
    """SHA-256 over everything that the scripts are made of; pose.js carries that of its own build."""
    digest = hashlib.sha256(repr((FLAGS, BROWSERS, LICENSED, UNPACK, _compiler())).encode())
    headers = sorted(NATIVE.glob("*.h"))
    sources = [NATIVE / f"{name}.cpp" for name in KERNELS]
    for path in [*sources, *headers, *sorted(path for path in SOURCES.rglob("*") if path.is_file())]:
        digest.update(path.name.encode() + b"\0" + path.read_bytes().replace(b"\r\n", b"\n"))
    return digest.hexdigest()


def stamp() -> str:
    """The hash that the package's pose.js carries."""
    found = re.search(r"sources=([0-9a-f]{64})", (TARGET / "pose.js").read_text(encoding="utf-8")[:200])
    return found[1] if found else ""


def _compiler() -> str:
    pin = re.search(r"ziglang==([0-9.]+)", (ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    return pin[1] if pin else ""


def run(*command: str | Path, **options) -> None:
    """RuntimeError with a program's last words when it fails."""
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False, **options)
    if done.returncode:
        raise RuntimeError(f"{' '.join(map(str, command[:4]))} …: {(done.stdout + done.stderr).strip()[-2000:]}")


def install() -> None:
    """The packages, each of the hash in the lock file."""
    install_packages(SOURCES, PACKAGES)


def install_packages(wanted: Path, folder: Path) -> None:
    """Puts the packages of wanted/package-lock.json into `folder`, unless they are there."""
    folder.mkdir(parents=True, exist_ok=True)
    # npm writes this file itself, and may be stopped half-way: what came to its end is told by a copy of our own
    lock, done = (wanted / "package-lock.json").read_bytes(), folder / "installed-lock.json"
    if (folder / "node_modules").is_dir() and done.exists() and done.read_bytes() == lock:
        return
    for name in ("package.json", "package-lock.json"):
        shutil.copyfile(wanted / name, folder / name)
    done.unlink(missing_ok=True)
    run("npm", "ci", "--ignore-scripts", "--no-audit", "--no-fund", cwd=folder)
    done.write_bytes(lock)


def compile_kernels(path: Path) -> None:
    """The engine's kernels as WebAssembly, by the compiler that builds the native library."""
    sources = [NATIVE / f"{name}.cpp" for name in KERNELS]
    run(sys.executable, "-m", "ziglang", "c++", *FLAGS, *sources, "-o", path)


def bundle(work: Path, entry: str, *options: str) -> str:
    """One script without imports. Modules are looked up from where the sources lie, so they are copied there."""
    out = work / f"{entry}.out.js"
    run(
        "node", PACKAGES / "node_modules" / "esbuild" / "bin" / "esbuild", work / entry / "index.js",
        "--bundle", "--format=iife", "--minify", "--legal-comments=none", BROWSERS, *options, f"--outfile={out}",
        cwd=work,
    )  # fmt: skip
    return out.read_text(encoding="utf-8")


def build(folder: Path) -> None:
    """Writes the four files into `folder`."""
    install()
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=PACKAGES) as name:
        work = Path(name)
        for part in ("pose", "viewer"):
            shutil.copytree(SOURCES / part, work / part)
        compile_kernels(work / "pose" / "kernels.wasm")
        pose = bundle(work, "pose", "--global-name=JGHandPose", "--loader:.wasm=binary")
        viewer = bundle(work, "viewer")
    page = (SOURCES / "page.html").read_text(encoding="utf-8")
    style = re.sub(r"\s*\n\s*", "\n", (SOURCES / "page.css").read_text(encoding="utf-8")).strip()
    files = {
        "index.html": page.replace("@STYLE@", style),
        "pose.js": f"/*! JGHand, MIT: see LICENSES.txt. sources={source_hash()} */\n{pose}",
        "viewer.js": packed(viewer),
        "LICENSES.txt": licenses(),
    }
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8", newline="\n")


def packed(script: str) -> str:
    """A script that unpacks itself."""
    return UNPACK.replace("@PACKED@", base64.b64encode(gzip.compress(script.encode(), 9, mtime=0)).decode())


def licenses() -> str:
    """The texts of all that the scripts hold."""
    import ziglang

    parts = [("JGHand: the page, pose.js and what draws in viewer.js", (ROOT / "LICENSE").read_text())]
    for name in LICENSED:
        about = json.loads((PACKAGES / "node_modules" / name / "package.json").read_text(encoding="utf-8"))
        text = (PACKAGES / "node_modules" / name / "LICENSE").read_text(encoding="utf-8")
        parts.append((f"{name} {about['version']}, in viewer.js", text))
    libc = Path(ziglang.__file__).parent / "lib" / "libc"
    for title, path in (("musl", libc / "musl" / "COPYRIGHT"), ("wasi-libc", libc / "wasi" / "LICENSE-MIT")):
        parts.append((f"{title}: functions of mathematics in the WebAssembly of pose.js", path.read_text()))
    notice = (ROOT / "NOTICE").read_text(encoding="utf-8")
    hands = notice[notice.index("Files made from") : notice.index("Neither anny")]
    parts.append(("Where hand.js is JGHand's built-in or painted hand: from its NOTICE", hands))
    parts.append(("Of parts of those hands", (ROOT / "LICENSES" / "Apache-2.0.txt").read_text(encoding="utf-8")))
    head = "What the scripts of this folder are made of. The hand itself, hand.js, has the license that it names.\n"
    return head + "".join(f"\n{'=' * 78}\n{title}\n{'=' * 78}\n\n{text.strip()}\n" for title, text in parts)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.parse_args()
    build(TARGET)
    for path in sorted(TARGET.iterdir()):
        print(f"{path.relative_to(ROOT)} {path.stat().st_size} bytes")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
