"""A tiny capture and a tiny model, made once: what the real training is tested with."""

import functools
from dataclasses import replace
from pathlib import Path

import pytest
from picture_sets import recorded, write_set
from small_capture import write_small_capture

from jghand_engine.avatar.correctives import PoseNetShape
from jghand_engine.captures.capture_folder import open_capture
from jghand_engine.captures.splits import split_by_rule
from jghand_engine.learn import options as options_module
from jghand_engine.learn import step
from jghand_engine.learn.canonical_points import CanonicalPoints
from jghand_engine.learn.model import ModelOptions
from jghand_engine.learn.options import Schedule, TrainOptions
from jghand_engine.template.builtin import template_called

TINY = TrainOptions(
    model=ModelOptions(gaussians=1500, plane_texels=24, depth_texels=8, hidden=16, pose=PoseNetShape()),
    schedule=Schedule(views=2),
    shadow_samples=4,
)
_PLACE = step.place_points


@functools.cache
def _points_of(identifier: str, count: int, **how) -> CanonicalPoints:
    return _PLACE(template_called(identifier), count, **how)


@pytest.fixture(scope="session")
def small_capture(tmp_path_factory) -> Path:
    """24 pictures of 64 x 48: six poses, four cameras."""
    return write_small_capture(tmp_path_factory.mktemp("capture") / "small")


@pytest.fixture
def tiny(monkeypatch) -> TrainOptions:
    """Options of a model that takes milliseconds a step, which are then also the preset `default`.

    Where the Gaussians of it start is computed once: it takes seconds and always gives the same.
    """

    def place(template, count, **how):
        assert template is template_called(template.identifier)
        return _points_of(template.identifier, count, **how)

    monkeypatch.setattr(step, "place_points", place)
    monkeypatch.setitem(options_module.PRESETS, "default", TINY)
    paper = replace(options_module.PAPER_FAITHFUL, model=TINY.model, shadow_samples=4)
    monkeypatch.setitem(options_module.PRESETS, "paper-faithful", paper)
    return TINY


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    """A set of 4 poses and 4 cameras."""
    return open_capture(write_set(tmp_path_factory.mktemp("set"), recorded(frames=4, cameras=4)))


@pytest.fixture(scope="module")
def split(capture):
    """Of `capture`, half of its poses and cameras held out."""
    return split_by_rule(capture, every_pose=2, every_camera=2)
