"""What a skeleton or a recording costs: counted, not timed."""

from __future__ import annotations

import json
import weakref

import motion_samples as samples
import numpy as np
import pytest

from jghand_engine import limits
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.motion.files import MotionFormat
from jghand_engine.motion.foreign import bvh, json_points
from jghand_engine.motion.foreign.read import read_motion_file
from jghand_engine.motion.foreign.skeleton import down


def test_a_long_chain_of_bones_keeps_only_the_place_of_its_last_one():
    alive = weakref.WeakSet()

    class Place:
        def __init__(self, number):
            self.number = number
            alive.add(self)

    most, seen = 0, []
    chain = list(range(200))
    for bone, place in down(chain, [-1, *chain[:-1]], Place, lambda above, local: Place(above.number + local.number)):
        most = max(most, len(alive))
        seen.append((bone, place.number))
    assert most <= 4
    assert seen == [(bone, bone * (bone + 1) // 2) for bone in chain]


def test_places_are_kept_for_every_child():
    parents = [-1, 0, 1, 0, 3, 1]
    made = dict(down(range(6), parents, lambda bone: {bone}, lambda above, local: above | local))
    assert made == {0: {0}, 1: {0, 1}, 2: {0, 1, 2}, 3: {0, 3}, 4: {0, 3, 4}, 5: {0, 1, 5}}


def test_hands_deeper_in_a_skeleton_than_in_any_rig_are_refused(tmp_path):
    path = tmp_path / "a.bvh"
    samples.write_bvh(path, samples.rig(samples.motion(frames=2), scale=100))
    head, rest = path.read_text().split("\tJOINT RightHand\n", 1)
    hand, frames = rest.split("MOTION\n")

    def read_below(count):
        chain = "".join(f"JOINT j{number}\n{{\nOFFSET 0 0 0\nCHANNELS 0\n" for number in range(count))
        path.write_text(f"{head}{chain}\tJOINT RightHand\n{hand}{'}' * count}\nMOTION\n{frames}")
        return read_motion_file(path).sequence

    # the root is one of them
    assert len(read_below(limits.RIG_DEPTH_MAX - 1)) == 2
    with pytest.raises(InputError, match="its hands hang on 1025 bones, more than 1024"):
        read_below(limits.RIG_DEPTH_MAX)


def test_the_rest_of_a_bvh_is_made_once(tmp_path, monkeypatch):
    made = []
    rest = bvh._Bvh._rest
    monkeypatch.setattr(bvh._Bvh, "_rest", lambda skeleton: made.append(1) or rest(skeleton))
    samples.write_bvh(tmp_path / "a.bvh", samples.rig(samples.motion(frames=2), samples.MIXAMO, 100), end_sites=False)
    read_motion_file(tmp_path / "a.bvh")
    assert len(made) == 1


def test_names_of_joints_that_stay_the_same_are_looked_at_once(tmp_path, monkeypatch):
    looked = []
    among = json_points.hands_among
    monkeypatch.setattr(json_points, "hands_among", lambda names: looked.append(names) or among(names))
    json_points._hands_among.cache_clear()
    joints = samples.webxr_joints(samples.motion()).tolist()
    frames = [
        {"time": number / 30, "right": dict(zip(samples.WEBXR_NAMES, one, strict=True))}
        for number, one in enumerate(joints)
    ]
    (tmp_path / "a.json").write_text(json.dumps(frames))
    read = read_motion_file(tmp_path / "a.json", MotionFormat(handedness=Handedness.RIGHT))
    assert len(read.sequence) == 40
    assert np.abs(read.sequence.joints_m - samples.motion().joints_m).max() < 1e-15
    # those of a hand, and those of the frame around it, which is none
    assert len(looked) <= 2
