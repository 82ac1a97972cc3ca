"""The measurements of `jghand study accuracy`: errors, truth, and times of all settings in turn."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.correctives import LinearCorrectives
from jghand_engine.captures.capture_folder import open_capture
from jghand_engine.captures.sample import Sample
from jghand_engine.captures.splits import split_capture
from jghand_engine.learn.evaluate import (
    NOT_KNOWN,
    AvatarPicturer,
    Picturer,
    categories_of,
    held_out,
    pictured,
    spread,
    truth_of,
)
from jghand_engine.learn.metrics import checked_picture, psnr
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import PRESETS
from jghand_engine.render.subject import Subject, moving_subject
from jghand_engine.render.timing import Case, Measurement, frame_case, machine, measure
from jghand_engine.study.accuracy import (
    APPROXIMATE,
    Accuracy,
    Row,
    TruthScore,
    faster_than,
    how_it_looks,
    left_out,
    pareto_front,
)
from jghand_engine.study.accuracy_growth import Growth, Reach, growth_cases
from jghand_engine.study.accuracy_reference import Error, ExactPictures64, error_from, pose_count, spread_poses
from jghand_engine.study.accuracy_variants import TOGETHER, Variant, linear_tiers, variants

# frames of each setting, and those before them that are not counted (RENDERING 9.2)
ROUNDS, QUICK_ROUNDS = 150, 15
# poses of a quick study that are drawn in double precision, which takes seconds each
QUICK_POSES = 2
WARM_UP = 10
# pictures of a capture that every setting is compared with: fewer do not tell settings apart (their standard error is
# some tenths of a decibel with nine)
PICTURES, QUICK_PICTURES = 120, 9
# side of the part of the picture that is shown of a setting, in a picture 334 pixels high
CROP_PX = 150


@dataclass(frozen=True)
class Truth:
    """Pictures of a capture to compare with."""

    samples: tuple[Sample, ...]
    # which they are, in words
    origin: str

    @property
    def in_known_light(self) -> bool:
        """Whether they are drawn in their own light, where its passes show."""
        return all(sample.light is not None for sample in self.samples)


@dataclass(frozen=True)
class Plan:
    """What is measured."""

    avatar: HandAvatar
    # as users call it
    name: str
    size_px: tuple[int, int] = (512, 334)
    # None without a capture
    truth: Truth | None = None
    # frames of each setting
    rounds: int = ROUNDS
    # of the curves of growing time
    reach: Reach = field(default_factory=Reach)
    # that are drawn in double precision; 0: as `pose_count` says
    poses: int = 0


def measure_accuracy(plan: Plan, say: Callable[[str], None] = lambda _text: None) -> Accuracy:
    """Measures everything. say: called with what is being done."""
    subject = moving_subject(plan.name, plan.avatar, *plan.size_px)
    say("Fitting linear correctives")
    # the exact pictures are not filtered either: errors and times are both of pictures without it
    compared = [
        replace(variant, settings=replace(variant.settings, antialias=False))
        for variant in variants(plan.avatar, plan.size_px, linear_tiers(plan.avatar))
    ]
    poses = plan.poses or pose_count(plan.size_px)
    say(f"Drawing {poses} poses in double precision")
    exact = ExactPictures64(subject, spread_poses(subject, poses))
    say(f"Comparing {len(compared)} settings with them")
    errors = _errors(compared, subject, exact)
    scores: list[TruthScore | None] = [None for _ in compared]
    if plan.truth is not None:
        # passes of a scene's light, which stand last, change no other pictures
        told = [variant for variant in compared if variant.light is None or plan.truth.in_known_light]
        say(f"Comparing {len(told)} settings with {len(plan.truth.samples)} pictures of the capture")
        scores[: len(told)] = truth_scores(told, plan.avatar, plan.truth)
    say(f"Measuring times: {plan.rounds} frames of each, in turn")
    measured, growth = _times(compared, subject, plan)
    rows = [
        _row(variant, error, truth, measured.get(str(number), []))
        for number, (variant, error, truth) in enumerate(zip(compared, errors, scores, strict=True))
    ]
    rows = _described(rows, compared, subject)
    return Accuracy(
        plan.name, len(plan.avatar), plan.size_px, machine(0), tuple(rows), tuple(growth), poses,
        "" if plan.truth is None else plan.truth.origin,
    )  # fmt: skip


def _errors(compared: Sequence[Variant], subject: Subject, exact: ExactPictures64) -> list[Error]:
    """From the exact pictures; in the light of a scene, for which there are none, from those of preset `reference`."""
    errors = [exact.error(_drawer(variant, subject)) for variant in compared if variant.light is None]
    lit = [variant for variant in compared if variant.light is not None]
    if lit:
        best = _drawer(replace(lit[0], settings=replace(PRESETS["reference"], antialias=False)), subject)
        pictures = [best(pose_m)[..., :3] for pose_m in exact.poses_m]
        errors += [error_from(pictures, exact.poses_m, _drawer(variant, subject)) for variant in lit]
    return errors


def _drawer(variant: Variant, subject: Subject) -> Callable[[np.ndarray], np.ndarray]:
    """What a variant makes of joints (21, 3): (H, W, 4) premultiplied, as it is displayed."""
    renderer = HandRenderer(variant.avatar or subject.avatar, variant.settings, variant.light)
    return lambda pose_m: renderer.render(pose_m, subject.camera).displayed()


def _times(
    compared: Sequence[Variant], subject: Subject, plan: Plan
) -> tuple[dict[str, list[Measurement]], list[Growth]]:
    """Measurements by the number of their variant, whole frame first, and the curves; all in one run."""
    cases = [_case(variant, subject, str(number)) for number, variant in enumerate(compared)]
    viewport = replace(PRESETS["viewport"], reuse=False)
    cases += growth_cases(plan.avatar, plan.size_px, viewport, plan.reach)
    measured = measure(cases, rounds=plan.rounds, warm_up=min(WARM_UP, plan.rounds))
    by_section: dict[str, list[Measurement]] = {}
    for one in measured:
        by_section.setdefault(one.section, []).append(one)
    return by_section, Growth.of(measured)


def _case(variant: Variant, subject: Subject, section: str) -> Case:
    avatar = variant.avatar or subject.avatar
    case = frame_case(replace(subject, avatar=avatar), variant.settings, section)
    if variant.light is not None:
        renderer = HandRenderer(avatar, variant.settings, variant.light)
        poses = itertools.cycle(subject.poses)
        case = replace(case, run=lambda: renderer.render(next(poses), subject.camera).report)
    return replace(case, name="frame")


def _row(variant: Variant, error: Error, truth: TruthScore | None, measured: Sequence[Measurement]) -> Row:
    whole, stages = measured[0], measured[1:]
    return Row(
        variant.axis, variant.name, whole.median_ms, whole.p95_ms,
        {stage.name.strip(): stage.median_ms for stage in stages}, error, truth, whole.samples, whole.dropped,
        whole.disturbed, made_by=variant.made_by,
    )  # fmt: skip


def _described(rows: Sequence[Row], compared: Sequence[Variant], subject: Subject) -> list[Row]:
    """With the front, words, and pictures of the finger tips of what can be chosen."""
    front = pareto_front((row.median_ms, row.error.psnr_db, row) for row in rows if row.axis == TOGETHER)
    described = []
    # where finger tips are seen best: the fingers straightest
    pose_m = subject.poses[np.linalg.norm(subject.poses[:, -4:] - subject.poses[:, :1], axis=-1).mean(1).argmax()]
    for row, variant in zip(rows, compared, strict=True):
        if row.axis != TOGETHER:
            described.append(row)
            continue
        words = left_out(variant.settings, len(subject.avatar))
        if _is_approximate(variant, subject.avatar):
            words["tier"] = APPROXIMATE
        picture = _drawer(variant, subject)(pose_m)
        on_front = any(row is one for one in front) or (row.preset and faster_than(row, rows) is None)
        looks = how_it_looks(row.error.psnr_db, list(words.values()))
        described.append(replace(row, looks=looks, on_front=on_front, crop=finger_tips(picture, pose_m, subject)))
    return described


def _is_approximate(variant: Variant, avatar: HandAvatar) -> bool:
    """Whether its correctives are of the linear tier."""
    learned = (variant.avatar or avatar).learned
    if learned is None or "correctives" in left_out(variant.settings, len(avatar)):
        return False
    return isinstance(learned.with_tier(variant.settings.correctives)[0].correctives, LinearCorrectives)


def finger_tips(picture: np.ndarray, pose_m: np.ndarray, subject: Subject) -> np.ndarray:
    """The part (H, W, 3) uint8 of a picture (H, W, 4) around its finger tips, on a light ground."""
    pixels, _ = subject.camera.project(pose_m[-4:])
    side = min(CROP_PX * subject.camera.height // 334 or 1, *picture.shape[:2])
    left, top = (
        int(np.clip(center - side / 2, 0, size - side))
        for center, size in zip(pixels.mean(0).tolist(), picture.shape[1::-1], strict=True)
    )
    part = picture[top : top + side, left : left + side]
    flat = part[..., :3] + (1 - part[..., 3:]) * 0.93
    return np.round(255 * np.clip(flat, 0, 1)).astype(np.uint8)


# ---- against pictures of a capture ----------------------------------------------------------------------------------


def held_out_truth(avatar: HandAvatar, folder: Path, say: Callable[[str], None], pictures: int = PICTURES) -> Truth:
    """About so many pictures that a capture's split holds out, of every kind as many as of the others, or all; of a
    capture that the avatar did not learn from, as far as it says, any. say: called with doubts about them."""
    capture = open_capture(folder)
    told = held_out(avatar, capture, split_capture(capture, to_learn=False))
    if told.warning:
        say(told.warning)
    if not told.is_known:
        # then no more is known of those that the split holds out
        samples = spread(capture.samples, pictures)
        return Truth(samples, f"{len(samples)} pictures of {capture.name} ({NOT_KNOWN})")
    # pictures that were all learned from can still be compared with; that is said above and in the table
    which = "test" if told.split.test else "train"
    sizes = [len(samples) for samples in categories_of(told.split, which).values()]
    categories = categories_of(told.split, which, pictures_of_each(sizes, pictures))
    counts = ", ".join(f"{len(samples)} {kind}" for kind, samples in categories.items())
    samples = tuple(sample for kind in categories.values() for sample in kind)
    return Truth(samples, f"{len(samples)} pictures of {capture.name} ({counts}; {told.split.origin})")


def pictures_of_each(sizes: Sequence[int], wanted: int) -> int:
    """How many of each kind make `wanted` together, or `wanted` where there are not so many. sizes: of the kinds"""
    return next((n for n in range(1, wanted) if sum(min(n, size) for size in sizes) >= wanted), wanted)


def truth_scores(compared: Sequence[Variant], avatar: HandAvatar, truth: Truth) -> list[TruthScore | None]:
    """Of every variant; what it gains is against preset `reference`, picture by picture."""
    drawers = [AvatarPicturer(variant.avatar or avatar, variant.settings) for variant in compared]
    psnr_db = pictures_psnr_db(drawers, truth)
    exact = next(n for n, one in enumerate(compared) if (one.axis, one.name) == (TOGETHER, "reference"))
    return [TruthScore.of(own, psnr_db[exact]) for own in psnr_db]


def pictures_psnr_db(drawers: Sequence[Picturer], truth: Truth) -> np.ndarray:
    """(D, P) of whole pictures over black, by who draws, all of one kind, and by picture."""
    psnr_db = np.empty((len(drawers), len(truth.samples)))
    for column, sample in enumerate(truth.samples):
        shown = truth_of(sample, drawers[0])
        for line, draw in enumerate(drawers):
            rgba, picture, _ = pictured(sample, draw, shown)
            # premultiplied: over black it is the picture
            psnr_db[line, column] = psnr(checked_picture("rgb", rgba[..., :3], picture.mask), picture.rgb)
    return psnr_db
