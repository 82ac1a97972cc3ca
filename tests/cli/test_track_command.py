"""`jghand track`, with a detector that knows where the hand is."""

import itertools
import json
import sys
from dataclasses import replace

import numpy as np
import pytest
from small_avatars import small_avatar
from tracking_samples import CANONICAL_M, FPS, HEIGHT, WIDTH, right_joints_m, seen, sight

from jghand_engine.avatar.file import save_avatar
from jghand_engine.cli import main
from jghand_engine.export.camera_file import read_camera
from jghand_engine.export.pictures import read_png
from jghand_engine.export.video import write_video
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.kinematics import ArticulatedHand
from jghand_engine.hand.orders import bone_lengths
from jghand_engine.motion.read import read_motion_file
from jghand_engine.own import exact as exact_module
from jghand_engine.own import make
from jghand_engine.track import hands_over_time, mediapipe_hands
from jghand_engine.track import track as module

imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="the extra `video` is not installed")
COUNT = 12


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    path = tmp_path_factory.mktemp("film") / "film.mp4"
    write_video(path, (np.full((HEIGHT, WIDTH, 3), 90 + k, np.uint8) for k in range(COUNT)), FPS)
    return path


@pytest.fixture
def sees(monkeypatch):
    """Call it with what the detector shall see in each picture."""

    def set_frames(frames):
        class Knowing:
            def __init__(self, model=None, *, follows=True):
                # at parts of the picture it sees nothing
                self.left = iter(frames) if follows else itertools.repeat([])

            def __enter__(self):
                return self

            def __exit__(self, *_):
                pass

            def detect(self, rgb8, time_s):
                return next(self.left)

        monkeypatch.setattr(mediapipe_hands, "MediaPipeHands", Knowing)

    return set_frames


@pytest.fixture
def right():
    return sight(right_joints_m(COUNT)).sightings.frames


@pytest.fixture
def left():
    # beside the right one
    joints = right_joints_m(COUNT) * (-1, 1, 1) - np.array([0.25, 0.0, 0.0])
    return sight(joints, Handedness.LEFT).sightings.frames


def read_motion(path):
    return read_motion_file(path).sequence


def still_joints_m():
    """A hand before the camera whose fingers are straight: nothing about its shape tells which it is."""
    straight = ArticulatedHand(CANONICAL_M).straight_joints_m * (1, -1, -1)
    return straight - straight[0] + (0.0, 0.08, 0.5)


def track(film, out, *options):
    return main(["track", str(film), "--out", str(out), *options])


def test_a_film_becomes_a_motion_that_render_plays(film, sees, right, tmp_path, capsys):
    right[5] = []
    sees(right)
    out = tmp_path / "motion.npz"
    assert track(film, out, "--json", str(tmp_path / "report.json")) == 0
    motion = read_motion(out)
    assert (len(motion), motion.fps, motion.handedness) == (COUNT, FPS, Handedness.RIGHT)
    assert np.flatnonzero(motion.filled).tolist() == [5]
    said = capsys.readouterr().out
    assert "seen in 11 of 12 frames, 1 filled and marked" in said
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["hands"][0]["frames_seen"] == 11
    size = ["--size", "96x64", "--preset", "draft", "--frames", "0:1"]
    assert main(["render", "--motion", str(out), "--out", str(tmp_path / "pictures"), *size]) == 0
    assert (tmp_path / "pictures" / "frame_00001.png").is_file()
    size[-1] = "4:6"
    assert main(["render", "--motion", str(out), "--out", str(tmp_path / "others"), *size]) == 0
    assert "1 of 3 frames were filled in" in capsys.readouterr().out
    assert main(["info", str(out)]) == 0
    assert "filled" in capsys.readouterr().out


def test_two_hands_become_two_files(film, sees, right, left, tmp_path):
    sees([a + b for a, b in zip(right, left, strict=True)])
    assert track(film, tmp_path / "motion.json", "--hand", "both") == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["motion_left.json", "motion_right.json"]
    for side in Handedness:
        assert read_motion(tmp_path / f"motion_{side}.json").handedness is side


def test_the_exact_motion_is_of_one_hand_and_takes_the_place_of_the_quick_one(
    film, sees, right, left, tmp_path, capsys, monkeypatch
):
    sees([a + b for a, b in zip(right, left, strict=True)])
    assert track(film, tmp_path / "motion.npz", "--exact") == 2
    assert "--exact: wanted one hand, got both. Say --hand right or --hand left." in capsys.readouterr().err
    # before any picture is looked at
    sees([])
    assert track(film, tmp_path / "motion.npz", "--exact", "--hand", "both") == 2
    assert "--exact: wanted one hand, got both" in capsys.readouterr().err
    asked = []

    def exact_track(source, looked, hand, canonical_joints_m, options, told):
        asked.append((source.fps, len(looked.sharpness), hand.handedness, options.own_bones))
        told("Fitting all pictures", 1, 2)
        camera = module.camera_of(looked.sightings, options.camera_angle_deg)
        quick = module.track_hand(hand, camera, source.fps, canonical_joints_m, options)
        return module.tracked(hand, quick.in_view * (-1, 1, 1) + (0, 0, 1), source.fps, fill=True)

    monkeypatch.setattr(make, "exact_track", exact_track)
    sees([a + b for a, b in zip(right, left, strict=True)])
    words = ["--exact", "--hand", "left", "--bones", "own"]
    assert track(film, tmp_path / "motion.npz", *words) == 0
    assert asked == [(FPS, COUNT, Handedness.LEFT, True)]
    assert (read_motion(tmp_path / "motion.npz").joints_m[..., 2] < -1).all()


@pytest.mark.parametrize("exact", [False, True])
def test_the_motion_has_the_bones_and_the_size_of_an_avatar_that_has_its_own(
    film, sees, right, tmp_path, monkeypatch, exact
):
    avatar = small_avatar()
    own_m = avatar.canonical_joints_m * (0.7, 0.8, 0.75)
    save_avatar(tmp_path / "child.jghand", replace(avatar, own_joints_m=own_m))

    def exact_track(source, looked, hand, canonical_joints_m, options, told):
        return module.track_hand(
            hand, module.camera_of(looked.sightings, 66.0), source.fps, canonical_joints_m, options
        )

    monkeypatch.setattr(make, "exact_track", exact_track)
    sees(right)
    words = ["--avatar", str(tmp_path / "child.jghand"), *(["--exact"] if exact else [])]
    assert track(film, tmp_path / "motion.npz", *words) == 0
    found = [bone_lengths(one) for one in read_motion(tmp_path / "motion.npz").joints_m]
    np.testing.assert_allclose(found, np.tile(bone_lengths(own_m), (COUNT, 1)), rtol=1e-6)


def test_a_film_that_may_be_too_long_for_the_exact_motion_is_told_of_before_the_work(
    film, sees, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(exact_module, "PICTURES_MAX", COUNT - 1)
    sees([[]] * COUNT)
    assert track(film, tmp_path / "motion.npz", "--exact") == 2
    assert "--exact takes 11 pictures of the hand at most, and the film has 12" in capsys.readouterr().out
    sees([[]] * COUNT)
    assert track(film, tmp_path / "motion.npz", "--exact", "--most", "11") == 2
    assert "at most" not in capsys.readouterr().out


def test_one_side_can_be_chosen(film, sees, right, left, tmp_path):
    sees([a + b for a, b in zip(right, left, strict=True)])
    assert track(film, tmp_path / "motion.csv", "--hand", "left") == 0
    assert read_motion(tmp_path / "motion.csv").handedness is Handedness.LEFT


def test_the_proof_shows_film_and_avatar_side_by_side(film, sees, right, tmp_path):
    sees(right)
    proof = tmp_path / "proof.mp4"
    assert track(film, tmp_path / "motion.npz", "--proof", str(proof), "--most", "3") == 0
    reader = imageio_ffmpeg.read_frames(str(proof))
    width, height = next(reader)["size"]
    frames = [np.frombuffer(data, np.uint8).reshape(height, width, 3) for data in reader]
    assert len(frames) == 3
    halves = frames[0][:, : width // 2].astype(int), frames[0][:, width // 2 :].astype(int)
    # skin is redder than blue; the film of this test is gray
    assert (halves[1][..., 0] - halves[1][..., 2] > 30).mean() > 0.03
    assert np.median(halves[0]) < 110 < np.median(halves[1])


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--hand", "left"], "a left hand"),
        (["--hand", "both"], "both hands"),
        (["--film-camera", "camera.png"], "ends in .json"),
        (["--hand-length", "18"], "hand length"),
        (["--hand-length", "0.19"], "60 to 400 mm"),
        (["--camera-angle", "0"], "camera angle"),
        (["--smoothing", "nan"], "smoothing"),
        (["--exact", "--smoothing", "2"], "none with --exact"),
        (["--most", "0"], "--most"),
        (["--fps", "0"], "frames per second"),
        (["--proof", "proof.avi"], ".mp4"),
        (["--proof", "{film}"], "one that is read"),
        (["--json", "{film}"], "one that is read"),
    ],
)
def test_what_cannot_be_is_told_and_nothing_is_written(film, sees, right, tmp_path, capsys, options, told):
    sees(right)
    out, before = tmp_path / "motion.npz", film.read_bytes()
    assert track(film, out, *(word.format(film=film) for word in options)) == 2
    assert told in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
    assert film.read_bytes() == before


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ([], "motion.npz"),
        ([], "motion_left.npz"),
        (["--hand", "both"], "motion_right.npz"),
        (["--hand", "left"], "motion.npz"),
    ],
)
def test_a_motion_that_is_there_stays_unless_it_shall_be_replaced(
    film, sees, right, left, tmp_path, capsys, options, name
):
    both = [a + b for a, b in zip(right, left, strict=True)]
    (tmp_path / name).write_bytes(b"precious")
    sees(both)
    assert track(film, tmp_path / "motion.npz", *options) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"precious"]
    sees(both)
    assert track(film, tmp_path / "motion.npz", *options, "--overwrite") == 0


def test_a_hand_that_is_hardly_ever_seen_is_told_and_not_written(
    film, sees, right, left, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(hands_over_time, "HAND_SEEN_PART_MIN", 0.5)
    frames = [a + (b if k < 4 else []) for k, (a, b) in enumerate(zip(right, left, strict=True))]
    sees(frames)
    assert track(film, tmp_path / "motion.npz") == 0
    assert "A left hand was seen in 4 of 12 pictures, and taken for a mistake." in capsys.readouterr().out
    assert [path.name for path in tmp_path.iterdir()] == ["motion.npz"]
    sees([b if k < 4 else [] for k, b in enumerate(left)])
    assert track(film, tmp_path / "other.npz") == 2
    assert "got none (A left hand was seen in 4 of 12 pictures: too few" in capsys.readouterr().err
    sees(frames)
    assert track(film, tmp_path / "other.npz", "--hand", "both") == 2
    assert "the right one alone (A left hand was seen in 4 of 12" in capsys.readouterr().err


def test_that_it_is_not_sure_which_hand_it_is_is_told(film, sees, tmp_path, capsys):
    straight = np.broadcast_to(still_joints_m(), (COUNT, 21, 3))
    sees([[seen(one, (Handedness.RIGHT, Handedness.LEFT)[k % 2])] for k, one in enumerate(straight)])
    assert track(film, tmp_path / "motion.npz") == 0
    assert "is not sure (certainty 0." in capsys.readouterr().out


def test_without_the_package_nothing_is_fetched(film, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "mediapipe", None)
    monkeypatch.setattr(mediapipe_hands, "fetch_model", lambda: pytest.fail("fetched"))
    assert track(film, tmp_path / "motion.npz", "--fetch-model") == 2
    assert "the package MediaPipe" in capsys.readouterr().err


def test_a_film_without_hands_is_told(film, sees, tmp_path, capsys):
    sees([[]] * COUNT)
    assert track(film, tmp_path / "motion.npz") == 2
    assert "none in any picture" in capsys.readouterr().err


def test_another_suffix_is_refused_before_the_work(film, tmp_path, capsys):
    assert track(film, tmp_path / "motion.bvh") == 2
    assert ".npz" in capsys.readouterr().err


def test_the_motion_can_have_z_up(film, sees, right, tmp_path):
    made = {}
    for up in ("y", "z"):
        sees(right)
        assert track(film, tmp_path / f"{up}.npz", "--up", up) == 0
        made[up] = read_motion(tmp_path / f"{up}.npz").joints_m
    x, y, z = np.moveaxis(made["y"], -1, 0)
    np.testing.assert_allclose(made["z"], np.stack([x, -z, y], -1), atol=1e-12)


@pytest.mark.parametrize("up", ["y", "z"])
def test_before_the_camera_of_the_film_the_motion_is_where_the_film_shows_it(film, sees, right, tmp_path, up):
    sees(right)
    out, file = tmp_path / "motion.npz", tmp_path / "camera.json"
    assert track(film, out, "--film-camera", str(file), "--up", up, "--smoothing", "0", "--bones", "own") == 0
    camera = read_camera(file)
    assert (camera.width, camera.height) == (WIDTH, HEIGHT)
    shown_px, depth_m = camera.project(read_motion(out).joints_m)
    seen_px = np.stack([found[0].image_px for found in right])
    assert depth_m.min() > 0.2
    # worst observed 0.17: the fit also follows directions
    assert np.abs(shown_px - seen_px).max() < 0.3
    pictures = ("--motion", str(out), "--camera", str(file), "--out", str(tmp_path / "pictures"))
    assert main(["render", *pictures, "--frames", "0", "--preset", "draft"]) == 0
    drawn = read_png(tmp_path / "pictures" / "frame_00000.png")
    x, y = seen_px[0].mean(0).round().astype(int)
    assert drawn.shape[:2] == (HEIGHT, WIDTH)
    assert drawn[y, x, 3] > 200


def test_the_camera_of_the_film_stays_unless_it_shall_be_replaced(film, sees, right, tmp_path, capsys):
    file = tmp_path / "camera.json"
    file.write_text("mine")
    sees(right)
    assert track(film, tmp_path / "motion.npz", "--film-camera", str(file)) == 2
    assert "--film-camera" in capsys.readouterr().err
    assert file.read_text() == "mine"
    assert not (tmp_path / "motion.npz").exists()
    assert track(film, tmp_path / "motion.npz", "--film-camera", str(file), "--overwrite") == 0
    assert read_camera(file).width == WIDTH
