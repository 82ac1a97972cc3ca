"""Whether pictures were held out: an avatar says which it was learned from, and others are warned of."""

from dataclasses import replace

from small_avatars import small_avatar, trained_avatar

from jghand_engine.avatar.avatar import LearnedFrom
from jghand_engine.captures.sample import image_digest
from jghand_engine.learn.evaluate import NOT_KNOWN, held_out


def learned_from(samples):
    avatar = trained_avatar(20)
    told = LearnedFrom("set", "a rule", len(samples), image_digest(samples))
    return replace(avatar, info=replace(avatar.info, learned_from=told))


def test_what_was_held_out_is_measured_without_a_word(capture, split):
    told = held_out(learned_from(split.train), capture, split)
    assert told.split is split
    assert told.warning == ""


def test_another_choice_of_pictures_is_told(capture, split):
    told = held_out(learned_from(split.train[1:]), capture, split)
    assert f"{len(split.train) - 1} pictures of set (a rule)" in told.warning
    assert told.split.test == split.test
    assert told.split.origin.endswith(NOT_KNOWN)


def test_a_painted_avatar_was_learned_from_nothing(capture, split):
    assert held_out(small_avatar(20), capture, split).warning == ""


def test_the_digest_stands_for_the_pictures_in_any_order_and_for_their_poses(capture, split):
    digest = image_digest(capture.samples)
    assert image_digest(capture.samples[::-1]) == digest
    assert image_digest(split.train) != digest
    # captures of our own name their pictures alike
    other = [replace(sample, joints_m=sample.joints_m * 1.01) for sample in capture.samples]
    assert image_digest(other) != digest
