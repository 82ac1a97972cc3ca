"""How good an avatar from a film is: pictures of the film that it has not seen, what was seen of it, and a sheet."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.learned import no_light
from jghand_engine.avatar.scene_light import SceneLight
from jghand_engine.color import displayed
from jghand_engine.export.pictures import Cell, SheetStyle, contact_sheet, flatten, write_png
from jghand_engine.files import write_file
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import named_pose
from jghand_engine.learn.metrics import compare
from jghand_engine.own.gather import FEW_PICTURES
from jghand_engine.own.light_and_skin import OwnHand
from jghand_engine.own.masks import wrist_side
from jghand_engine.own.skin_prior import believed
from jghand_engine.render.camera import Camera
from jghand_engine.render.framing import framing_camera
from jghand_engine.render.renderer import SceneRenderer
from jghand_engine.render.settings import preset
from jghand_engine.track.track import MOTION_FROM_CAMERA

# of a film every so manieth picture is held out
HELD_OUT_EVERY = 8
# of the map: skin that is invented, and skin that pictures show
UNSEEN_RGB, SEEN_RGB = np.array([0.80, 0.22, 0.16]), np.array([0.16, 0.55, 0.32])
# of the sheet: pictures of the film, poses that are drawn anew, pixels of one
SHEET_PICTURES, SHEET_POSES, SHEET_PX = 4, ("open", "fist", "point", "relaxed"), 256
SHEET_GROUND = (0.925, 0.92, 0.905)


@dataclass(frozen=True)
class FilmView:
    """Pictures of a film with what is known of them, of a right hand in every case, see `gather.observe`.

    joints_m: (F, 21, 3) camera axes · camera: of one picture · pictures: (F, H, W, 3) uint8 · masks: (F, H, W)
    """

    joints_m: np.ndarray
    camera: Camera
    pictures: np.ndarray
    masks: np.ndarray

    def part(self, which: np.ndarray) -> FilmView:
        """Some of the pictures."""
        return replace(self, joints_m=self.joints_m[which], pictures=self.pictures[which], masks=self.masks[which])


def held_out(count: int, *, is_film: bool) -> np.ndarray:
    """(count,) bool: pictures of a film that no skin is made of; none of few pictures, or of photographs, which are all
    needed."""
    held = np.arange(count) % HELD_OUT_EVERY == HELD_OUT_EVERY // 2
    return held & (is_film and count >= FEW_PICTURES)


def drawn_before(own: OwnHand, film: FilmView) -> Iterator[np.ndarray]:
    """(H, W, 4) premultiplied sRGB of the avatar in the place of the hand of each picture, in the light of the film."""
    renderer = SceneRenderer([own.avatar.for_hand(Handedness.RIGHT)], preset("final"), SceneLight(own.world))
    camera = replace(film.camera, camera_from_world=np.diag([*MOTION_FROM_CAMERA, 1.0]))
    for joints_m in film.joints_m:
        yield displayed(renderer.render([joints_m * MOTION_FROM_CAMERA], camera).rgba)


def scores(own: OwnHand, film: FilmView) -> list[dict[str, float]]:
    """Of each picture the figures of `learn.metrics.compare`, over black, and `iou`, of the outline; what lies behind
    the wrist is no part of it. Their poses were fitted to these very pictures, as they are in the papers on hands from
    films (UHM, HARP)."""
    sides = wrist_side(film.camera.project(film.joints_m)[0], film.camera.width, film.camera.height)
    each = zip(drawn_before(own, film), film.pictures, film.masks, sides, strict=True)
    return [side_scores(rgba, picture / 255 * mask[..., None], mask, side) for rgba, picture, mask, side in each]


def side_scores(rgba: np.ndarray, rgb: np.ndarray, mask: np.ndarray, side: np.ndarray) -> dict[str, float]:
    """Figures of one picture on one side of the wrist: drawn (H, W, 4) and true (H, W, 3), both over black, 0..1; the
    true outline (H, W) bool; the side (H, W) bool."""
    inside, there = side & (rgba[..., 3] > 0.5), side & mask
    figures = compare(rgba[..., :3] * side[..., None], rgb * side[..., None], there.astype(np.float32))
    return figures | {"iou": float((inside & there).sum() / max((inside | there).sum(), 1))}


def seen_map(own: OwnHand, edge_px: int = SHEET_PX) -> dict[str, np.ndarray]:
    """The hand's palm and back, (H, W, 3) uint8, green where the skin is the film's, red where it is invented."""
    share = believed(own.seen)[:, None]
    avatar, learned = own.avatar.for_hand(Handedness.RIGHT), own.avatar.learned
    assert learned is not None
    flat = replace(learned, response=None, light=no_light(), cast=None, correctives=None, distilled=None, shadow=None)
    rgb = (share * SEEN_RGB + (1 - share) * UNSEEN_RGB).astype(np.float32)
    painted = replace(avatar, rgb=rgb, learned=flat, detail=None)
    return {f"seen of the {side}": picture for side, picture in _sides(painted, "open", edge_px).items()}


def sheet(own: OwnHand, film: FilmView, held: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8: pictures of the film, held-out ones if there are any, each with the avatar in the hand's place;
    new poses in the film's light; what was seen. held: (F,) bool"""
    which = np.flatnonzero(held) if held.any() else np.arange(len(held))
    which = which[np.linspace(0, len(which) - 1, min(SHEET_PICTURES, len(which))).round().astype(int)]
    shown, cells = film.part(which), []
    for rgba, joints_m, picture in zip(drawn_before(own, shown), shown.joints_m, shown.pictures, strict=True):
        x, y = _around(joints_m, film.camera)
        cells += [Cell("film", picture[y, x]), Cell("avatar", flatten(rgba, SHEET_GROUND)[y, x])]
    avatar = own.avatar.for_hand(Handedness.RIGHT)
    light = SceneLight(own.world)
    for pose in SHEET_POSES:
        cells += [Cell(f"{pose}, {side}", picture) for side, picture in _sides(avatar, pose, SHEET_PX, light).items()]
    cells += [Cell(label, picture) for label, picture in seen_map(own).items()]
    return contact_sheet(cells, SheetStyle(columns=4, cell_px=SHEET_PX))


def write_report(
    folder: Path, own: OwnHand, film: FilmView, held: np.ndarray, numbers: np.ndarray
) -> dict[str, object]:
    """Writes sheet.png and report.json into a folder, and returns what the latter holds. held: (F,) bool, pictures of
    the film that the skin was not made of · numbers: (F,) which of the pictures that were kept of it they are"""
    each = scores(own, film.part(held)) if held.any() else []
    mean = {name: float(np.mean([one[name] for one in each])) for name in (each[0] if each else ())}
    # skin that deep Gaussians hold is never seen
    shown = own.avatar.opacity * np.square(own.avatar.sigma_m)
    report: dict[str, object] = {
        "format": 1,
        "pictures": len(held),
        "held_out": numbers[held].tolist(),
        "seen_part": float((shown * believed(own.seen)).sum() / shown.sum()),
        "mean": mean,
        "each": each,
    }
    write_png(folder / "sheet.png", sheet(own, film, held))
    write_file(folder / "report.json", json.dumps(report, indent=1))
    return report


def _sides(avatar: HandAvatar, pose: str, edge_px: int, light: SceneLight | None = None) -> dict[str, np.ndarray]:
    """The palm and the back of a right hand in a named pose, (edge_px, edge_px, 3) uint8: it turns, as it did in the
    film, and camera and light stay. light: None: it shines with its own colors"""
    palm_m = named_pose(pose, avatar.rest_joints_m, handedness=Handedness.RIGHT, fist=avatar.fist)
    renderer, pictures = SceneRenderer([avatar], preset("final"), light), {}
    for side, view, joints_m in (("palm", "front", palm_m), ("back", "back", palm_m * (-1.0, 1.0, -1.0))):
        camera = framing_camera(joints_m[None], Handedness.RIGHT, view, width=edge_px, height=edge_px)
        rgba = renderer.render([joints_m], camera).rgba
        pictures[side] = flatten(rgba if light is None else displayed(rgba), SHEET_GROUND)
    return pictures


def _around(joints_m: np.ndarray, camera: Camera) -> tuple[slice, slice]:
    """Columns and rows of the square around a hand, as far as the picture goes."""
    at, _ = camera.project(joints_m)
    half = 0.65 * np.ptp(at, axis=0).max()
    low = np.clip((at.max(0) + at.min(0)) / 2 - half, 0, (camera.width - 1, camera.height - 1)).astype(int)
    high = np.clip(low + 2 * half, low + 1, (camera.width, camera.height)).astype(int)
    return slice(low[0], high[0]), slice(low[1], high[1])
