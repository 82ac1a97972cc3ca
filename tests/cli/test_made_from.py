"""What a folder of frames says it was made from: the motion by the content of all its files, wherever they lie."""

import shutil
from pathlib import Path

import motion_samples as samples
import numpy as np
import pytest

from jghand_engine.avatar.builtin import load_avatar_called
from jghand_engine.avatar.forearm import ended
from jghand_engine.cli.frame_files import render_stamp
from jghand_engine.cli.inputs import load_motion
from jghand_engine.cli.options import FormatOptions, MotionOptions
from jghand_engine.hand.sequence import PoseSequence
from jghand_engine.motion.files import write_motion
from jghand_engine.render.settings import preset

AVATAR = ended(load_avatar_called("painted"))
MOVED = np.array([0.001, 0.0, 0.0])


def stamp(path: Path | None = None, **words) -> dict[str, str]:
    options = MotionOptions(motion=path, format=FormatOptions(hand="right"), **words)
    return render_stamp("avatar", options, load_motion(options, AVATAR), preset("draft"), {}, whole=True)


@pytest.fixture(scope="module")
def motion():
    return samples.motion(frames=6)


def moved(motion):
    return PoseSequence(motion.joints_m + MOVED, motion.fps, motion.handedness)


def test_a_stage_whose_referenced_layer_alone_was_written_anew_is_another_motion(tmp_path, motion):
    from pxr import Usd, UsdGeom

    samples.write_usd(tmp_path / "hand.usda", samples.rig(motion))
    stage = Usd.Stage.CreateNew(str(tmp_path / "shot.usda"))
    stage.GetRootLayer().subLayerPaths.append("./hand.usda")
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.Save()
    before = stamp(tmp_path / "shot.usda")
    (tmp_path / "other").mkdir()
    samples.write_usd(tmp_path / "other" / "hand.usda", samples.rig(moved(motion)))
    # in another folder: USD keeps what it has read of a path in mind
    shutil.copy(tmp_path / "shot.usda", tmp_path / "other" / "shot.usda")
    assert stamp(tmp_path / "other" / "shot.usda")["motion"] != before["motion"]


def test_the_same_frames_are_the_same_choice_however_they_are_said(tmp_path, motion):
    file = tmp_path / "wave.npz"
    write_motion(file, motion)
    whole = stamp(file)
    for words in (":", "0-5", "0:5", "0:99", "0:5:1"):
        assert stamp(file, frames=words) == whole
    for words in ("1:", "0:4", "0:5:2"):
        assert stamp(file, frames=words)["choice of frames"] != whole["choice of frames"]
    assert stamp(file, frames="3") == stamp(file, frames="3:3:2")
