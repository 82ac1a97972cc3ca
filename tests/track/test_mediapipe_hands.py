"""The true detector, where it is installed."""

import numpy as np
import pytest
from tracking_samples import CAMERA, CANONICAL_M, HEIGHT, WIDTH, right_joints_m

from jghand_engine.avatar.builtin import load_builtin
from jghand_engine.avatar.light_records import light_of
from jghand_engine.avatar.scene_light import Lamp, World
from jghand_engine.errors import InputError
from jghand_engine.export.pictures import flatten
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import named_pose
from jghand_engine.native.scene_light_task import LampKind
from jghand_engine.own.film import look, source_of
from jghand_engine.render.camera import Camera
from jghand_engine.render.renderer import HandRenderer, SceneRenderer
from jghand_engine.render.settings import preset
from jghand_engine.track.detection import SecondLook
from jghand_engine.track.mediapipe_hands import MediaPipeHands, check_package, model_file
from jghand_engine.track.track import track
from jghand_engine.track.video import open_video


@pytest.fixture(autouse=True, scope="module")
def detector_is_here():
    try:
        check_package(), model_file()
    except InputError as error:
        pytest.skip(str(error))


# y is down: a sun above, before the hand, and light from all sides. In even light the detector takes palms for backs
SUN = Lamp(LampKind.SUN, (2.0, 2.0, 2.0), (0.0, -0.4, -1.0), angle_rad=0.2)
ABOVE = light_of((SUN,), World(np.full((2, 4, 3), 0.8, np.float32)))


def shown(handedness, joints_m):
    """A picture of the built-in hand, (H, W, 3) uint8."""
    axes = np.eye(4)
    camera = Camera(WIDTH, HEIGHT, CAMERA.focal_px, CAMERA.focal_px, CAMERA.cx, CAMERA.cy, axes)
    renderer = HandRenderer(load_builtin(handedness=handedness), preset("viewport"), ABOVE)
    return flatten(renderer.render(joints_m, camera).displayed(), (0.45, 0.45, 0.47))


@pytest.mark.parametrize("handedness", Handedness)
def test_hands_are_found_where_they_are_and_are_the_hand_that_they_are(handedness):
    truth = right_joints_m(1)[0] * (1 if handedness is Handedness.RIGHT else np.array([-1, 1, 1]))
    with MediaPipeHands(follows=False) as detector:
        found = detector.detect(shown(handedness, truth), 0.0)
    assert len(found) == 1
    assert found[0].handedness is handedness
    distance = np.linalg.norm(found[0].image_px - CAMERA.project(truth), axis=-1) / found[0].size_px
    assert np.median(distance) < 0.1, "seen: 0.062 and 0.071 of the hand's size"


def test_both_hands_of_a_picture_are_found():
    # fingers up before the camera
    open_hand = named_pose("open", CANONICAL_M, handedness=Handedness.RIGHT) * (1, -1, -1)
    right = open_hand - open_hand[0] + np.array([0.12, 0.08, 0.5])
    truth = {Handedness.RIGHT: right, Handedness.LEFT: right * (-1, 1, 1)}
    axes = np.eye(4)
    camera = Camera(WIDTH, HEIGHT, CAMERA.focal_px, CAMERA.focal_px, CAMERA.cx, CAMERA.cy, axes)
    renderer = SceneRenderer([load_builtin(handedness=side) for side in truth], preset("viewport"), ABOVE)
    picture = flatten(renderer.render(list(truth.values()), camera).displayed(), (0.45, 0.45, 0.47))
    with MediaPipeHands(follows=False) as detector:
        found = {hand.handedness: hand for hand in detector.detect(picture, 0.0)}
    assert set(found) == set(truth)
    for side, hand in found.items():
        middle_px = CAMERA.project(truth[side]).mean(0)
        assert np.linalg.norm(hand.middle_px - middle_px) < 0.05 * hand.size_px, "seen: 0.02"


def test_a_small_hand_that_is_overlooked_is_found_by_the_second_look():
    truth = right_joints_m(31)[30] + np.array([0.15, 0.0, 1.8])
    picture = shown(Handedness.RIGHT, truth)
    with MediaPipeHands(follows=False) as detector:
        assert detector.detect(picture, 0.0) == [], "if it finds it today, take a smaller hand"
        found = SecondLook(detector, detector).detect(picture, 0.0)
    assert [hand.handedness for hand in found] == [Handedness.RIGHT]
    distance = np.linalg.norm(found[0].image_px - CAMERA.project(truth), axis=-1) / found[0].size_px
    assert np.median(distance) < 0.1, "seen: 0.06"


def test_a_picture_without_a_hand_has_none():
    with MediaPipeHands() as detector:
        assert detector.detect(np.full((HEIGHT, WIDTH, 3), 120, np.uint8), 0.0) == []
        # two pictures of the same moment are no reason to fail
        assert detector.detect(np.full((HEIGHT, WIDTH, 3), 120, np.uint8), 0.0) == []


def test_other_files_are_no_networks(tmp_path):
    (tmp_path / "odd.task").write_bytes(b"nothing of the kind" * 100)
    with pytest.raises(InputError, match=r"odd\.task"):
        MediaPipeHands(tmp_path / "odd.task")


def test_the_hand_of_a_real_video_is_found_in_every_picture(shared_data):
    video = open_video(shared_data / "real" / "human_hand_video.mp4")
    canonical = load_builtin(handedness=Handedness.RIGHT).canonical_joints_m
    with MediaPipeHands() as detector:
        sightings = look(source_of(video), detector, most=90).sightings
    hands = track(sightings, canonical)
    assert set(hands) == {Handedness.RIGHT}
    hand = hands[Handedness.RIGHT]
    assert hand.seen.all()
    assert hand.jitter_after_deg < 0.4 * hand.jitter_before_deg, "seen: 0.19"


def test_a_library_of_the_system_that_is_missing_is_named_and_how_to_install_it(monkeypatch):
    from mediapipe.tasks.python import vision

    def lacks(_options):
        raise OSError("libGLESv2.so.2: cannot open shared object file: No such file or directory")

    monkeypatch.setattr(vision.HandLandmarker, "create_from_options", lacks)
    with pytest.raises(InputError, match=r"libraries.*libGLESv2.so.2.*apt-get install libgles2"):
        MediaPipeHands()
