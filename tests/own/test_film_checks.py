"""What is wrong with a film is told in sentences, with the time."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from films_of_bones import SIZE, SKIN, SLEEVE, WALL, drawn_hands, film_of, started, zoned
from tracking_samples import CANONICAL_M, FPS, moving_poses, right_joints_m, seen, sight

from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.rotations import vector_rotation
from jghand_engine.own.checks import (
    Finding,
    facing,
    fit_findings,
    left_out,
    picture_findings,
    refuse,
    seen_findings,
    wanted_hand,
)
from jghand_engine.own.film import FilmPictures, Looked
from jghand_engine.own.masks import Zones, film_colors
from jghand_engine.own.start import Start
from jghand_engine.track.hands_over_time import hands_over_time
from jghand_engine.track.poses import JointChain, Poses
from jghand_engine.track.track import Sightings

MARBLE = np.random.default_rng(3).normal(0, 12, (*SIZE[::-1], 1))
RIGHT, LEFT = Handedness.RIGHT, Handedness.LEFT


@dataclass
class Case:
    pictures: FilmPictures
    start: Start
    zones: Zones

    def words(self) -> dict[str, str]:
        """Sentences by the checks' names."""
        found = picture_findings(self.pictures, self.start, self.zones, film_colors(self.pictures, self.zones))
        return {finding.check: finding.sentence for finding in found}


@pytest.fixture(scope="module")
def good() -> Case:
    """A film on a wall with a pattern; its six pictures are a second apart."""
    joints_px, zones = zoned()
    film = film_of(joints_px, SKIN)
    hands = drawn_hands(joints_px)[..., None]
    rgb = np.where(hands, film.rgb_u8, np.clip(film.rgb_u8 + MARBLE, 0, 255)).astype(np.uint8)
    return Case(replace(film, rgb_u8=rgb, time_s=film.index * 1.0), started(right_joints_m(60)[::10]), zones)


def changed(case: Case, change: np.ndarray | float, pictures: slice = slice(None)) -> Case:
    rgb = case.pictures.rgb_u8.astype(np.float64)
    rgb[pictures] = rgb[pictures] * change
    return replace(case, pictures=replace(case.pictures, rgb_u8=np.clip(rgb, 0, 255).astype(np.uint8)))


def turned(poses: Poses, half_turns: float) -> Poses:
    """The hands turned about their own length."""
    turn = poses.turn @ vector_rotation(np.array([[0.0, np.pi * half_turns, 0.0]]))
    return replace(poses, turn=turn)


def test_a_film_with_nothing_wrong_but_its_size_says_only_that_and_what_it_cannot_show(good):
    words = good.words()
    assert set(words) == {"size", "views", "ruler"}
    assert words["size"].startswith("The hand is about 15")
    assert "back" in words["views"]


def test_a_camera_that_moves_is_told_with_the_time(good):
    rgb = good.pictures.rgb_u8.copy()
    rgb[3:] = np.roll(rgb[3:], 9, axis=2)
    words = replace(good, pictures=replace(good.pictures, rgb_u8=rgb)).words()
    assert words["camera"].startswith("The camera moves at 0:03.")
    assert "exposure" not in words


def test_one_picture_that_moved_does_not_hide_an_exposure_that_changes(good):
    case = changed(good, 0.88, slice(4, 5))
    rgb = case.pictures.rgb_u8.copy()
    rgb[2] = np.roll(rgb[2], 9, axis=1)
    words = replace(case, pictures=replace(case.pictures, rgb_u8=rgb)).words()
    assert words["camera"].startswith("The camera moves at 0:02.")
    assert "most at 0:04." in words["exposure"]


@pytest.mark.parametrize(
    ("factor", "pictures", "check", "start"),
    [
        (2.0, slice(None), "light", "The skin is burnt out"),
        (0.2, slice(None), "light", "The skin is too dark"),
        (0.88, slice(4, 5), "exposure", "The brightness changes while filming, most at 0:04."),
    ],
)
def test_light_that_ruins_the_film_refuses_it(good, factor, pictures, check, start):
    case = changed(good, factor, pictures)
    found = picture_findings(case.pictures, case.start, case.zones, film_colors(case.pictures, case.zones))
    told = next(finding for finding in found if finding.check == check)
    assert told.sentence.startswith(start)
    assert told.refuses
    with pytest.raises(InputError, match=start.split()[1]):
        refuse(found)


def test_a_wall_with_the_color_of_the_skin_is_told(good):
    rgb = np.where((good.pictures.rgb_u8 == SKIN).all(-1)[..., None], SKIN, np.array(SKIN) + MARBLE / 4)
    case = replace(good, pictures=replace(good.pictures, rgb_u8=rgb.astype(np.uint8)))
    assert case.words()["skin and background"].startswith("The wall has the color of the skin.")


def test_a_sleeve_behind_the_wrist_is_told_and_the_film_is_used(good):
    joints_px, zones = zoned()
    sleeve = film_of(joints_px, SLEEVE)
    found = replace(good, pictures=sleeve).words()
    assert found["sleeve"].startswith("Behind the wrist no bare forearm is seen, least at 0:0")
    refuse(picture_findings(sleeve, good.start, zones, film_colors(sleeve, zones)))
    # in the shade of the hand an arm is bare still, and so it is where some pictures show something before it
    shady = changed(good, np.where(zones.arm[..., None], 0.6, 1.0))
    assert "sleeve" not in shady.words()
    some = np.where((np.arange(6) < 2)[:, None, None, None] & zones.arm[..., None], SLEEVE, good.pictures.rgb_u8)
    assert "sleeve" not in replace(good, pictures=replace(good.pictures, rgb_u8=some.astype(np.uint8))).words()


def test_what_faces_the_camera_and_which_pictures_are_the_ruler_is_known(good):
    chain = JointChain.of(CANONICAL_M)
    flat = moving_poses(1)
    flat = replace(flat, angle_rad=np.zeros((1, 20)))
    shown = [started(np.repeat(turned(flat, turn).joints_m(chain), 3, 0)) for turn in (0.0, 1.0)]
    palm, back = (facing(start)[0] for start in shown)
    assert palm > 0.9
    assert back < -0.9
    # the ruler of the fit is the detector's, whatever the tracker makes of it
    tracked = replace(good.start.poses, angle_rad=np.zeros((6, 20)))
    bent = replace(good, start=replace(good.start, poses=tracked))
    assert "ruler" in bent.words()
    assert "The back of the hand is never seen: it is invented" in bent.words()["views"]
    # what comes nearest to what is wanted is told with the time
    aslant = turned(good.start.poses, 0.0)
    aslant.turn[3] = turned(aslant, 0.65).turn[3]
    # the first one is the flattest
    near = replace(good.start, poses=aslant, detector_directions=good.start.detector_directions[[1, 2, 0, 3, 4, 5]])
    words = replace(good, start=near).words()
    assert "The back of the hand is never seen squarely, best at 0:03: it is" in words["views"]
    assert "No picture shows the flat hand; the flattest one is at 0:02." in words["ruler"]
    flat_hands = np.repeat(shown[0].detector_directions[:1], 6, 0)
    assert "ruler" not in replace(good, start=replace(good.start, detector_directions=flat_hands)).words()


def looked_at(frames: list, sharpness: np.ndarray | None = None) -> Looked:
    return Looked(Sightings(FPS, (480, 640), frames), np.ones(len(frames)) if sharpness is None else sharpness)


def test_a_hand_that_is_lost_and_a_film_that_is_blurred_are_told_with_the_time():
    frames = sight(right_joints_m(120)).sightings.frames
    lost = looked_at([[] if 61 <= number < 91 else frame for number, frame in enumerate(frames)])
    hand = wanted_hand(hands_over_time(lost.sightings.frames, FPS), lost, "hand.mp4", None)
    assert "in 90 of 120 pictures; it is not at 0:02." in seen_findings(lost, hand)[0].sentence
    soft = looked_at(frames, np.where(np.arange(120) >= 70, 0.1, 1.0))
    hand = wanted_hand(hands_over_time(soft.sightings.frames, FPS), soft, "hand.mp4", None)
    assert [finding.check for finding in seen_findings(soft, hand)] == ["blur"]
    assert "42 % of the film is blurred, such as at 0:02" in seen_findings(soft, hand)[0].sentence
    (told,) = seen_findings(replace(soft, is_film=False), hand)
    assert "42 % of the photographs are blurred, such as in photograph 71:" in told.sentence


def test_no_hand_two_hands_and_the_other_hand_refuse_a_film():
    joints = right_joints_m(60)
    far = joints * np.array([-1.0, 1.0, 1.0]) + np.array([0.25, 0.0, 0.0])
    both = [[seen(one, RIGHT), seen(two, LEFT)] for one, two in zip(joints - 0.1 * np.eye(3)[0], far, strict=True)]
    looked = looked_at(both)
    found = hands_over_time(both, FPS)
    with pytest.raises(InputError, match=r"Two hands are seen at 0:00\. Film one hand alone"):
        wanted_hand(found, looked, "hand.mp4", None)
    assert wanted_hand(found, looked, "hand.mp4", RIGHT).handedness is RIGHT
    alone = hands_over_time([[frame[0]] for frame in both], FPS)
    with pytest.raises(InputError, match="the right one alone"):
        wanted_hand(alone, looked, "hand.mp4", LEFT)
    with pytest.raises(InputError, match="none in any picture"):
        wanted_hand(hands_over_time([[]] * 60, FPS), looked_at([[]] * 60), "hand.mp4", None)


def test_an_outline_that_does_not_fit_the_masks_refuses_the_film(good):
    masks = good.zones.bones
    assert fit_findings(good.pictures, masks, masks) == []
    told = fit_findings(good.pictures, masks, np.roll(masks, 8, axis=2))
    assert told[0].refuses
    assert told[0].sentence.endswith("Sleeve, ring, or a second hand?")
    refuse([Finding("size", "Small.")])


def test_pictures_that_no_skin_is_made_of_are_told_with_the_time(good):
    used = np.ones(6, bool)
    assert left_out(good.pictures, used) == []
    used[3:5] = False
    (told,) = left_out(good.pictures, used)
    assert told.sentence.startswith("2 of 6 pictures are left out")
    assert "such as at 0:03." in told.sentence


def test_the_color_of_the_wall_is_of_no_matter(good):
    assert "light" not in changed(good, np.where(drawn_hands(zoned()[0])[..., None], 1.0, 255 / np.array(WALL))).words()
