"""Films of a hand of thick bones before a wall, small, and what a perfect detector says of them."""

import cv2
import numpy as np
from tracking_samples import CAMERA, CANONICAL_M, FPS, HEIGHT, WIDTH, right_joints_m, sight

from jghand_engine.hand.joints import PARENTS, Handedness
from jghand_engine.own.film import FilmPictures
from jghand_engine.own.masks import Zones, hand_size_px, wrist_side, zones_of
from jghand_engine.own.start import Start, start_of
from jghand_engine.track.hands_over_time import hands_over_time

SKIN, WALL, SLEEVE = (205, 150, 125), (70, 90, 140), (40, 160, 60)
SCALE = 0.6
SIZE = round(WIDTH * SCALE), round(HEIGHT * SCALE)


def drawn_hands(joints_px: np.ndarray, arm: bool = False) -> np.ndarray:
    """(F, H, W) bool: thick bones and a palm, or the forearm that they hang on."""
    shown = []
    for joints, size in zip(joints_px, hand_size_px(joints_px), strict=True):
        picture = np.zeros(SIZE[::-1], np.uint8)
        ends = np.round(joints).astype(int).tolist()
        if arm:
            far = np.round(joints[0] + 1.5 * (joints[0] - joints[2:6].mean(0))).astype(int).tolist()
            cv2.line(picture, ends[0], far, 1, round(0.25 * size))
        else:
            cv2.fillPoly(picture, [np.array([ends[0], *ends[2:6]])], 1)
            for joint in range(1, 21):
                cv2.line(picture, ends[PARENTS[joint]], ends[joint], 1, max(3, round(0.1 * size)))
        shown.append(picture > 0)
    return np.stack(shown)


def film_of(joints_px: np.ndarray, arm: tuple[int, int, int], noise: float = 0.0) -> FilmPictures:
    hands = drawn_hands(joints_px)
    arms = drawn_hands(joints_px, arm=True) & ~wrist_side(joints_px, *SIZE)
    rgb = np.where(hands[..., None], SKIN, np.where(arms[..., None], arm, WALL)).astype(np.float64)
    rgb += np.random.default_rng(1).normal(0, noise, rgb.shape) if noise else 0
    count = np.arange(len(rgb))
    return FilmPictures(np.clip(rgb, 0, 255).astype(np.uint8), count / 7.5, count, "film", "", True)


def zoned() -> tuple[np.ndarray, Zones]:
    """Joints in the picture, and zones of an outline with thinner fingers; the detector sees the hand where it is."""
    joints_px = CAMERA.project(right_joints_m(60)[::10]) * SCALE
    thin = np.stack([cv2.erode(hand.astype(np.uint8), np.ones((3, 3))) for hand in drawn_hands(joints_px)])
    return joints_px, zones_of(joints_px, joints_px, thin.astype(np.float32))


def started(joints_m: np.ndarray, side: Handedness = Handedness.RIGHT, *, is_film: bool = True) -> Start:
    """joints_m: (F, 21, 3) camera axes, of a right hand or a left one"""
    sightings = sight(joints_m, side).sightings
    hand = hands_over_time(sightings.frames, FPS).hands[side]
    return start_of(sightings, hand, CANONICAL_M, 60.0, is_film)
