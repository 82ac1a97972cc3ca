"""Pictures of a hand for tests that only care that there are some: discs around the projected joints."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image
from small_hands import joints_of

from jghand_engine.captures.sample import Sample
from jghand_engine.hand.joints import Handedness
from jghand_engine.render.camera import Camera

EYES_M = {"front": (0.1, 0.1, 0.5), "side": (0.45, 0.15, 0.2), "back": (-0.1, 0.2, -0.5)}
MIDDLE_M = (0.0, 0.09, 0.0)


def camera_at(eye_m=EYES_M["front"], *, size: tuple[int, int] = (48, 40), focal_px: float = 90.0) -> Camera:
    """Looks at the middle of the built-in hand."""
    return Camera.looking_at(eye_m, MIDDLE_M, (0.1, 1.0, 0.0), width=size[0], height=size[1], focal_px=focal_px)


def write_rgba(path: Path, mask: np.ndarray, seed: int = 0) -> Path:
    """A picture of noisy skin with the alpha of `mask` (H, W) uint8."""
    path.parent.mkdir(parents=True, exist_ok=True)
    noise = np.random.default_rng(seed).integers(-30, 31, (*mask.shape, 3))
    rgb = (np.array([210, 160, 130]) + noise).astype(np.uint8)
    Image.fromarray(np.concatenate([rgb, mask[..., None]], -1)).save(path)
    return path


def discs(camera: Camera, joints_m: np.ndarray, radius_px: float = 3.0) -> np.ndarray:
    """(H, W) uint8: 255 near the projected joints."""
    pixels, _ = camera.project(joints_m)
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    away = np.hypot(columns[..., None] - pixels[:, 0], rows[..., None] - pixels[:, 1])
    return np.where(away.min(-1) < radius_px, 255, 0).astype(np.uint8)


def sample_of(picture: Path, camera: Camera, joints_m: np.ndarray, *, frame: int = 0, name: str = "front") -> Sample:
    """The record of a picture whose mask is its alpha; a right hand."""
    return Sample(
        image=picture,
        camera=camera,
        joints_m=joints_m,
        handedness=Handedness.RIGHT,
        capture="painted",
        sequence="poses",
        frame=frame,
        camera_name=name,
    )


def painted_samples(folder: Path, poses: tuple[str, ...] = ("open", "fist", "claw")) -> list[Sample]:
    """Every pose from every eye."""
    samples = []
    for frame, pose in enumerate(poses):
        for name, eye_m in EYES_M.items():
            camera, joints_m = camera_at(eye_m), joints_of(pose)
            picture = write_rgba(folder / f"{frame}_{name}.png", discs(camera, joints_m), seed=len(samples))
            samples.append(sample_of(picture, camera, joints_m, frame=frame, name=name))
    return samples


def mirrored(sample: Sample, folder: Path) -> Sample:
    """The same in a mirror (x of the world negated): a left hand, its picture turned over, its camera on the other
    side."""
    flip = np.diag([-1.0, 1.0, 1.0, 1.0])
    camera = sample.camera
    pixels = np.asarray(Image.open(sample.image))[:, ::-1]
    folder.mkdir(parents=True, exist_ok=True)
    picture = folder / sample.image.name
    Image.fromarray(np.ascontiguousarray(pixels)).save(picture)
    return replace(
        sample,
        image=picture,
        camera=replace(camera, cx=camera.width - camera.cx, camera_from_world=flip @ camera.camera_from_world @ flip),
        joints_m=sample.joints_m * np.array([-1.0, 1.0, 1.0]),
        handedness=Handedness.LEFT,
    )
