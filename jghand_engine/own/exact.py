"""The motion of all pictures of a film, by the hand that was fitted to the best of them.

The hand is known: bones, palm and thickness stay, and so do the colors of its skin, which the best pictures give.
Sought are pose and place in every picture. They begin where the tracker has them, moved as the fit moved the best
pictures, evenly in between, and go on by the same terms as there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.errors import InputError
from jghand_engine.own.film import Source, Window, read_pictures
from jghand_engine.own.hand_fit import Effort, FittedHand, HandFit
from jghand_engine.own.masks import hand_masks, hand_size_px, hand_zones
from jghand_engine.own.start import Start
from jghand_engine.track.poses import Poses

# all of them are held in memory, with what a fit knows of each: a minute of a film at 15 a second
PICTURES_MAX = 900
# all pictures are coarser than the best ones, with fewer Gaussians: the hand, which asks for more, is known
HAND_PX, GAUSSIANS = 150.0, 4000
# how often colors are found: with the best pictures, whose bones were 8.3 and 6.2 degrees off after four and ten times
# (`scripts/check_tracking.py`'s film of a palm), and with all, whose poses begin near their place
BEST_EFFORT, EFFORT = Effort(times=10), Effort(times=2)


def exact_poses(
    source: Source,
    track: Start,
    best: np.ndarray,
    fitted: FittedHand,
    prior: HandAvatar,
    told: Callable[[str, int, int], None],
) -> Poses:
    """Of every picture of a film. Where the hand was not seen it goes the shortest way, and holds still at both ends.

    track: what the tracker says of all pictures, whole ones · best: (B,) numbers of those that `fitted` is of, with
    this prior. InputError for a film that is too long.
    """
    seen = np.flatnonzero(track.seen)
    check_length(len(seen))
    start = track.part(seen)
    start = replace(start, poses=begun(start.poses, np.searchsorted(seen, best), fitted.poses))
    hand_px = float(np.median(hand_size_px(start.landmarks_px)))
    points, size_px = start.landmarks_px.reshape(-1, 2), (start.camera.width, start.camera.height)
    window = Window.around(points, hand_px, size_px, HAND_PX)
    told("Reading all pictures", 0, 1)
    pictures = read_pictures(source.showing_right(start.handedness), seen, window)
    start = start.within(window)
    fit = HandFit(prior, start, pictures.time_s, fitted, count=GAUSSIANS)
    now = fit.result()
    told("Cutting the hand out of all pictures", 0, 1)
    zones = hand_zones(fitted.avatar_shape(prior), now.joints_m, start.landmarks_px, start.camera)
    masks = hand_masks(pictures, zones)

    def tick(done: int, total: int) -> None:
        told("Fitting all pictures", done, total)

    fit.fit_pictures(pictures.rgb_u8, masks, EFFORT, np.searchsorted(seen, best), tick)
    return fit.result().poses.spread(seen, len(track.landmarks_px))


def check_length(pictures: int) -> None:
    """InputError where a film has more pictures of the hand than are held at once."""
    if pictures > PICTURES_MAX:
        raise InputError(
            "the exact motion", wanted=f"at most {PICTURES_MAX} pictures of the hand", came=f"{pictures}",
            remedy="Take a shorter film, or of `jghand track` less with --most or --fps.",
        )  # fmt: skip


def begun(tracked: Poses, best: np.ndarray, fitted: Poses) -> Poses:
    """Tracked poses moved as those with the numbers `best`, rising, were by a fit; in between and beyond evenly."""
    before = tracked.part(best)
    turn = Rotation.from_matrix(np.swapaxes(before.turn, -1, -2) @ fitted.turn).as_rotvec()
    step = np.concatenate([turn, fitted.place_m - before.place_m, fitted.angle_rad - before.angle_rad], 1)
    frames = np.arange(len(tracked))
    return tracked.moved(np.stack([np.interp(frames, best, column) for column in step.T], -1))
