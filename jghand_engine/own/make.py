"""From a film to an avatar, stage by stage. What a stage found lies in the work folder, so that a run that was stopped
goes on after the last one that ended.

own.json      which film, and with which options
track.npz     what the tracker says of all pictures · pictures.npz: the best of them · start.npz: what it says of these
checks.json   what is wrong with the film
rounds.npz    how far the fit is, by landmarks and after each round by pictures · first_masks.npz: that it goes by
fit.npz       bones, shape and poses
masks.npz     the hand in each picture, by the fitted outline
sheet.png     film and avatar side by side, new poses, what was seen · report.json: figures of held-out pictures
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from jghand_engine import __version__
from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.builtin import load_builtin
from jghand_engine.errors import InputError
from jghand_engine.files import make_folder, remove_file, writing
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import hand_length
from jghand_engine.hand.sequence import PoseSequence
from jghand_engine.json_files import read_small_json, write_json
from jghand_engine.learn.fist import with_fist
from jghand_engine.lock import locked
from jghand_engine.npz_files import read_arrays
from jghand_engine.own.chain import chain_of
from jghand_engine.own.checks import (
    PICTURE_RESIDUAL_MAX,
    Finding,
    fit_findings,
    left_out,
    picture_findings,
    refuse,
    report_findings,
    seen_findings,
    wanted_hand,
)
from jghand_engine.own.detail import seen_detail
from jghand_engine.own.exact import BEST_EFFORT, check_length, exact_poses
from jghand_engine.own.film import (
    PHOTOGRAPHS_MIN,
    FilmPictures,
    Looked,
    Source,
    Window,
    blurred,
    look,
    open_source,
    read_pictures,
    spread_pictures,
)
from jghand_engine.own.gather import observe
from jghand_engine.own.hand_fit import Effort, FittedHand, HandFit
from jghand_engine.own.light_and_skin import Origin, skin_from
from jghand_engine.own.masks import Zones, film_colors, hand_masks, hand_size_px, hand_zones
from jghand_engine.own.report import FilmView, held_out, write_report
from jghand_engine.own.start import Start, start_of
from jghand_engine.track import CAMERA_ANGLE_DEG
from jghand_engine.track.detection import HandDetector
from jghand_engine.track.hands_over_time import FoundHands, HandOverTime, hands_over_time
from jghand_engine.track.poses import JointChain
from jghand_engine.track.track import TrackedHand, TrackOptions, sequence_of, tracked

MARK, LOCK = "own.json", "lock"
TRACK, PICTURES, START, CHECKS = "track.npz", "pictures.npz", "start.npz", "checks.json"
ROUNDS, FIRST_MASKS, FIT, MASKS = "rounds.npz", "first_masks.npz", "fit.npz", "masks.npz"
_FILES = (MARK, TRACK, PICTURES, START, CHECKS, FIRST_MASKS, ROUNDS, FIT, MASKS, "sheet.png", "report.json")
_MASK_BYTES_MAX = 2**28
# a day: more is a mistake
FIT_MOST_S = 86400.0

# how far a stage is: its name, how much is done, and of how much
Told = Callable[[str, int, int], None]
Detectors = Callable[[], AbstractContextManager[HandDetector]]


@dataclass(frozen=True)
class OwnOptions:
    """hand: which one is filmed; None: the one that is seen · hand_length_m: wrist to middle tip along the bones; None:
    the prior's · camera_angle_deg: across the longer edge; None: what the file says, else a telephone's · fit_s: the
    fit by pictures goes on for so many seconds, if it does not take longer anyway · motion: that of all pictures is
    wanted, too, so that the hand is fitted as well as by `exact_track`"""

    hand: Handedness | None = None
    hand_length_m: float | None = None
    camera_angle_deg: float | None = None
    fit_s: float = 0.0
    motion: bool = False

    def check(self) -> None:
        """InputError for what cannot be."""
        angle = CAMERA_ANGLE_DEG if self.camera_angle_deg is None else self.camera_angle_deg
        TrackOptions(self.hand_length_m, camera_angle_deg=angle).check()
        if not 0 <= self.fit_s <= FIT_MOST_S:
            raise InputError("minutes", wanted=f"0 to {FIT_MOST_S / 60:g}", came=f"{self.fit_s / 60:g}")


# ---- before the fit --------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Begun:
    """What is known before anything is fitted.

    track: what the tracker says of all pictures, whole ones · pictures: the best of them · start: what it says of
    these, as they were cut · findings: what is wrong with the film
    """

    track: Start
    pictures: FilmPictures
    start: Start
    findings: list[Finding]


def begin(source: Source, prior: HandAvatar, options: OwnOptions, detectors: Detectors, told: Told) -> Begun:
    """Looks at all pictures, keeps the best of them and says what is wrong. InputError where no hand is to be had."""
    notes: list[str] = []
    looked, found = _looked(source, detectors, told, notes)
    hand = wanted_hand(found, looked, source.name, options.hand)
    if hand.handedness is Handedness.LEFT:
        # the detector sees mirrored pictures a little differently: it is to say of a left hand what it says of a right
        mirrored = source.showing_right(Handedness.LEFT)
        again, found = _looked(mirrored, detectors, told)
        if Handedness.RIGHT in found.hands:
            source, looked, hand = mirrored, again, found.hands[Handedness.RIGHT]
    begun = best_pictures(source, prior, options, looked, hand)
    pictures, start = begun.pictures, begun.start
    zones = hand_zones(prior, start.joints_m, start.landmarks_px, start.camera)
    begun.findings.extend([*(Finding("film", note) for note in notes), *seen_findings(looked, hand)])
    begun.findings.extend(picture_findings(pictures, start, zones, film_colors(pictures, zones)))
    return begun


def _looked(
    source: Source, detectors: Detectors, told: Told, notes: list[str] | None = None
) -> tuple[Looked, FoundHands]:
    # each time with a new detector, as it follows hands from picture to picture
    with detectors() as detector:
        looked = look(source, detector, lambda done: told("Looking for the hand", done, source.count or done), notes)
    return looked, hands_over_time(looked.sightings.frames, source.fps)


def best_pictures(source: Source, prior: HandAvatar, options: OwnOptions, looked: Looked, hand: HandOverTime) -> Begun:
    """What the tracker says of a hand that was seen, and the pictures that are fitted; nothing is found wrong yet.
    InputError where there are too few."""
    canonical = prior.canonical_joints_m
    length_m = options.hand_length_m or hand_length(canonical)
    angle = options.camera_angle_deg or source.camera_angle_deg or CAMERA_ANGLE_DEG
    track = start_of(looked.sightings, hand, canonical * (length_m / hand_length(canonical)), angle, source.is_film)
    if source.is_mirrored:
        track = replace(track, handedness=Handedness.LEFT)
    index = spread_pictures(track.poses, track.seen & ~(blurred(looked.sharpness) & source.is_film))
    if len(index) < PHOTOGRAPHS_MIN:
        raise InputError(source.name, wanted=f"a hand in {PHOTOGRAPHS_MIN} pictures at least", came=f"{len(index)}")
    start = track.part(index)
    hand_px = float(np.median(hand_size_px(start.camera.project(start.joints_m)[0])))
    size_px = start.camera.width, start.camera.height
    window = Window.around(start.landmarks_px.reshape(-1, 2), hand_px, size_px)
    pictures = read_pictures(source.showing_right(start.handedness), index, window)
    return Begun(track, pictures, start.within(window), [])


# ---- all of it -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Explained:
    """What the film's pictures show. masks: (F, H, W) bool"""

    begun: Begun
    fitted: FittedHand
    masks: np.ndarray


def explain(
    paths: Sequence[Path],
    prior: HandAvatar,
    options: OwnOptions,
    work: Path,
    detectors: Detectors,
    told: Told,
    looked_at: Callable[[Begun], object] = lambda begun: None,
) -> Explained:
    """From the film to the hand's shape, its poses and its masks. What lies in `work` already is taken from there.

    `detectors` gives the detector when one is needed; `looked_at` is told what is wrong with the film before the fit,
    which takes minutes. InputError for a film of which no avatar can be made, or not the motion that is wanted.
    """
    begun = _begun(paths, prior, options, work, detectors, told)
    looked_at(begun)
    refuse(begun.findings)
    if options.motion:
        check_length(int(begun.track.seen.sum()))
    if (work / FIT).exists():
        fitted = FittedHand.load(work / FIT)
    else:
        effort = BEST_EFFORT if options.motion else Effort()
        fitted = fit_hand(begun, prior, told, replace(effort, least_s=options.fit_s), work)
        fitted.save(work / FIT)
    start = begun.start
    zones = hand_zones(fitted.avatar_shape(prior), fitted.joints_m, start.landmarks_px, start.camera)
    told("Cutting the hand out", 0, 1)
    masks = _masks(work / MASKS, begun.pictures, zones)
    told("Cutting the hand out", 1, 1)
    refuse(fit_findings(begun.pictures, masks, (zones.outline > 0.5) & zones.side))
    return Explained(begun, fitted, masks)


def _begun(
    paths: Sequence[Path], prior: HandAvatar, options: OwnOptions, work: Path, detectors: Detectors, told: Told
) -> Begun:
    # the last of the three that is written
    if (work / CHECKS).exists():
        findings = [Finding(**one) for one in read_small_json(work / CHECKS)["findings"]]
        pictures, start = FilmPictures.load(work / PICTURES), Start.load(work / START)
        return Begun(Start.load(work / TRACK), pictures, start, findings)
    begun = begin(open_source(paths), prior, options, detectors, told)
    begun.track.save(work / TRACK)
    begun.pictures.save(work / PICTURES)
    begun.start.save(work / START)
    write_json(work / CHECKS, {"findings": [asdict(finding) for finding in begun.findings]})
    return begun


def _masks(path: Path, pictures: FilmPictures, zones: Zones) -> np.ndarray:
    """(F, H, W) bool, kept in a file."""
    if not path.exists():
        with writing(path) as temporary:
            np.savez_compressed(temporary, hand=hand_masks(pictures, zones))
    return read_arrays(path, ("hand",), str(path), max_bytes=_MASK_BYTES_MAX)["hand"]


def fit_hand(begun: Begun, prior: HandAvatar, told: Told, effort: Effort, work: Path) -> FittedHand:
    """By landmarks, then by masks and pictures; the masks by the outline that the landmarks gave. Goes on with what is
    in `work`."""
    pictures, start = begun.pictures, begun.start
    fit = HandFit(prior, start, pictures.time_s if pictures.is_film else None)
    told("Fitting the hand by landmarks", 0, 1)
    if (work / ROUNDS).exists():
        fit.load(work / ROUNDS)
    else:
        fit.fit_landmarks()
    now = fit.result()
    zones = hand_zones(now.avatar_shape(prior), now.joints_m, start.landmarks_px, start.camera)
    masks = _masks(work / FIRST_MASKS, pictures, zones)

    def tick(done: int, total: int) -> None:
        told("Fitting the hand by pictures", done, total)

    fit.fit_pictures(pictures.rgb_u8, masks, effort, tick=tick, ended=lambda: fit.save(work / ROUNDS))
    return fit.result()


def exact_track(
    source: Source,
    looked: Looked,
    hand: HandOverTime,
    canonical_joints_m: np.ndarray,
    options: TrackOptions,
    told: Told,
) -> TrackedHand:
    """As `track.track_hand`, by outlines and colors too. canonical_joints_m: of the avatar that takes the motion.

    InputError where there are too few pictures of the hand, or too many.
    """
    check_length(int(hand.seen.sum()))
    length_m, prior = hand_length(canonical_joints_m), load_builtin(handedness=Handedness.RIGHT)
    wanted_m = options.hand_length_m or length_m
    begun = best_pictures(source, prior, OwnOptions(None, wanted_m, options.camera_angle_deg), looked, hand)
    with TemporaryDirectory() as work:
        fitted = fit_hand(begun, prior, told, BEST_EFFORT, Path(work))
    poses = exact_poses(source, begun.track, begun.pictures.index, fitted, prior, told)
    own = chain_of(prior.canonical_joints_m, fitted.own_joints_m)
    chain = own if options.own_bones else JointChain.of(canonical_joints_m * (wanted_m / length_m))
    return tracked(hand, poses.joints_m(chain), source.fps, fill=options.fill)


def check_has_motion(paths: Sequence[Path]) -> Source:
    """The film; InputError for photographs."""
    source = open_source(paths)
    if not source.is_film:
        raise InputError("--motion", wanted="a film", came="photographs")
    return source


def motion_of(paths: Sequence[Path], explained: Explained, prior: HandAvatar, told: Told) -> PoseSequence:
    """Of the hand in all pictures that were looked at, with its own bones. InputError for photographs, and where
    the hand is seen in too many pictures."""
    begun, fitted, source = explained.begun, explained.fitted, check_has_motion(paths)
    poses = exact_poses(source, begun.track, begun.pictures.index, fitted, prior, told)
    joints_m = poses.joints_m(chain_of(prior.canonical_joints_m, fitted.own_joints_m))
    hand = begun.track.handedness
    if hand is Handedness.LEFT:
        joints_m = joints_m * (-1.0, 1.0, 1.0)
    return sequence_of(joints_m, hand, begun.track.seen, source.fps)


def hand_of(explained: Explained, prior: HandAvatar, work: Path, told: Told) -> tuple[HandAvatar, list[Finding]]:
    """The avatar: skin and light of the pictures whose outlines the fit explains, but for those that are held out to
    judge it by; and what is to be said of it. Writes sheet.png and report.json into `work`."""
    pictures, fitted = explained.begun.pictures, explained.fitted
    told("Finding skin and light", 0, 3)
    fits = np.nan_to_num(fitted.outline_residual) <= PICTURE_RESIDUAL_MAX
    used = fits if fits.sum() >= PHOTOGRAPHS_MIN else ~np.zeros(len(pictures), bool)
    film = FilmView(fitted.joints_m, fitted.camera, pictures.rgb_u8, explained.masks).part(used)
    held = held_out(len(film.joints_m), is_film=pictures.is_film)
    seen, shaped = film.part(~held), fitted.avatar_shape(prior)
    observed = observe(shaped, seen.joints_m, seen.camera, seen.pictures, seen.masks)
    origin = Origin(pictures.source, pictures.digest, explained.begun.start.handedness)
    own = skin_from(observed, shaped, origin)
    told("Finding skin and light", 1, 3)
    if shaped.detail is not None:
        detail = seen_detail(own, shaped.detail, observed.shown, seen.joints_m)
        own = replace(own, avatar=with_fist(replace(own.avatar, detail=detail)))
    told("Finding skin and light", 2, 3)
    report = write_report(work, own, film, held, np.flatnonzero(used))
    told("Finding skin and light", 3, 3)
    return own.avatar, [*left_out(pictures, used), *report_findings(report)]


# ---- the work folder -------------------------------------------------------------------------------------------------


@contextmanager
def work_folder(path: Path, paths: Sequence[Path], options: OwnOptions, *, resume: bool) -> Iterator[None]:
    """Makes the folder this film's for the duration; without `resume` what an earlier run left in it is forgotten.

    InputError where it holds something else, or with `resume` what another film or other options gave; RetryError when
    another process works there.
    """
    make_folder(path)
    stamp = _stamp(paths, options)
    with locked(path / LOCK, work="film", remedy="Wait until it has ended, or name another --out."):
        there = sorted(one.name for one in path.iterdir() if not one.name.startswith(".") and one.name != LOCK)
        if there and MARK not in there:
            raise InputError(f"{path}", wanted="a new folder, or one of `jghand own`", came=f"one with {there[0]}",
                             remedy="Name another --out.")  # fmt: skip
        if resume and (not there or read_small_json(path / MARK) != stamp):
            came = "another beginning" if there else "nothing to go on with"
            raise InputError(f"{path}", wanted="what this very film and these options began", came=came,
                             remedy="Leave out --resume.")  # fmt: skip
        if not resume:
            # the mark last: a folder that was being emptied when the run was stopped is still one of ours
            for name in reversed(_FILES):
                remove_file(path / name)
            write_json(path / MARK, stamp)
        yield


def _stamp(paths: Sequence[Path], options: OwnOptions) -> dict[str, Any]:
    """What a work folder is of."""
    digests = []
    for path in paths:
        try:
            with open(path, "rb") as stream:
                digests.append(hashlib.file_digest(stream, "sha256").hexdigest())
        except OSError as error:
            raise InputError(f"cannot read {path}", came=str(error.strerror or error)) from error
    return {"jghand_own": __version__, "files": digests, "options": asdict(options)}
