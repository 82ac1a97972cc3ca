"""A second look for hands that the first one missed, with detectors that see what they are told."""

import numpy as np
import pytest
from tracking_samples import HEIGHT, WIDTH, right_joints_m, seen

from jghand_engine.hand.joints import Handedness
from jghand_engine.track.detection import SecondLook, _parts

RIGHT, LEFT = Handedness.RIGHT, Handedness.LEFT
JOINTS_M = right_joints_m(1)[0]
HAND = seen(JOINTS_M, RIGHT)
OTHER = seen(JOINTS_M * (-1, 1, 1) - (0.17, 0, 0), LEFT)
PICTURE = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
# every pixel says where it is
PICTURE[..., 0], PICTURE[..., 1] = np.arange(WIDTH) // 4, np.arange(HEIGHT)[:, None] // 4


class Whole:
    """Sees in each picture what it is told."""

    def __init__(self, *frames):
        self.frames = iter(frames)

    def detect(self, rgb8, time_s):
        return list(next(self.frames))


class Part:
    """Sees the hands that are whole in the part that it is shown; remembers the parts."""

    def __init__(self, *hands):
        self.hands, self.boxes = hands, []

    def detect(self, rgb8, time_s):
        left, top = 4 * int(rgb8[0, 0, 0]), 4 * int(rgb8[0, 0, 1])
        height, width = rgb8.shape[:2]
        self.boxes.append((left, top, width, height))
        inside = []
        for hand in self.hands:
            pixels = hand.image_px - (left, top)
            # the place that the pixels say is rounded to four
            if (pixels > 4).all() and (pixels < np.array([width, height]) - 4).all():
                inside.append(type(hand)(pixels, hand.space_m, hand.handedness, hand.score))
        return inside


def test_what_the_first_look_finds_needs_no_second_one():
    part = Part(HAND, OTHER)
    assert len(SecondLook(Whole([HAND, OTHER]), part).detect(PICTURE, 0.0)) == 2
    assert part.boxes == []


def test_an_overlooked_hand_is_found_in_a_part_and_is_where_it_is():
    found = SecondLook(Whole([]), Part(HAND)).detect(PICTURE, 0.0)
    assert len(found) == 1
    assert np.abs(found[0].image_px - HAND.image_px).max() < 4, "what the pixels say of their place is rounded to four"


def test_a_hand_that_was_just_there_is_looked_for_where_it_was():
    part = Part(HAND)
    detector = SecondLook(Whole([HAND], [], [], [], []), part)
    detector.detect(PICTURE, 0.0)
    part.boxes.clear()
    for frame in (1, 2, 3):
        assert len(detector.detect(PICTURE, frame / 30)) == 1
    assert len(part.boxes) == 3, "one close look in each picture"


@pytest.mark.parametrize("shape", [(480, 640), (720, 1280), (1920, 1080), (64, 64), (100, 1000)])
def test_parts_cover_the_picture_and_overlap_by_half(shape):
    boxes = list(_parts((*shape, 3)))
    covered = np.zeros(shape, bool)
    for left, top, right, bottom in boxes:
        assert 0 <= left < right <= shape[1]
        assert 0 <= top < bottom <= shape[0]
        covered[top:bottom, left:right] = True
    assert covered.all()
    lefts = sorted({box[0] for box in boxes})
    assert np.diff(lefts).max() <= (boxes[0][2] - boxes[0][0]) / 2 + 1
