"""Sentences of errors."""

import pytest

from jghand_engine.errors import JGHandError


@pytest.mark.parametrize(
    ("parts", "sentence"),
    [
        ({}, "the film."),
        ({"wanted": "MP4"}, "the film: wanted MP4."),
        ({"came": "Unable to open it."}, "the film: got Unable to open it."),
        ({"came": "nothing", "wanted": "MP4", "remedy": "Look."}, "the film: wanted MP4, got nothing. Look."),
        ({"came": "it failed..", "remedy": "Look."}, "the film: got it failed. Look."),
        ({"came": "../.."}, "the film: got ../..."),
        ({"came": "an end (see below.)."}, "the film: got an end (see below.)."),
        ({"came": "one, two, …", "remedy": "Look."}, "the film: got one, two, … Look."),
    ],
)
def test_an_error_says_what_was_wanted_and_what_came_with_one_full_stop(parts, sentence):
    assert str(JGHandError("the film", **parts)) == sentence
