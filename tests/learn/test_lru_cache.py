"""What was used recently is kept, up to its room."""

from __future__ import annotations

from jghand_engine.learn.pictures import LruCache


def test_a_value_is_made_once_while_there_is_room():
    recent, made = LruCache(100, len), []
    for _ in range(3):
        recent.get("a", lambda: made.append(1) or "x" * 40)
    assert made == [1]


def test_the_longest_unused_goes_first():
    recent = LruCache(100, len)
    for key in ("a", "b"):
        recent.get(key, lambda: "x" * 40)
    recent.get("a", lambda: "never made")
    recent.get("c", lambda: "x" * 40)
    assert recent.get("a", lambda: "made anew") == "x" * 40
    assert recent.get("b", lambda: "made anew") == "made anew"


def test_the_newest_is_kept_even_without_room():
    recent = LruCache(10, len)
    recent.get("a", lambda: "x" * 40)
    recent.get("b", lambda: "y" * 40)
    assert len(recent) == 1
    assert recent.get("b", lambda: "made anew") == "y" * 40
