"""`jghand own`: what it says of a film, and how a run that was stopped goes on."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from films_of_bones import SCALE, SKIN, drawn_hands, film_of
from motion_errors import motion_errors
from shaped_films import PRIOR
from tracking_samples import CAMERA, right_joints_m, seen

from jghand_engine.avatar import builtin
from jghand_engine.cli import main
from jghand_engine.errors import InputError
from jghand_engine.export.pictures import write_png
from jghand_engine.export.video import write_video
from jghand_engine.hand.joints import Handedness
from jghand_engine.motion.read import read_motion_file
from jghand_engine.own import make
from jghand_engine.own.checks import Finding, refuse
from jghand_engine.own.film import PHOTOGRAPH_FPS, Source
from jghand_engine.own.hand_fit import Effort, FittedHand
from jghand_engine.own.make import Begun, OwnOptions, begin, explain, work_folder
from jghand_engine.own.shape import SHAPE_COUNT
from jghand_engine.own.start import Start
from jghand_engine.track import mediapipe_hands
from jghand_engine.track.detection import HandDetector, SeenHand
from jghand_engine.track.track import MOTION_FROM_CAMERA

RIGHT = Handedness.RIGHT
JOINTS_M = right_joints_m(6)
FPS = 15.0
# what --minutes says in these tests
LEAST_S = 30.0


class Known:
    """A detector that knows the film by heart, or photographs of it."""

    def __init__(self, fps: float = FPS) -> None:
        self._fps = fps

    def detect(self, rgb8: np.ndarray, time_s: float) -> list[SeenHand]:
        hand = seen(JOINTS_M[round(time_s * self._fps)], RIGHT)
        return [replace(hand, image_px=hand.image_px * SCALE)] if rgb8.std() > 1 else []


@contextmanager
def known(*_: object) -> Iterator[HandDetector]:
    yield Known()


@pytest.fixture(scope="module")
def film(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("film") / "hand.mp4"
    shown = film_of(CAMERA.project(JOINTS_M) * SCALE, SKIN).rgb_u8
    write_video(path, list(shown), FPS)
    return path


@pytest.fixture(autouse=True)
def detector(monkeypatch):
    """And a prior of few Gaussians without the texture of its skin, which takes seconds to make ready."""
    monkeypatch.setattr(mediapipe_hands, "video_detector", known)
    monkeypatch.setattr(builtin, "load_builtin", lambda **_: PRIOR)


@pytest.fixture
def efforts() -> list[int]:
    """How often each fit finds the skin's colors anew."""
    return []


@pytest.fixture
def fits(monkeypatch, efforts) -> list[int]:
    """Fits that take the tracker's word; how many there were."""
    begun: list[int] = []

    class Believing:
        def __init__(self, prior: object, start: Start, time_s: np.ndarray | None) -> None:
            self.start = start
            begun.append(len(start.joints_m))

        def fit_landmarks(self) -> None: ...
        def load(self, path: Path) -> None: ...
        def save(self, path: Path) -> None:
            path.touch()

        def fit_pictures(
            self, rgb_u8: np.ndarray, masks: np.ndarray, effort: Effort, *, tick: object, ended: Callable[[], None]
        ) -> None:
            ended()
            assert masks.shape == rgb_u8.shape[:3]
            assert effort.least_s == LEAST_S
            efforts.append(effort.times)

        def result(self) -> FittedHand:
            start = self.start
            nothing = np.full(len(start.joints_m), np.nan)
            return FittedHand(
                start.camera, start.poses, start.joints_m, start.canonical_joints_m, np.zeros(SHAPE_COUNT), nothing
            )

    monkeypatch.setattr(make, "HandFit", Believing)
    # hands of bones are thinner than one of flesh
    monkeypatch.setattr(make, "fit_findings", lambda *_: [])
    return begun


def test_a_check_says_what_is_wrong_and_writes_nothing(film, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["own", str(film), "--check", "--json", "told.json"]) == 0
    said = capsys.readouterr().out
    assert "size: The hand is about 9" in said
    assert "views: The back of the hand is never seen" in said
    assert "An avatar can be made of it." in said
    told = json.loads(Path("told.json").read_text())
    assert (told["hand"], told["refused"]) == ("right", False)
    assert [path.name for path in tmp_path.iterdir()] == ["told.json"]


def test_a_film_without_a_hand_ends_with_2_and_words(tmp_path, capsys):
    write_video(tmp_path / "wall.mp4", [np.full((96, 128, 3), 90, np.uint8)] * 6, FPS)
    assert main(["own", str(tmp_path / "wall.mp4"), "--check"]) == 2
    assert "wanted a hand, got none in any picture. Film it large" in capsys.readouterr().err


def photographs(walls: list[int]) -> Source:
    """Five, of which some show nothing but a wall."""
    shown = film_of(CAMERA.project(JOINTS_M[:5]) * SCALE, SKIN).rgb_u8
    shown[walls] = 90
    return Source("palm.jpg", (shown.shape[1], shown.shape[2]), PHOTOGRAPH_FPS, 5, False, None, None, tuple(shown))


def test_photographs_without_a_hand_are_left_out_if_three_others_remain():
    def begun(walls: list[int]) -> Begun:
        return begin(
            photographs(walls), PRIOR, OwnOptions(), lambda: nullcontext(Known(PHOTOGRAPH_FPS)), lambda *_: None
        )

    found = begun([1, 3])
    assert found.pictures.index.tolist() == [0, 2, 4]
    assert found.findings[0].sentence.startswith("Photographs without a hand are left out: 2, 4.")
    refuse(found.findings)
    with pytest.raises(InputError, match=r"wanted a hand, got one in 2 of 5 pictures\. Film it large"):
        begun([1, 2, 3])


class Leaning(Known):
    """Sees hands too far to the right in the picture: not the same in mirrored pictures, whose first pixel is dark."""

    def detect(self, rgb8: np.ndarray, time_s: float) -> list[SeenHand]:
        (hand,) = super().detect(rgb8, time_s)
        pixels, space = hand.image_px, hand.space_m
        if rgb8[0, 0].max() == 0:
            hand = replace(hand, handedness=Handedness.LEFT, space_m=space * (-1, 1, 1))
            pixels = pixels * (-1, 1) + (rgb8.shape[1], 0)
        return [replace(hand, image_px=pixels + np.array([3, 0]))]


def test_a_left_hand_begins_as_the_right_one_in_its_mirrored_pictures_whatever_the_detector_sees_differently():
    shown = film_of(CAMERA.project(JOINTS_M) * SCALE, SKIN).rgb_u8
    shown[:, 0, -1] = 0
    source = Source("hand", (shown.shape[1], shown.shape[2]), FPS, len(shown), True, None, None, tuple(shown))
    mirrored = replace(source, _photographs=tuple(shown[:, :, ::-1]))
    right, left = (
        begin(one, PRIOR, OwnOptions(), lambda: nullcontext(Leaning()), lambda *_: None) for one in (source, mirrored)
    )
    assert left.start.handedness is left.track.handedness is Handedness.LEFT
    assert left.pictures.digest == right.pictures.digest
    assert left.findings == right.findings
    for one, other in ((left.start, right.start), (left.track, right.track)):
        assert np.array_equal(one.landmarks_px, other.landmarks_px)
        assert np.array_equal(one.joints_m, other.joints_m)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ([], "either --out FILE.jghand or --check"),
        (["--check", "--minutes", "-1"], "0 to 1440"),
        (["--out", "me.jghand", "--motion", "me.txt"], "motion file me.txt"),
        (["--check", "--motion", "me.npz"], "--check: wanted no --motion"),
        (["--check", "--minutes", "5"], "--check: wanted no --minutes"),
        (["--check", "--resume"], "--check: wanted no --resume"),
        (["--check", "--overwrite"], "--check: wanted no --overwrite"),
        (["--check", "--json", "{film}"], "one that is read"),
        (["--out", "{new}", "--motion", "{film}", "--overwrite"], "motion file"),
        (["--out", "{new}", "--motion", "{new}.npz", "--json", "{new}.npz"], "that of --motion"),
        (["--out", "{new}", "--json", "{film}"], "one that is read"),
        (["--check", "--out", "me.jghand"], "either --out FILE.jghand or --check"),
        (["--check", "--hand-length", "18"], "60 to 400 mm"),
        (["--check", "--camera-angle", "170"], "1 to 150 degrees"),
        (["--check", "--hand", "left"], "the right one alone"),
    ],
)
def test_what_cannot_be_is_refused_in_words(film, tmp_path, capsys, words, told):
    before = film.read_bytes()
    places = {"film": film, "new": tmp_path / "me.jghand"}
    assert main(["own", str(film), *(word.format(**places) for word in words)]) == 2
    assert told in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
    assert film.read_bytes() == before


def explained(
    film: Path, work: Path, *, resume: bool, detectors=known, length_m: float | None = None, motion: bool = False
) -> make.Explained:
    chosen = OwnOptions(hand_length_m=length_m, fit_s=LEAST_S, motion=motion)
    with work_folder(work, [film], chosen, resume=resume):
        return explain([film], PRIOR, chosen, work, detectors, lambda *_: None)


@contextmanager
def nobody(*_: object) -> Iterator[HandDetector]:
    raise AssertionError("the film was looked at already")
    yield


def test_a_run_that_was_stopped_goes_on_after_the_last_stage_that_ended(film, tmp_path, fits, monkeypatch):
    whole = explained(film, tmp_path / "whole.own", resume=False)
    work = tmp_path / "me.own"
    with monkeypatch.context() as stopping:
        stopping.setattr(make, "hand_masks", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt()))
        with pytest.raises(KeyboardInterrupt):
            explained(film, work, resume=False)
    assert not (work / make.FIT).exists()
    again = explained(film, work, resume=True, detectors=nobody)
    assert len(fits) == 3
    assert np.array_equal(again.masks, whole.masks)
    (work / make.MASKS).unlink()
    third = explained(film, work, resume=True, detectors=nobody)
    assert len(fits) == 3
    assert np.array_equal(third.masks, whole.masks)
    assert np.array_equal(third.fitted.joints_m, whole.fitted.joints_m)
    hands = drawn_hands(CAMERA.project(JOINTS_M) * SCALE)
    assert 0.5 < third.masks.mean() * third.masks[0].size / hands.sum((1, 2)).mean() < 1.2


def test_a_fit_that_was_stopped_goes_on_after_its_last_round(film, tmp_path, fits, monkeypatch):
    def stopped(self, *_: object, ended: Callable[[], None], **__: object) -> None:
        ended()
        raise KeyboardInterrupt

    with monkeypatch.context() as stopping:
        stopping.setattr(make.HandFit, "fit_pictures", stopped)
        with pytest.raises(KeyboardInterrupt):
            explained(film, tmp_path, resume=False)
    masks = (tmp_path / make.FIRST_MASKS).read_bytes()
    monkeypatch.setattr(make.HandFit, "fit_landmarks", lambda _: pytest.fail("its landmarks were fitted already"))
    explained(film, tmp_path, resume=True, detectors=nobody)
    assert (tmp_path / make.FIRST_MASKS).read_bytes() == masks
    # a new run begins anew
    with pytest.raises(pytest.fail.Exception):
        explained(film, tmp_path, resume=False)


def test_a_work_folder_is_of_one_film_and_its_options_and_of_nothing_else(film, tmp_path, fits):
    work = tmp_path / "me.own"
    with pytest.raises(InputError, match=r"got nothing to go on with\. Leave out --resume"):
        explained(film, work, resume=True)
    explained(film, work, resume=False)
    with pytest.raises(InputError, match="this very film and these options"):
        explained(film, work, resume=True, length_m=0.2)
    explained(film, work, resume=False, length_m=0.2)
    assert len(fits) == 2
    other = tmp_path / "pictures"
    other.mkdir()
    (other / "mine.png").touch()
    with pytest.raises(InputError, match=r"one with mine\.png"):
        explained(film, other, resume=False)


def test_all_that_is_wrong_is_told_before_a_film_is_refused(film, tmp_path, fits, monkeypatch, capsys):
    wrong = [Finding("size", "Small."), Finding("light", "Too dark.", refuses=True)]
    monkeypatch.setattr(make, "picture_findings", lambda *_: wrong)
    told = tmp_path / "told.json"
    assert main(["own", str(film), "--out", str(tmp_path / "me.jghand"), "--json", str(told)]) == 2
    assert "size: Small." in capsys.readouterr().out
    figures = json.loads(told.read_text())
    assert figures["refused"]
    assert [one["check"] for one in figures["findings"]] == ["size", "light"]
    assert fits == []


def test_an_avatar_comes_with_the_motion_of_its_film(film, tmp_path, fits, monkeypatch):
    monkeypatch.setattr(make, "hand_of", lambda explained, prior, *_: (prior, []))
    monkeypatch.setattr(make, "exact_poses", lambda source, track, *_: track.poses)
    out, motion = tmp_path / "me.jghand", tmp_path / "me.npz"
    words = ["own", str(film), "--out", str(out), "--motion", str(motion), "--minutes", "0.5"]
    assert main([*words, "--json", str(tmp_path / "told.json")]) == 0
    found = read_motion_file(motion).sequence
    assert (found.fps, found.handedness, len(found)) == (FPS, RIGHT, len(JOINTS_M))
    # as the tracker has them, up to the film's size
    away = motion_errors(found.joints_m * MOTION_FROM_CAMERA, FPS, JOINTS_M, FPS)
    assert away.aligned_mm < 8
    told, learned_from = json.loads((tmp_path / "told.json").read_text()), PRIOR.info.learned_from
    assert learned_from is not None
    assert (told["motion"], told["pictures_used"]) == (str(motion), learned_from.pictures)
    assert main([*words, "--overwrite", "--resume"]) == 0
    assert len(fits) == 1


def test_the_motion_of_a_left_hand_is_a_left_hands(film, tmp_path, fits, monkeypatch):
    whole = explained(film, tmp_path / "me.own", resume=False)
    monkeypatch.setattr(make, "exact_poses", lambda source, track, *_: track.poses)
    right = make.motion_of([film], whole, PRIOR, lambda *_: None)
    track = replace(whole.begun.track, handedness=Handedness.LEFT)
    left = make.motion_of([film], replace(whole, begun=replace(whole.begun, track=track)), PRIOR, lambda *_: None)
    assert left.handedness is Handedness.LEFT
    np.testing.assert_array_equal(left.joints_m, right.joints_m * (-1, 1, 1))


def test_photographs_have_no_motion_which_is_told_before_the_work(tmp_path, capsys):
    for number in range(3):
        write_png(tmp_path / f"{number}.png", np.zeros((8, 8, 3), np.uint8))
    files = [str(path) for path in sorted(tmp_path.glob("*.png"))]
    assert main(["own", *files, "--out", str(tmp_path / "me.jghand"), "--motion", str(tmp_path / "me.npz")]) == 2
    assert "--motion: wanted a film, got photographs" in capsys.readouterr().err
    assert not (tmp_path / "me.own").exists()
