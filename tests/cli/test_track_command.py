"""`jghand track`, with a detector that knows where the hand is."""

import itertools
import json

import numpy as np
import pytest
from tracking_samples import FPS, HEIGHT, WIDTH, right_joints_m, sight

from jghand_engine.cli import main
from jghand_engine.datasets.motion_files import read_motion
from jghand_engine.exporters.video import write_video
from jghand_engine.hand.joints import Handedness
from jghand_engine.tracking import mediapipe_hands

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
    # skin is redder than blue; the film of this test is grey
    assert (halves[1][..., 0] - halves[1][..., 2] > 30).mean() > 0.03
    assert np.median(halves[0]) < 110 < np.median(halves[1])


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--hand", "left"], "a left hand"),
        (["--hand", "both"], "both hands"),
        (["--hand-length", "18"], "hand length"),
        (["--hand-length", "0.19"], "60 to 400 mm"),
        (["--camera-angle", "0"], "camera angle"),
        (["--smoothing", "nan"], "smoothing"),
        (["--most", "0"], "--most"),
        (["--fps", "0"], "frames per second"),
        (["--proof", "proof.avi"], ".mp4"),
    ],
)
def test_what_cannot_be_is_told_and_nothing_is_written(film, sees, right, tmp_path, capsys, options, told):
    sees(right)
    assert track(film, tmp_path / "motion.npz", *options) == 2
    assert told in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


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
