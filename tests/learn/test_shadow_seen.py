"""How much the shadow of an avatar is ever seen."""

from dataclasses import replace

import pytest
from small_avatars import small_avatar, trained_avatar

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.learned import ShadowLook
from jghand_engine.learn import shadow_seen as study


@pytest.fixture(autouse=True)
def few_small_views(monkeypatch):
    monkeypatch.setattr(study, "pose_names", lambda: ("open", "fist"))
    monkeypatch.setattr(study, "SIDES", ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0)))
    monkeypatch.setattr(study, "SIZE_PX", (96, 96))


def looking(avatar: HandAvatar, look: ShadowLook | None) -> HandAvatar:
    return replace(avatar, learned=replace(avatar.learned, shadow=look))


def test_a_darker_look_is_seen_more_and_none_not_at_all():
    avatar = trained_avatar(2000)
    dark, faint, none = (
        study.shadow_seen(looking(avatar, ShadowLook(gain, (0.6, 0.7, 0.8)))) for gain in (6.0, 0.1, 0.0)
    )
    assert 0.0 < 10 * faint < dark < 0.8  # never beyond the tint
    assert none == 0.0


def test_what_was_measured_is_kept_with_the_look():
    avatar, parts = trained_avatar(2000), []
    measured = study.with_shadow_seen(avatar, parts.append)
    assert measured.learned.shadow == replace(avatar.learned.shadow, seen=study.shadow_seen(avatar))
    assert parts == sorted(parts)
    assert parts[-1] == 1.0


def test_an_avatar_without_a_learned_shadow_stays_as_it_is():
    for avatar in (small_avatar(), looking(trained_avatar(), None)):
        assert study.with_shadow_seen(avatar) is avatar
