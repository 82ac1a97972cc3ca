"""How good `jghand own` is, over films whose truth is known (scripts/make_test_films.py): tables of docs/OWN_HAND.md.

    python scripts/judge_own.py --films films                           every film in the folder that has its truth
    python scripts/judge_own.py --films films --photographs --exact     also five photographs, and joints that are known
    python scripts/judge_own.py --films films --built-in                also the built-in hand, in the film's light
    python scripts/judge_own.py --films films --faults                  also films with a fault
    python scripts/judge_own.py --films films --page docs/OWN_HAND.md   puts the tables into the page

Wants the extra `track` and its networks. Beside each film lies what was made of it, as own.jghand and so on; what is
there is judged and not made again. Held out are other poses from other cameras, which the avatar is driven to by exact
joints. Nothing beyond the wrist counts. Everything that is printed is measured in this run, but for the times of films
that were made in an earlier one.
"""

from __future__ import annotations

import json
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import tyro
from motion_errors import MotionErrors, motion_errors
from other_programs import put_into_page, table
from PIL import Image

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.builtin import load_builtin
from jghand_engine.avatar.file import load_avatar, save_avatar
from jghand_engine.avatar.relighting import covered_mean, thrown_back
from jghand_engine.avatar.scene_light import SceneLight, World
from jghand_engine.captures.capture_folder import open_capture
from jghand_engine.captures.sample import load_image
from jghand_engine.captures.splits import split_capture
from jghand_engine.cli.own import Own
from jghand_engine.color import displayed, linear_to_srgb, srgb_to_linear
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.learn.evaluate import AvatarPicturer
from jghand_engine.own.film import FilmPictures, open_source
from jghand_engine.own.fit_outlines import shape_of_outlines
from jghand_engine.own.hand_fit import FittedHand
from jghand_engine.own.make import FIT, MASKS, PICTURES, START, Begun, Explained, OwnOptions, begin, hand_of
from jghand_engine.own.masks import wrist_side
from jghand_engine.own.report import side_scores
from jghand_engine.own.start import Start
from jghand_engine.render.camera import Camera
from jghand_engine.render.settings import preset
from jghand_engine.track import CAMERA_ANGLE_DEG, mediapipe_hands
from jghand_engine.track.video import open_video, read_frames

# seconds of a film at which it shows what is to be photographed: palm, back, the thumb's side, a fist from both sides
PHOTOGRAPHED_S = (1.0, 7.8, 5.3, 2.9, 9.7)
AVATAR = {"film": "own", "photographs": "photographs", "exact": "exact"}
BUILT_IN, TINTED = "built-in", "built-in, tinted"
REFUSED = "is refused"


@dataclass(frozen=True)
class Options:
    """films: folder of folders with film.mp4, truth.npz and capture/ · photographs: also five pictures of each film ·
    exact: also with joints and masks that are known · built_in: also what is won over
    the built-in hand, see `built_in_hands` · faults: also what a look at the films without capture/ tells before any
    fit, and how good they are where they are used · page: gets the tables"""

    films: Path
    photographs: bool = False
    exact: bool = False
    built_in: bool = False
    faults: bool = False
    page: Path | None = None


@dataclass(frozen=True)
class Judged:
    """What an avatar of a film is worth.

    whole, cut:   PSNR in dB and SSIM of held-out pictures, and of the hand's box alone · within_db: within its mask
    flip:         perceived difference in the box, 0..1; None without the extra `metrics`
    iou:          of outlines, held out
    motion:       the fit's errors, see MotionErrors; None where it was given the truth, and of the built-in hand
    masks:        mean and worst overlap with the true ones; None where they are given
    fitted_db:    of pictures of the film that no skin was made of, whole, cut and within the mask, in poses that were
                  fitted to them: what papers on hands from films print (UHM, HARP); None of photographs, and where the
                  poses are the true ones
    seconds:      wall and processor time of making it; None: not known
    """

    whole: tuple[float, float]
    cut: tuple[float, float]
    within_db: float
    flip: float | None
    iou: float
    motion: MotionErrors | None = None
    masks: tuple[float, float] | None = None
    fitted_db: tuple[float, float, float] | None = None
    seconds: tuple[float, float] | None = None


@dataclass(frozen=True)
class Truth:
    """Of the pictures of a film that an avatar is made of. camera: of a picture · joints_m: (F, 21, 3) camera axes
    masks: (F, H, W) of the hand on its side of the wrist"""

    camera: Camera
    joints_m: np.ndarray
    masks: np.ndarray

    @classmethod
    def of(cls, folder: Path, pictures: FilmPictures) -> Truth:
        """Of photographs by their numbers among PHOTOGRAPHED_S."""
        with np.load(folder / "truth.npz") as stored:
            times = pictures.time_s if pictures.is_film else np.array(PHOTOGRAPHED_S)[pictures.index]
            rows = np.abs(stored["time_s"] - times[:, None]).argmin(1)
            width, height = (int(edge) for edge in stored["size_px"])
            focal = float(stored["focal_px"])
            camera = Camera(width, height, focal, focal, width / 2, height / 2, np.eye(4))
            return cls(camera, stored["joints_m"][rows], stored["mask"][rows])

    def within(self, camera: Camera, shrunk: float) -> Truth:
        """Of the part of the pictures that a camera with another focal length sees, so many times smaller."""
        left, top = round(self.camera.cx - camera.cx * shrunk), round(self.camera.cy - camera.cy * shrunk)
        width, height = round(camera.width * shrunk), round(camera.height * shrunk)
        cut = [Image.fromarray(one[top : top + height, left : left + width]) for one in self.masks]
        size = camera.width, camera.height
        masks = [np.asarray(one.convert("L").resize(size, Image.Resampling.BOX)) >= 128 for one in cut]
        part = self.camera.part(left, top, width, height)
        across, down = size[0] / width, size[1] / height
        lens = (part.fx * across, part.fy * down, part.cx * across, part.cy * down)
        return Truth(Camera(*size, *lens, np.eye(4)), self.joints_m, np.stack(masks))


def held_out(avatar: HandAvatar, folder: Path) -> Judged:
    """What an avatar with the light of a film is worth on the pictures that its capture holds out."""
    response = avatar.learned and avatar.learned.response
    if response is None or response.film_light is None:
        raise SystemExit(f"{folder}: its avatar has no light of a film")
    with np.load(folder / "truth.npz") as stored:
        gain = float(np.median(stored["gain"]))
    draw, light, found = AvatarPicturer(avatar, preset("final")), SceneLight(World.of_cells(response.film_light)), []
    for sample in split_capture(open_capture(capture_of(folder)), to_learn=False).test:
        truth, camera = load_image(sample), sample.camera
        side = wrist_side(camera.project(sample.joints_m)[0][None], camera.width, camera.height)[0]
        straight = truth.rgb / np.maximum(truth.mask, 1e-3)[..., None]
        exposed = linear_to_srgb(np.clip(gain * srgb_to_linear(straight), 0, 1)) * truth.mask[..., None]
        found.append(side_scores(displayed(draw.in_light(sample, light)), exposed, truth.mask >= 0.5, side))
    mean = {figure: float(np.mean([one[figure] for one in found])) for figure in found[0]}
    return Judged(
        (mean["psnr_full"], mean["ssim_full"]), (mean["psnr_box"], mean["ssim_box"]), mean["psnr_mask"],
        mean.get("flip_box"), mean["iou"],
    )  # fmt: skip


def built_in_hands(folder: Path) -> dict[str, HandAvatar]:
    """The built-in hand in the light found in a film, as it is, and with the mean albedo of the film's skin: what the
    lengths of bones, which come with the joints, are worth alone."""
    hand, own = load_builtin(handedness=Handedness.RIGHT), load_avatar(folder / f"{AVATAR['film']}.jghand")
    assert hand.learned is not None
    assert hand.learned.response is not None
    assert own.learned is not None
    assert own.learned.response is not None
    response = replace(hand.learned.response, film_light=own.learned.response.film_light)
    lit = replace(hand, learned=replace(hand.learned, response=response))
    rgb = np.clip(lit.rgb * (covered_mean(own, own.rgb) / covered_mean(lit, lit.rgb)), 0, 1).astype(np.float32)
    response = replace(response, bounce=thrown_back(lit, rgb))
    return {BUILT_IN: lit, TINTED: replace(lit, rgb=rgb, learned=replace(hand.learned, response=response))}


def judge(folder: Path, name: str, seconds: tuple[float, float] | None = None) -> Judged:
    """What lies beside a film as `name`.jghand, and its work folder."""
    work = folder / f"{name}.own"
    judged = replace(held_out(load_avatar(folder / f"{name}.jghand"), folder), seconds=seconds)
    if name == AVATAR["exact"]:
        return judged
    report = json.loads((work / "report.json").read_text(encoding="utf-8"))["mean"]
    fitted_db = (report["psnr_full"], report["psnr_box"], report["psnr_mask"]) if report else None
    fitted, pictures = FittedHand.load(work / FIT), FilmPictures.load(work / PICTURES)
    whole = Truth.of(folder, pictures)
    shrunk = shrunk_by(work, whole.camera)
    truth = whole.within(fitted.camera, shrunk)
    motion = motion_errors(fitted.joints_m, fitted.camera.fx * shrunk, whole.joints_m, whole.camera.fx)
    with np.load(work / MASKS) as stored:
        ours = stored["hand"]
    overlap = (ours & truth.masks).sum((1, 2)) / (ours | truth.masks).sum((1, 2))
    masks = float(overlap.mean()), float(overlap.min())
    return replace(judged, motion=motion, masks=masks, fitted_db=fitted_db)


def shrunk_by(work: Path, camera: Camera) -> float:
    """How many times smaller the pictures of a work folder are than the film's."""
    assumed = json.loads((work / "own.json").read_text(encoding="utf-8"))["options"]["camera_angle_deg"]
    edge = max(camera.width, camera.height)
    focal_px = edge / (2 * np.tan(np.radians(assumed or CAMERA_ANGLE_DEG) / 2))
    return focal_px / Start.load(work / START).camera.fx


# ---- what is judged --------------------------------------------------------------------------------------------------


def made(folder: Path, name: str) -> tuple[float, float] | None:
    """Makes what is not there of a film; seconds that it took. InputError where `jghand own` refuses the film."""
    out = folder / f"{name}.jghand"
    if out.exists():
        return None
    began = time.perf_counter(), time.process_time()
    if name == AVATAR["exact"]:
        make_exact(folder, out)
    else:
        given = [folder / "film.mp4"] if name == AVATAR["film"] else photographs(folder)
        Own(tuple(given), out=out).run()
    return time.perf_counter() - began[0], time.process_time() - began[1]


def capture_of(folder: Path) -> Path:
    """The folder that holds out pictures of a film; of a film with a fault that of the same hand without it."""
    own = folder / "capture"
    return own if own.is_dir() else folder.with_name(folder.name.partition("_")[0]) / "capture"


def photographs(folder: Path) -> list[Path]:
    """Pictures of the film, as files."""
    with np.load(folder / "truth.npz") as stored:
        rows = np.abs(stored["time_s"] - np.array(PHOTOGRAPHED_S)[:, None]).argmin(1)
    frames = list(read_frames(open_video(folder / "film.mp4"), []))
    files = [folder / f"photograph{number}.png" for number in range(len(rows))]
    for file, row in zip(files, rows, strict=True):
        Image.fromarray(frames[row]).save(file)
    return files


def make_exact(folder: Path, out: Path) -> None:
    """Shape and skin of the film, of the hand that stands where it truly stood, cut out by the true masks."""
    work, prior = folder / f"{AVATAR['film']}.own", load_builtin(handedness=Handedness.RIGHT)
    pictures, start, fitted = FilmPictures.load(work / PICTURES), Start.load(work / START), FittedHand.load(work / FIT)
    whole = Truth.of(folder, pictures)
    truth = whole.within(fitted.camera, shrunk_by(work, whole.camera))
    nothing = np.zeros(len(pictures))
    shape = shape_of_outlines(prior, fitted.shape, truth.joints_m, truth.camera, truth.masks)
    known = replace(fitted, camera=truth.camera, joints_m=truth.joints_m, shape=shape, outline_residual=nothing)
    out.with_suffix(".own").mkdir(exist_ok=True)
    avatar, _ = hand_of(
        Explained(Begun(start, pictures, start, []), known, truth.masks),
        prior,
        out.with_suffix(".own"),
        lambda *_: None,
    )
    save_avatar(out, avatar)


def told_of(film: Path) -> tuple[str, str]:
    """What becomes of a film, and what a look at it tells."""
    prior = load_builtin(handedness=Handedness.RIGHT)
    try:
        findings = begin(
            open_source([film]), prior, OwnOptions(), mediapipe_hands.video_detector, lambda *_: None
        ).findings
    except InputError as error:
        return REFUSED, str(error)
    verdict = REFUSED if any(finding.refuses for finding in findings) else "is used"
    return verdict, ", ".join(dict.fromkeys(finding.check for finding in findings))


def main(options: Options) -> None:
    kinds = ["film", *(kind for kind in ("photographs", "exact") if getattr(options, kind))]
    rows: dict[tuple[str, str], Judged] = {}
    faults: list[tuple[str, str, str]] = []
    refused: list[str] = []
    # without them every film would be refused
    mediapipe_hands.check_package()
    mediapipe_hands.model_file()
    for truth in sorted(options.films.glob("*/truth.npz")):
        folder, made_from = truth.parent, kinds
        has_fault = capture_of(folder) != folder / "capture"
        if has_fault:
            if not options.faults:
                continue
            faults.append((folder.name, *told_of(folder / "film.mp4")))
            is_judged = faults[-1][1] != REFUSED and capture_of(folder).is_dir()
            made_from = ["film"] if is_judged else []
        for kind in made_from:
            kept = folder / f"{AVATAR[kind]}.judged.json"
            if kind == "exact" and (folder.name, "film") not in rows:
                continue
            try:
                seconds = made(folder, AVATAR[kind])
            except InputError as error:
                refused.append(f"{folder.name}, {kind} ({error})")
                continue
            if seconds is None and kept.exists():
                seconds = json.loads(kept.read_text(encoding="utf-8"))["seconds"]
            rows[folder.name, kind] = judge(folder, AVATAR[kind], seconds)
            kept.write_text(json.dumps(asdict(rows[folder.name, kind]), indent=1) + "\n", encoding="utf-8")
        if options.built_in and not has_fault and (folder.name, "film") in rows:
            rows |= {(folder.name, kind): held_out(hand, folder) for kind, hand in built_in_hands(folder).items()}
    text = f"{held_out_table(rows)}\n\n{fit_table(rows)}"
    if refused:
        text += f"\n\nRefused: {'; '.join(refused)}"
    if faults:
        text += f"\n\n{table(('film with a fault', 'it', 'what is told before the fit'), faults, words=3)}"
    print(text)
    if options.page is not None:
        put_into_page(options.page, Path(__file__).name, text)


def held_out_table(rows: dict[tuple[str, str], Judged]) -> str:
    """Of pictures that were held out."""
    header = ("film", "made from", "whole, dB / SSIM", "cut to the hand", "its FLIP", "within the mask, dB",
              "outline IoU", "pose fitted, whole / cut / within, dB")  # fmt: skip
    cells = [
        (
            name, kind, f"{one.whole[0]:.1f} / {one.whole[1]:.3f}", f"{one.cut[0]:.1f} / {one.cut[1]:.3f}",
            "" if one.flip is None else f"{one.flip:.3f}", f"{one.within_db:.1f}", f"{one.iou:.3f}",
            " / ".join(f"{figure:.1f}" for figure in one.fitted_db or ()),
        )
        for (name, kind), one in rows.items()
    ]  # fmt: skip
    return table(header, cells, words=2)


def fit_table(rows: dict[tuple[str, str], Judged]) -> str:
    """Of the fit, and of the masks."""
    header = ("film", "made from", "aligned mm", "wrist mm", "finger bones, deg", "in the palm, deg", "bone lengths",
              "pixels", "masks, mean / worst", "wall / processor s")  # fmt: skip
    cells = []
    for (name, kind), one in rows.items():
        if one.motion is None or one.masks is None:
            continue
        motion, spent = one.motion, one.seconds
        cells.append((
            name, kind, f"{motion.aligned_mm:.1f}", f"{motion.wrist_mm:.1f}",
            *(f"{middle:.1f} / {most:.0f}" for middle, most in (motion.camera_deg, motion.palm_deg)),
            f"{100 * motion.bones_part:.1f} %", f"{motion.px[0]:.1f} / {motion.px[1]:.0f}",
            f"{one.masks[0]:.3f} / {one.masks[1]:.3f}", f"{spent[0]:.0f} / {spent[1]:.0f}" if spent else "",
        ))  # fmt: skip
    return table(header, cells, words=2)


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
