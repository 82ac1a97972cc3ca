"""The real training in the loop: deterministic, resumed bit for bit, guarded, on a tiny capture."""

import os
import signal
from dataclasses import replace

import numpy as np
import pytest
import torch
from small_trainings import read_log

from jghand_engine.avatar.avatar import AvatarInfo
from jghand_engine.avatar.file import load_avatar, save_avatar
from jghand_engine.captures.capture_folder import open_capture
from jghand_engine.captures.splits import split_capture
from jghand_engine.learn.checkpoint import Snapshot, load_checkpoint
from jghand_engine.learn.pictures import Pictures
from jghand_engine.learn.run import RunOptions, train
from jghand_engine.learn.schedule import Budget, Every
from jghand_engine.learn.step import HandTraining, Material
from jghand_engine.learn.work_folder import Start, stamp_of
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import RenderSettings, ShadowMode
from jghand_engine.template.builtin import load_template, load_template_with_forearm

# by 10 degrees, a little more than those of captures
TURN = np.array([0.996, 0.05, -0.04, 0.06])


@pytest.fixture
def build(small_capture, tiny):
    """Makes trainings of the tiny capture."""
    split = split_capture(open_capture(small_capture))

    def make(options=tiny, forearm=None):
        template = load_template() if forearm is None else load_template_with_forearm()
        samples = [replace(sample, forearm=forearm) for sample in split.train]
        info = AvatarInfo("tiny", template.identifier, "test")
        return HandTraining(Material(samples, split.test[:1], template, info), options)

    return make


@pytest.fixture
def options(small_capture, tiny, tmp_path):
    stamp = stamp_of(tiny, open_capture(small_capture).samples)
    return RunOptions(
        tmp_path / "hand.jghand", tmp_path / "work", stamp, Budget(steps=24), log_steps=1,
        checkpoint=Every(steps=10), preview=Every(steps=1000),
    )  # fmt: skip


def losses(training: HandTraining, steps: int) -> list[dict[str, float]]:
    training.plan(steps)
    return [training.step(number) for number in range(steps)]


def newest(options: RunOptions) -> Snapshot:
    return load_checkpoint(sorted((options.work / "checkpoints").glob("*.safetensors"))[-1])[0]


# ---- determinism -----------------------------------------------------------------------------------------------------


def test_the_same_seed_gives_identical_losses_and_another_seed_others(build, tiny):
    """Over all levels of detail, and twice round the poses."""
    first = losses(build(), 30)
    assert losses(build(), 30) == first
    assert losses(build(replace(tiny, seed=1)), 3) != first[:3]


def test_a_resumed_training_equals_an_uninterrupted_one_bit_for_bit(build, options, tmp_path):
    """Stopped in the middle of a round, before and after finer Gaussians join."""

    def stopped(at):
        training = build()
        step = training.step

        def and_stop(number):
            if number == at:
                os.kill(os.getpid(), signal.SIGINT)
            return step(number)

        training.step = and_stop
        return training

    straight = replace(options, work=tmp_path / "straight", out=tmp_path / "straight.jghand")
    train(build, straight)
    assert not train(lambda: stopped(7), options).finished
    assert not train(lambda: stopped(15), replace(options, start=Start.RESUME)).finished
    assert train(build, replace(options, start=Start.RESUME)).finished
    a, b = newest(straight), newest(options)
    assert a.scalars == b.scalars
    assert [name for name in a.tensors if not torch.equal(a.tensors[name], b.tensors[name])] == []
    curves = [[line for line in read_log(o.work / "log.jsonl") if "loss" in line] for o in (straight, options)]
    assert [line["loss"] for line in curves[0]] == [line["loss"] for line in curves[1]]
    assert straight.out.read_bytes() == options.out.read_bytes()


@pytest.mark.parametrize(("shadow", "forearm"), [(False, None), (True, None), (True, TURN)], ids=str)
def test_the_finished_avatar_is_drawn_as_it_was_while_learning(build, tiny, small_capture, tmp_path, shadow, forearm):
    """By the renderer that users have, from a file, in front of every camera; of bent fingers, where the shadow is, and
    of a turned forearm, which is short in the pictures."""
    training = build(replace(tiny, shadow=shadow), forearm)
    losses(training, 20 if forearm is None else 2)
    save_avatar(tmp_path / "hand.jghand", training.avatar())
    # the pictures are too small for a shadow that is only drawn where it is seen
    settings = RenderSettings(shadow=ShadowMode.ALWAYS, shadow_samples=tiny.shadow_samples, antialias=False)
    renderer = HandRenderer(load_avatar(tmp_path / "hand.jghand"), settings)
    strengths = []
    for sample in (replace(one, forearm=forearm) for one in open_capture(small_capture).samples):
        view = Pictures().view(sample)
        with torch.no_grad():
            avatar, posed = training._live(), training._posed_bones(sample)
            skin, _ = training._pose(avatar, posed, 1.0)
            rgb, alpha = training._draw_view(avatar, skin, posed.shadow, view.camera)
        ours = renderer.render(sample.hand, view.camera)
        error = np.abs(ours.rgba - torch.cat([rgb, alpha[..., None]], -1).numpy()).max(-1)
        # a Gaussian that hardly passes the cut at 1/255 on one side is left out on the other (RENDERING 3): observed
        # once in 24 pictures, 7 pixels of one, and two Gaussians in one pixel; all others 5e-6, with the shadow 2.3e-5
        # slices are shared where the Gaussians began, not where they have moved to: observed 2.9e-4
        assert float((error > (5e-5 if forearm is None else 5e-4)).mean()) < 5e-3, sample
        assert float(error.max()) < 2 / 255, sample
        strengths.append(posed.shadow)
    assert max(strengths) > 0.5
