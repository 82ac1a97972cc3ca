"""The engine's exporter runs as it is on Blender's own USD: the stage that comes out of it is as sound and as exact.

Blender's Python borrows the engine's other packages, which works where both are of the same version. What writes the
splats themselves needs nothing but numpy and `pxr`, and is tried in every Blender.
"""

import json
import subprocess
import sys
from pathlib import Path

import environments
import pytest

pytest.importorskip("bpy", reason="needs the bpy wheel of this Python")

ROOT = Path(__file__).parents[2]

WRITE = """
import sys
import bpy
bpy.utils.expose_bundled_modules()
from pxr import Usd
sys.path += {paths!r}
from usd_samples import lively_motion, small_avatar
from jghand_engine.export.usd.package import UsdOptions, export_usd
from jghand_engine.hand.joints import Handedness

assert "bpy" in Usd.__file__, Usd.__file__
for name, options in {ways!r}.items():
    export_usd(f"{folder}/{{name}}", small_avatar(), lively_motion(Handedness.LEFT, 6), options=UsdOptions(**options))
print(Usd.GetVersion())
"""
JUDGE = """
import json, sys
import numpy as np
from pxr import Usd
from usd_samples import engine_gaussians, lively_motion, small_avatar
from jghand_engine.export.usd.check import check_usd
from jghand_engine.hand.joints import Handedness

truth, _ = engine_gaussians(small_avatar(), lively_motion(Handedness.LEFT, 6))
told = {{}}
for name in {files!r}:
    stage = Usd.Stage.Open(f"{folder}/{{name}}")
    told[name] = {{"findings": [str(one) for one in check_usd(f"{folder}/{{name}}") if one.is_error], "off_m": 0.0}}
    splats = stage.GetPrimAtPath("/Hand/Splats")
    if splats and splats.GetAttribute("positions").HasAuthoredValue():
        read = [np.array(splats.GetAttribute("positions").Get(frame)) for frame in range(6)]
        told[name]["off_m"] = float(np.abs(np.stack(read) - truth).max())
print(json.dumps(told))
"""
SPLATS = """
import bpy
bpy.utils.expose_bundled_modules()
import sys
from pathlib import Path
import numpy as np
from pxr import Usd
sys.path.insert(0, {root!r})
from jghand_engine.export.usd.stage import TimeRange
from jghand_engine.export.usd.splats import Cloud, Look, Sample, SplatLayer

assert "bpy" in Usd.__file__, Usd.__file__
rng = np.random.default_rng(0)
points, sigma = (rng.uniform(0.001, 0.1, shape).astype(np.float32) for shape in ((5, 500, 3), 500))
opacity, rgb = (rng.uniform(0, 1, shape).astype(np.float32) for shape in (500, (500, 3)))
path = Path({folder!r}) / "splats.usdc"
layer = SplatLayer.new(path, Cloud(points[0], sigma, opacity, rgb), TimeRange(5, 30.0), Look())
for frame in range(5):
    layer.put(frame, Sample(points[frame]))
layer.finish()
np.savez(Path({folder!r}) / "truth.npz", points=points)
print(Usd.GetVersion())
"""
JUDGE_SPLATS = """
import sys
import numpy as np
from pathlib import Path
from pxr import Usd
from jghand_engine.export.usd.check import check_usd

folder = Path({folder!r})
truth = np.load(folder / "truth.npz")["points"]
assert [str(one) for one in check_usd(folder / "splats.usdc") if one.is_error] == []
stage = Usd.Stage.Open(str(folder / "splats.usdc"))  # a prim does not keep its stage alive
splats = stage.GetPrimAtPath("/Splats")
read = [np.array(splats.GetAttribute("positions").Get(frame), np.float64) for frame in range(5)]
assert np.array_equal(np.stack(read), truth)
print("sound")
"""
WAYS = {
    "layers": {},
    "linear": {"radiance": "linear"},
    "usdc": {"package": "usdc"},
    "usdz": {"package": "usdz"},
}
FILES = ("layers/hand.usda", "layers/hand.shot.usda", "linear/hand.usda", "usdc/hand.usdc",
         "usdz/hand.usdz")  # fmt: skip


def in_python(python: Path | str, script: str, paths: list[str]) -> str:
    variables = {**environments.clean_variables(), "PYTHONPATH": ":".join(paths), "OMP_NUM_THREADS": "1"}
    done = subprocess.run([python, "-c", script], capture_output=True, text=True, env=variables, timeout=300)
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stdout.strip().splitlines()[-1]


def test_the_exporter_runs_on_blenders_own_usd(tmp_path):
    engine = environments.ENGINE
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    packages = engine.folder / "lib" / version / "site-packages"
    if not packages.is_dir():
        pytest.skip(f"the engine's environment is not of this {version}")
    ours = [str(ROOT), str(ROOT / "tests" / "export")]
    # behind Blender's own packages: its pxr and its numpy come first
    script = WRITE.format(paths=[*ours, str(packages)], ways=WAYS, folder=tmp_path)
    in_python(sys.executable, script, [])
    told = json.loads(in_python(engine.python, JUDGE.format(files=FILES, folder=tmp_path), ours))
    for name in FILES:
        assert told[name]["findings"] == [], name
        # worst observed 1.2e-7 m, float32 against float64
        assert told[name]["off_m"] < 2e-7, name
    compared = {name.split("/")[0] for name in FILES if told[name]["off_m"] > 0}
    assert compared == {"layers", "linear", "usdc", "usdz"}


def test_every_blender_writes_the_splats_themselves(tmp_path):
    engine = environments.ENGINE.python
    if not engine.is_file():
        pytest.skip("there is no engine environment: run scripts/test.py")
    in_python(sys.executable, SPLATS.format(root=str(ROOT), folder=str(tmp_path)), [])
    assert in_python(engine, JUDGE_SPLATS.format(folder=str(tmp_path)), [str(ROOT)]) == "sound"
