"""Sheets of pictures that show what figures hide: truth, ours and difference; new poses, new views, poses in between.

Every hand is cut out as a square around it and stands on the same light ground, so that its outline can be judged.
Differences are those over black, in colors whose scale stands in the head of the sheet.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from jghand_engine.captures.captures import by_pose
from jghand_engine.captures.sample import Sample
from jghand_engine.color import to_bytes
from jghand_engine.export.pictures import RGB, Cell, SheetStyle, contact_sheet, write_png
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.sequence import palm_frames, poses_between
from jghand_engine.learn.evaluate import Evaluation, Picturer, PictureScore, pictured, spread
from jghand_engine.learn.metrics import psnr
from jghand_engine.render.camera import Camera
from jghand_engine.render.framing import framing_camera

# sheets of pictures: side of the square over that of the hand in it; difference 0..1 that has the darkest color (a
# good avatar stays below it nearly everywhere); poses between the two ends (PAPER 4)
SHEET_ROOM = 1.12
SHEET_DIFFERENCE_FULL = 0.2
SHEET_STEPS_BETWEEN = 4

# sides from which a sheet of views shows each pose, as `jghand render` names them; pixels of a view, twice a cell
VIEWS = ("quarter", "front", "side", "back", "outside", "top")
VIEW_PX = 528

_CELL_PX = 264
_GROUND: RGB = (0.925, 0.92, 0.905)
_PAGE: RGB = (0.975, 0.973, 0.966)
_INK: RGB = (0.17, 0.17, 0.18)
_QUIET_INK: RGB = (0.42, 0.42, 0.43)
# differences from none (the ground itself) to the full scale: light to dark, so that they read in gray too
_HEAT = np.array([_GROUND, (0.98, 0.83, 0.52), (0.94, 0.52, 0.23), (0.76, 0.18, 0.27), (0.36, 0.06, 0.34)])


@dataclass(frozen=True)
class _Square:
    """The square around a hand: center (x, y) and half its side, pixels."""

    x: float
    y: float
    half: float

    @staticmethod
    def around(alpha: np.ndarray) -> _Square:
        """Around what is at least half covered, (H, W), with some room; the whole picture where nothing is."""
        rows, columns = np.flatnonzero((alpha >= 0.5).any(1)), np.flatnonzero((alpha >= 0.5).any(0))
        if not len(rows):
            return _Square(alpha.shape[1] / 2, alpha.shape[0] / 2, max(alpha.shape) / 2)
        side = max(rows[-1] - rows[0], columns[-1] - columns[0]) + 1
        return _Square((columns[0] + columns[-1] + 1) / 2, (rows[0] + rows[-1] + 1) / 2, 0.5 * SHEET_ROOM * float(side))

    def hand(self, rgb: np.ndarray, alpha: np.ndarray) -> np.ndarray:
        """Premultiplied colors (H, W, 3) and alpha (H, W) on the sheet's ground, cut out by `of`."""
        return self.of(rgb + (1 - alpha[..., None]) * np.asarray(_GROUND, np.float32))

    def of(self, picture: np.ndarray) -> np.ndarray:
        """(H, W, 3) 0..1 -> the square as (S, S, 3) uint8 of the sheet's cell size; ground beyond the picture."""
        size = max(2, round(2 * self.half))
        left, top = round(self.x - size / 2), round(self.y - size / 2)
        cut = np.broadcast_to(np.asarray(_GROUND, np.float32), (size, size, 3)).copy()
        height, width = picture.shape[:2]
        rows = slice(max(0, top), min(height, top + size))
        columns = slice(max(0, left), min(width, left + size))
        cut[rows.start - top : rows.stop - top, columns.start - left : columns.stop - left] = picture[rows, columns]
        image = Image.fromarray(to_bytes(cut)).resize((_CELL_PX, _CELL_PX), Image.Resampling.LANCZOS)
        return np.asarray(image)


def comparison_sheet(pictures: Sequence[PictureScore], draw: Picturer, title: str) -> np.ndarray:
    """Truth, ours and difference of each picture, two pictures a row; (H, W, 3) uint8. InputError without pictures."""
    cells: list[Cell] = []
    for picture in pictures:
        sample = picture.sample
        rgba, truth, _ = pictured(sample, draw)
        square = _Square.around(truth.mask)
        unlike = np.abs(np.clip(rgba[..., :3], 0, 1) - truth.rgb).mean(-1)
        cells += [
            Cell(f"truth · {_where(sample)}", square.hand(truth.rgb, truth.mask)),
            Cell(f"ours · {picture.scores['psnr_full']:.1f} dB", square.hand(rgba[..., :3], rgba[..., 3])),
            Cell(f"difference · {picture.category}", square.of(heat(unlike))),
        ]  # fmt: skip
    sheet = _sheet(cells, min(6, len(cells)))
    return _with_head(sheet, title, "PSNR of the full picture on black; difference: mean over the channels", scale=True)


def variant_sheet(samples: Sequence[Sample], drawers: Mapping[str, Picturer], title: str) -> np.ndarray:
    """Each sample in a row of its own: the truth, then what each drawer makes of it; (H, W, 3) uint8."""
    cells: list[Cell] = []
    for sample in samples:
        drawn = {name: pictured(sample, draw) for name, draw in drawers.items()}
        _, truth, _ = next(iter(drawn.values()))
        square = _Square.around(truth.mask)
        cells.append(Cell(f"truth · {_where(sample)}", square.hand(truth.rgb, truth.mask)))
        for name, (rgba, truth, _) in drawn.items():
            label = f"{name} · {psnr(np.clip(rgba[..., :3], 0, 1), truth.rgb):.1f} dB"
            cells.append(Cell(label, square.hand(rgba[..., :3], rgba[..., 3])))
    return _with_head(_sheet(cells, 1 + len(drawers)), title, "PSNR of the full picture on black")


def from_best_to_worst(pictures: Sequence[PictureScore], count: int) -> tuple[PictureScore, ...]:
    """`count` pictures, the best and the worst by PSNR among them, the others evenly between by rank."""
    return spread(sorted(pictures, key=lambda picture: -picture.scores["psnr_full"]), count)


def view_sheet(samples: Sequence[Sample], draw: Picturer, title: str) -> np.ndarray:
    """Each sample's pose, a row of its own, from cameras that no picture was taken by; (H, W, 3) uint8."""
    cells = []
    for sample in samples:
        for view in VIEWS:
            camera = _camera(sample.joints_m[None], sample.handedness, view)
            rgba = draw(sample.hand, sample.handedness, camera)
            hand = _Square.around(rgba[..., 3]).hand(rgba[..., :3], rgba[..., 3])
            cells.append(Cell(f"{view} · pose {sample.frame}", hand))
    return _with_head(_sheet(cells, len(VIEWS)), title, "Each row: one pose that was not learned, from new sides")


def _camera(joints_m: np.ndarray, handedness: Handedness, view: str) -> Camera:
    """One that sees all of the hands (F, 21, 3)."""
    return framing_camera(joints_m, handedness, view, width=VIEW_PX, height=VIEW_PX)


def between_sheet(pairs: Sequence[tuple[Sample, Sample]], drawers: Mapping[str, Picturer], title: str) -> np.ndarray:
    """Poses between two, by their joint angles (PAPER 4): for each pair one row per drawer, the ends included.

    One camera sees every row's hands, and they are cut out alike. (H, W, 3) uint8.
    """
    cells = []
    parts = np.linspace(0, 1, SHEET_STEPS_BETWEEN + 2)
    for first, second in pairs:
        hands = hands_between(first, second, parts)
        camera = _camera(hands, first.handedness, VIEWS[0])
        steps = [f"{part:.0%}" for part in parts.tolist()]
        labels = [f"pose {first.frame}", *steps[1:-1], f"pose {second.frame}"]
        for name, draw in drawers.items():
            drawn = [draw(joints_m, first.handedness, camera) for joints_m in hands]
            square = _Square.around(np.max([rgba[..., 3] for rgba in drawn], axis=0))
            for label, rgba in zip(labels, drawn, strict=True):
                text = f"{name} · {label}" if len(drawers) > 1 else label
                cells.append(Cell(text, square.hand(rgba[..., :3], rgba[..., 3])))
    subtitle = "Between two poses that were not learned, by joint angles"
    return _with_head(_sheet(cells, len(parts)), title, subtitle)


def hands_between(first: Sample, second: Sample, parts: np.ndarray) -> np.ndarray:
    """(T, 21, 3) joints at `parts` (T,) of the way, along which bones turn; the second hand is put where the first one
    is."""
    a, b = (np.asarray(sample.joints_m, dtype=np.float64) for sample in (first, second))
    (palm_a, palm_b), _ = palm_frames(np.stack([a, b]))
    b = (b - b[0]) @ (palm_a @ palm_b.T).T + a[0]
    first_m, second_m = (np.broadcast_to(pose_m, (len(parts), *pose_m.shape)) for pose_m in (a, b))
    return poses_between(first_m, second_m, parts[:, None, None])


def pairs_of(samples: Sequence[Sample], count: int) -> list[tuple[Sample, Sample]]:
    """Random pairs of different poses, at most `count`, no pose twice."""
    poses = list({sample.pose: sample for sample in samples}.values())
    order = np.random.default_rng(0).permutation(len(poses))
    return [(poses[a], poses[b]) for a, b in zip(order[:-1:2], order[1::2], strict=False)][:count]


def varied_samples(samples: Sequence[Sample], count: int) -> tuple[Sample, ...]:
    """One picture of each of at most `count` poses, evenly spread, each by another camera where there are several."""
    return spread([group[place % len(group)] for place, group in enumerate(by_pose(samples).values())], count)


def heat(values: np.ndarray) -> np.ndarray:
    """(H, W) differences -> (H, W, 3): the ground at 0, dark at SHEET_DIFFERENCE_FULL and beyond."""
    place = np.clip(values / SHEET_DIFFERENCE_FULL, 0, 1) * (len(_HEAT) - 1)
    return np.stack([np.interp(place, range(len(_HEAT)), _HEAT[:, c]) for c in range(3)], -1)


# ---- the page -------------------------------------------------------------------------------------------------------


def _sheet(cells: Sequence[Cell], columns: int) -> np.ndarray:
    return contact_sheet(cells, SheetStyle(columns, _CELL_PX, gap_px=12, background=_PAGE, ink=_INK))


def _where(sample: Sample) -> str:
    return f"pose {sample.frame}, {sample.camera_name}"


def _with_head(sheet: np.ndarray, title: str, subtitle: str, *, scale: bool = False) -> np.ndarray:
    """The sheet below its title, and the scale of differences beside it."""
    large, small = ImageFont.load_default(size=26), ImageFont.load_default(size=17)
    height, margin = 84, 14
    page = Image.new("RGB", (sheet.shape[1], sheet.shape[0] + height), _color(_PAGE))
    page.paste(Image.fromarray(sheet), (0, height))
    draw = ImageDraw.Draw(page)
    draw.text((margin, 16), title, fill=_color(_INK), font=large)
    draw.text((margin, 52), subtitle, fill=_color(_QUIET_INK), font=small)
    if scale:
        bar = to_bytes(heat(np.tile(np.linspace(0, SHEET_DIFFERENCE_FULL, 220), (16, 1))))
        left = page.width - margin - bar.shape[1]
        page.paste(Image.fromarray(bar), (left, 22))
        for text, x, anchor in (
            ("0", left, "la"),
            (f"{SHEET_DIFFERENCE_FULL:g} and more", page.width - margin, "ra"),
        ):
            draw.text((x, 46), text, fill=_color(_QUIET_INK), font=small, anchor=anchor)
    return np.asarray(page)


def _color(color: RGB) -> tuple[int, int, int]:
    red, green, blue = to_bytes(np.asarray(color)).tolist()
    return red, green, blue


# ---- of an evaluation ------------------------------------------------------------------------------------------------


def write_evaluation_sheets(
    out: Path, evaluation: Evaluation, categories: Mapping[str, tuple[Sample, ...]], drawers: Mapping[str, Picturer]
) -> None:
    """The sheets of an evaluation. drawers: by name, the evaluated avatar first."""
    name, draw = next(iter(drawers.items()))
    title = f"{name} on {evaluation.capture}"
    worst = from_best_to_worst(evaluation.pictures, 8)
    write_png(out / "best_to_worst.png", comparison_sheet(worst, draw, f"{title}: from the best to the worst"))
    for category, pictures in evaluation.groups().items():
        if category != "all":
            chosen = from_best_to_worst(pictures, 6)
            write_png(out / f"{category.replace(' ', '_')}.png", comparison_sheet(chosen, draw, f"{title}: {category}"))
    samples = [sample for group in categories.values() for sample in group]
    poses = varied_samples(categories.get("novel pose", samples), 12)
    write_png(out / "views.png", view_sheet(varied_samples(poses, 3), draw, f"{title}: views"))
    if len({sample.pose for sample in samples}) > 1:
        pairs = pairs_of(poses if len(poses) > 1 else samples, 3)
        between = between_sheet(pairs, drawers, f"{' and '.join(drawers)}: poses in between")
        write_png(out / "between.png", between)
