"""What the tracker says of the pictures: camera, landmarks, and a first pose of each. All that follows begins here."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from jghand_engine.files import writing
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import hand_length
from jghand_engine.npz_files import read_arrays
from jghand_engine.own.film import Window
from jghand_engine.render.camera import Camera
from jghand_engine.track.costs import Trust
from jghand_engine.track.fit import fit
from jghand_engine.track.hands_over_time import HandOverTime
from jghand_engine.track.own_hand import own_canonical_joints
from jghand_engine.track.poses import Frames, JointChain, Poses
from jghand_engine.track.track import Sightings, camera_of, landmarks_of


@dataclass(frozen=True, eq=False)
class Start:
    """What the tracker says, of a right hand in every case: of a left one's mirrored pictures.

    camera:              of one picture, at the origin, OpenCV axes
    handedness:          which hand the film shows
    landmarks_px:        (F, 21, 2) where the detector saw the joints, level order; NaN where it saw no hand
    detector_directions: (F, 20, 3) unit, where it thinks that bones 1..20 point, camera axes
    poses:               turn (F, 3, 3), place_m (F, 3) and angle_rad (F, 20) as the tracker keeps them
    canonical_joints_m:  (21, 3) a canonical hand with the proportions of this one
    """

    camera: Camera
    handedness: Handedness
    landmarks_px: np.ndarray
    detector_directions: np.ndarray
    poses: Poses
    canonical_joints_m: np.ndarray

    @property
    def chain(self) -> JointChain:
        """The hand that the poses are of."""
        return JointChain.of(self.canonical_joints_m)

    @property
    def joints_m(self) -> np.ndarray:
        """(F, 21, 3) level order, camera axes, meters."""
        return self.poses.joints_m(self.chain)

    @property
    def seen(self) -> np.ndarray:
        """(F,) bool, where the detector saw the hand."""
        return np.asarray(np.isfinite(self.landmarks_px).all(axis=(1, 2)))

    def part(self, pictures: Frames) -> Start:
        """Of some of the pictures."""
        return replace(
            self,
            landmarks_px=self.landmarks_px[pictures],
            detector_directions=self.detector_directions[pictures],
            poses=self.poses.part(pictures),
        )

    def within(self, window: Window) -> Start:
        """Before the camera of pictures that were cut."""
        camera = self.camera.part(window.left, window.top, window.width, window.height)
        width, height = window.size_px
        across, down = width / window.width, height / window.height
        lens = (camera.fx * across, camera.fy * down, camera.cx * across, camera.cy * down)
        landmarks = (self.landmarks_px - (window.left, window.top)) * (across, down)
        return replace(self, camera=Camera(width, height, *lens, np.eye(4)), landmarks_px=landmarks)

    def save(self, path: Path) -> None:
        """As .npz."""
        own = {
            "handedness": np.array(str(self.handedness)),
            "landmarks_px": self.landmarks_px,
            "detector_directions": self.detector_directions,
            "canonical_joints_m": self.canonical_joints_m,
        }
        with writing(path) as temporary:
            np.savez_compressed(temporary, allow_pickle=False, **own, **packed(self.camera, self.poses))

    @classmethod
    def load(cls, path: Path) -> Start:
        """What `save` wrote. InputError for a file that is none."""
        own = ("handedness", "landmarks_px", "detector_directions", "canonical_joints_m")
        arrays = read_arrays(path, (*own, *PACKED), str(path))
        camera, poses = unpacked(arrays)
        handedness, landmarks_px, directions, canonical_joints_m = (arrays[name] for name in own)
        return cls(camera, Handedness(str(handedness)), landmarks_px, directions, poses, canonical_joints_m)


# arrays of `packed`
PACKED = ("camera", "turn", "place_m", "angle_rad")


def packed(camera: Camera, poses: Poses) -> dict[str, np.ndarray]:
    """A camera at the origin and poses before it, as arrays of a file."""
    lens = np.array([camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy])
    return {"camera": lens, **vars(poses)}


def unpacked(arrays: dict[str, np.ndarray]) -> tuple[Camera, Poses]:
    """What `packed` made arrays of."""
    width, height, fx, fy, cx, cy = arrays["camera"].tolist()
    poses = Poses(arrays["turn"], arrays["place_m"], arrays["angle_rad"])
    return Camera(int(width), int(height), fx, fy, cx, cy, np.eye(4)), poses


def start_of(
    sightings: Sightings, hand: HandOverTime, canonical_joints_m: np.ndarray, camera_angle_deg: float, is_film: bool
) -> Start:
    """What the tracker says of all pictures that were looked at.

    canonical_joints_m: (21, 3) level order, meters, of a right hand as long as this one · camera_angle_deg: across the
    longer edge · is_film: else every picture stands alone
    """
    pinhole = camera_of(sightings, camera_angle_deg)
    landmarks = landmarks_of(hand, pinhole, sightings.fps)
    own = own_canonical_joints(canonical_joints_m, landmarks, hand_length(canonical_joints_m))
    poses = fit(JointChain.of(own), landmarks, Trust(smoothing=1.0 if is_film else 0.0))
    height, width = sightings.size_px
    focal = pinhole.focal_px
    camera = Camera(width, height, focal, focal, pinhole.cx, pinhole.cy, np.eye(4))
    return Start(camera, hand.handedness, landmarks.image_px, landmarks.directions, poses, own)
