"""The ablation: every variant is trained alike, drawn alike, and goes on where it was stopped."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch
from lit_samples import known_light, write_lit_capture
from small_avatars import trained_avatar

from jghand_engine.avatar.builtin import load_builtin, load_painted
from jghand_engine.avatar.file import load_avatar
from jghand_engine.avatar.lamp_rows import irradiance_at
from jghand_engine.avatar.relighting import estimated
from jghand_engine.captures.capture_folder import open_capture
from jghand_engine.cli import main
from jghand_engine.errors import InputError
from jghand_engine.export.pictures import read_png
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import named_pose
from jghand_engine.hand.skeleton import Transform
from jghand_engine.learn.ablation import LiveHand, chosen_variants
from jghand_engine.learn.known_light import lamps_in_world
from jghand_engine.learn.options import TrainOptions, ablations
from jghand_engine.learn.step import HandTraining
from jghand_engine.render.camera import Camera
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import RenderSettings

COUNT = 3000


@pytest.fixture(scope="module")
def avatar():
    return load_painted(handedness=Handedness.RIGHT).prefix(COUNT)


@pytest.fixture(scope="module")
def camera():
    target, up = torch.tensor([0.0, 0.08, 0.0]), torch.tensor([0.0, 1.0, 0.0])
    return Camera.looking_at(torch.tensor([0.1, 0.1, 0.6]), target, up, width=96, height=128, focal_px=250)


def posed(avatar, name):
    return named_pose(name, avatar.canonical_joints_m, handedness=Handedness.RIGHT)


@pytest.mark.parametrize("name", ["open", "point"])
def test_what_is_trained_is_drawn_as_users_see_it(camera, name):
    """With its light, gloss, correctives and shadow."""
    avatar, settings = trained_avatar(2000), RenderSettings(reuse=False, antialias=False)
    renderer, live = HandRenderer(avatar, settings), LiveHand(avatar, settings)
    wanted = renderer.render(posed(avatar, name), camera).rgba
    came = live(posed(avatar, name), Handedness.RIGHT, camera)
    # worst observed 2e-5: positions are relative to the wrist there
    np.testing.assert_allclose(came, wanted, rtol=0, atol=1e-4)


def test_the_transform_that_the_avatar_names_is_used(avatar, camera):
    """On a hand with fingers a quarter longer, the transforms differ."""
    joints = posed(avatar, "open")
    longer = joints.copy()
    for level in (6, 11, 16):
        for joint in range(level, level + 5):
            longer[joint] = longer[joint - 5] + 1.25 * (joints[joint] - joints[joint - 5])
    ours, halo = (
        LiveHand(replace(avatar, info=replace(avatar.info, transform=kind)), RenderSettings())(
            longer, Handedness.RIGHT, camera
        )
        for kind in (Transform.JOINTS, Transform.HALO_LIKE)
    )
    top = [int(np.flatnonzero((rgba[..., 3] > 0.5).any(1))[0]) for rgba in (ours, halo)]
    assert top[0] + 3 < top[1], "without our transform the fingers stay short"


def test_variants_are_chosen_by_name_in_the_papers_order():
    options = TrainOptions()
    assert list(chosen_variants(options, ())) == list(ablations(options))
    assert list(chosen_variants(options, ("full", "w/o trans"))) == ["w/o trans", "full"]
    with pytest.raises(InputError, match="w/o screen shadow, w/o cast shadow, "):
        chosen_variants(options, ("w/o hands",))


@pytest.fixture(scope="module")
def two_poses_held_out(small_capture, tmp_path_factory):
    folder = shutil.copytree(small_capture, tmp_path_factory.mktemp("split") / "small")
    (sequence,) = open_capture(folder).sequences
    (folder / "splits.json").write_text(json.dumps({"format": 1, "test_frames": {sequence: [10, 40]}}))
    return folder


@pytest.fixture
def ablate(two_poses_held_out, tiny, tmp_path, capsys):
    def run(*words):
        code = main(["ablate", str(two_poses_held_out), "--out", str(tmp_path / "out"), *map(str, words)])
        said = capsys.readouterr()
        assert "Traceback" not in said.err
        return code, said.out, said.err

    return run


def test_an_ablation_leaves_a_table_figures_and_a_sheet(ablate, tmp_path):
    code, out, err = ablate("--steps", 2, "--limit", 2, "--variants", "full", "w/o trans", "w/o iso")
    assert code == 0, err
    assert "Ablation" in out
    content = json.loads((tmp_path / "out" / "ablation.json").read_text())
    assert list(content["variants"]) == ["w/o trans", "w/o iso", "full"]
    for name, transform in (("without_trans", Transform.HALO_LIKE), ("full", Transform.JOINTS)):
        assert load_avatar(tmp_path / "out" / f"{name}.jghand").info.transform is transform
    assert content["variants"]["full"]["means"]["all"]["psnr_full"] > 0
    assert "w/o screen shadow | - |" in (tmp_path / "out" / "ablation.md").read_text()
    assert read_png(tmp_path / "out" / "ablation.png").shape[1] > 800
    assert read_png(tmp_path / "out" / "isotropic_anisotropic.png").shape[1] > 1600


def test_a_capture_in_known_light_gets_the_table_of_its_light(tmp_path, tiny, capsys, monkeypatch):
    """Rows that share the first part of their training, and pictures of each new kind of light."""
    hand = estimated(load_builtin(handedness=Handedness.RIGHT)).prefix(1000)
    folder, out, steps = write_lit_capture(tmp_path / "lit", hand), tmp_path / "out", []
    step = HandTraining.step
    monkeypatch.setattr(HandTraining, "step", lambda self, number: steps.append(number) or step(self, number))
    rows = ("one light", "w/o shadows and lamps", "full")
    assert main(["ablate", str(folder), "--out", str(out), "--steps", "4", "--limit", "1", "--variants", *rows]) == 0
    assert "Known light" in capsys.readouterr().out
    assert steps == [0, 1, 2, *range(4), 3, 3], "three that are shared, all of one light, and the last of each"
    variants = json.loads((out / "ablation.json").read_text())["variants"]
    assert list(variants) == ["one light", "estimated", *rows[1:]]
    kinds = ["new pose", "new camera", "new world", "new world and lamps", "spot from behind", "all new"]
    for name, one in variants.items():
        assert [picture["category"] for picture in one["pictures"]] == kinds, name
    assert len({one["means"]["all"]["psnr_box"] for one in variants.values()}) == len(variants)
    assert "| w/o shadows and lamps | " in (out / "ablation.md").read_text()
    assert read_png(out / "ablation.png").shape[0] > 6 * 264


def test_lamps_in_the_world_light_the_middle_of_the_hand_as_before():
    light, middle_m = known_light(0).weighted(np.ones((3, 3))), np.array([0.02, 0.1, 0.0])
    inside = lamps_in_world(light, middle_m)
    assert not inside.lamps
    facing = irradiance_at(np.array([lamp.numbers for lamp in light.lamps]), middle_m[None])[:, 0].sum(0)
    np.testing.assert_allclose(inside.world.terms.light.sum(0) - light.world.terms.light.sum(0), facing, rtol=1e-4)


@pytest.mark.parametrize(
    ("words", "said"),
    [(("--steps", 0), "1 or more"), (("--limit", -1), "0 or more"), (("--variants", "w/o hands"), "variant: wanted")],
)
def test_bad_options_are_refused_before_anything_is_trained(ablate, tmp_path, words, said):
    code, _, err = ablate(*words)
    assert code == 2
    assert said in err
    assert not (tmp_path / "out").exists()
