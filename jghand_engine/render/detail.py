"""Detail on drawn Gaussians, by the compiled kernel (native/detail.cpp): the texture of each hand's skin, found at each
pixel, multiplies the color there, and so does what its relief makes of the light. Before that light of lamps that was
drawn apart is added as far as it reaches the surface there (native/pixel_shadow.h).

The surface is skinned as Gaussians are, with correctives of its own, and of several hands the nearest counts. A pixel
gets the level of the texture whose texels are as large as it is, and a mean of two levels between. Detail fades out
where the Gaussians lie elsewhere than the surface: where something else is in front of it; and at the outline, unless
the surface is the skin's: then the hand ends with it, and alpha becomes the part of a pixel that it covers.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.blocks import Blocks, padded_rows, set_pointers
from jghand_engine.avatar.cast_task import posed_joints_m
from jghand_engine.avatar.detail import LOG_RATIO_MAX, RATIO_STEPS, Detail
from jghand_engine.avatar.detail_correctives import NUMBERS, angle_numbers
from jghand_engine.avatar.detail_mips import STEPS_PER_BYTE
from jghand_engine.avatar.end_cap import EndCap
from jghand_engine.avatar.posing import LightAround, Poser
from jghand_engine.avatar.relief import Bend, finger_shares
from jghand_engine.avatar.scene_light_step import NO_DEPTH
from jghand_engine.avatar.skin_task import BLEND_DET_MIN, surface_task
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import JOINT_COUNT, Handedness
from jghand_engine.hand.skeleton import Bones
from jghand_engine.native import contract
from jghand_engine.native.binding import Library, address, aligned_zeros, new_team
from jghand_engine.native.detail_task import FACE_BOUNDS, FACE_VECTORS, TEXEL_BITS, DetailHand, DetailTask
from jghand_engine.native.learned_tasks import CorrectiveKind
from jghand_engine.native.rasterizer import SURFACE_MARGIN_PX, SeenSurface
from jghand_engine.native.scene_light_task import LampDepth
from jghand_engine.native.tasks import LANES
from jghand_engine.native.threads import WorkerPool, shared_pool
from jghand_engine.render.camera import Camera
from jghand_engine.render.fine_faces import AROUND_SIDE, FineFaces, opposite_vertices

# Gaussians that lie apart from the depth that the surface gives them belong to something else: how far apart, meters on
# the canonical hand, detail begins to fade, and is gone
FADE_FROM_M, FADE_TO_M = 0.002, 0.004
# ... times the inverse cosine of the angle at which the surface is seen, up to this: on flanks Gaussians lie deeper
# along the ray, and a palm seen nearly along its skin had no detail
GRAZE_MAX = 4.0
# alpha between which it fades in: the last pixel of an outline that the surface does not end is that of the Gaussians
ALPHA_FROM, ALPHA_TO = 0.5, 0.9
# of a finger: a side of a face cuts off its square over eight of these
FINGER_RADIUS_M = 0.008
# values of a byte
BYTES = 256
# log2 of a ratio over the range of a channel of a packed texel
_LOG2_PER_CHANNEL = LOG_RATIO_MAX / RATIO_STEPS / STEPS_PER_BYTE / np.log(2.0) * (1 << TEXEL_BITS)


@dataclass(frozen=True)
class DetailedHand:
    """detail: of an avatar · power: of its ratios, see `detail_power` · joints_m: (21, 3) canonical, meters · weights:
    (V, maps) of all maps that move its surface · light: around its vertices, where it has a relief that light falls
    on · rest: (21, NUMBERS) `angle_numbers` of the canonical hand, where it has correctives · cap: what closes its end,
    if something does"""

    detail: Detail
    power: float
    joints_m: np.ndarray
    handedness: Handedness
    weights: np.ndarray
    light: LightAround | None = None
    rest: np.ndarray | None = None
    cap: EndCap | None = None

    @classmethod
    def of(cls, avatar: HandAvatar, power: float, poser: Poser | None = None) -> DetailedHand:
        """poser: of the avatar, in whose light a relief is drawn"""
        detail = avatar.detail
        if detail is None:
            raise InputError("detail of a hand", wanted="an avatar with one", came=avatar.info.name)
        weights = avatar.map_weights(detail.position_m, detail.bone_weights)
        light = None if poser is None or detail.relief is None else poser.light_around(detail.position_m)
        rest = None if detail.correctives is None else angle_numbers(avatar.canonical_angles_rad)
        return cls(detail, power, avatar.canonical_joints_m, avatar.handedness, weights, light, rest, avatar.cap)

    def posed_m(self, bones: Bones) -> np.ndarray:
        """(V, 3) where a pose has the vertices, meters: as the kernel moves them, in float64."""
        maps = np.einsum("vb,bij->vij", self.weights, bones.linear_offset)
        linear, rest_m = maps[..., :3], self.detail.position_m - self.joints_m[0]
        posed_m = np.einsum("vij,vj->vi", linear, rest_m) + maps[..., 3] + bones.root_m
        if self.detail.correctives is not None and self.rest is not None:
            linear_1 = linear / max(bones.scale, float(np.finfo(np.float32).tiny))
            size = np.cbrt(np.maximum(np.abs(np.linalg.det(linear_1)), BLEND_DET_MIN))
            changes = angle_numbers(bones.angles_rad) - self.rest
            offset_m = self.detail.correctives.offset_m(self.detail.bone_weights, changes)
            posed_m += np.einsum("vij,vj->vi", linear / size[:, None, None], offset_m)
        return posed_m


class NativeDetail:
    """Draws the detail of hands. Buffers are allocated once; one image at a time."""

    def __init__(self, library: Library, hands: Sequence[DetailedHand], *, outline_px: float = math.inf) -> None:
        """outline_px: how far corners of outlines may be from round ones before faces are made finer"""
        self._outline_px = outline_px
        self._call, self._hands = library.call, [_Hand(hand) for hand in hands]
        self._tasks = (DetailHand * len(hands))(*(hand.task for hand in self._hands))
        self._task = DetailTask(
            hands=ctypes.addressof(self._tasks),
            hand_count=len(hands),
            z_near=contract.Z_NEAR_M,
            alpha_from=ALPHA_FROM,
            alpha_to=ALPHA_TO,
            graze_max=GRAZE_MAX,
        )
        self.team = new_team()
        # what the task points to
        self._keep: np.ndarray | None = None
        # of the image: nearest faces, and how near
        self._hit, self._near = np.empty((0, 0), np.int32), np.empty((0, 0), np.float32)
        self._faces: np.ndarray | None = None  # that `surfaces` finds on the way
        self._lit: list[object] = []

    def pose(self, bones: Sequence[Bones], shifts_m: Sequence[np.ndarray]) -> None:
        """Sets the next pose; shifts_m: (3,) of each hand's root from the origin of the positions, meters."""
        for hand, task, own, shift_m in zip(self._hands, self._tasks, bones, shifts_m, strict=True):
            hand.pose(own, shift_m)
            task.depth, task.fade_from, task.fade_to = (
                own.scale * length_m for length_m in (hand.depth_m, FADE_FROM_M, FADE_TO_M)
            )
            hand.rise_m, hand.scale = own.scale * hand.range_m, own.scale

    def prepare(
        self,
        planes: np.ndarray | None,
        camera: Camera,
        strengths: Sequence[float],
        *,
        ends_hands: bool = False,
        seen: Sequence[bool] | None = None,
        from_within: bool = False,
    ) -> None:
        """Sets the next image, (5, H, W) as the rasterizer leaves it, which is changed in place; None to ask for the
        nearest faces alone.
        strengths: 0..1 per hand · ends_hands: whether nothing is drawn that is not on one of the surfaces · seen: per
        hand whether it can be in the image; None: all · from_within: whether faces are drawn from both sides"""
        task, self._keep = self._task, planes
        shape = (5, camera.height, camera.width)
        task.picture = None if planes is None else address(planes, np.float32, "planes", shape, writable=True)
        if planes is not None:
            self._keep_hits(camera)
        task.width, task.height, task.orthographic = camera.width, camera.height, camera.orthographic
        task.fx, task.fy, task.cx, task.cy = camera.fx, camera.fy, camera.cx, camera.cy
        task.camera_from_position[:] = camera.camera_from_world[:3].ravel().tolist()
        in_image = [True] * len(strengths) if seen is None else seen
        least = min((strength for strength, is_seen in zip(strengths, in_image, strict=True) if is_seen), default=0.0)
        task.outline = least if ends_hands else 0.0
        for hand, own, strength, is_seen in zip(self._hands, self._tasks, strengths, in_image, strict=True):
            own.strength, own.exponent = strength, hand.power * _LOG2_PER_CHANNEL
            own.facing = 0.0 if from_within else hand.facing
            # one that only hides others needs no light
            own.rise = hand.rise_m if strength > 0 else 0.0
            hand.set_faces(own, fine=is_seen and task.outline > 0 and hand.corner_px(camera) > self._outline_px)
            own.groups *= is_seen
            own.cap = hand.cap_seen(camera.eye_m)
        task.layers, self._lit = 0, []
        self.team.fill(0)

    def _keep_hits(self, camera: Camera) -> None:
        shape, margin = (camera.height, camera.width), SURFACE_MARGIN_PX
        if self._hit.shape != shape:
            self._hit, self._near = np.empty((0, 0), np.int32), np.empty((0, 0), np.float32)
            near = np.full([length + 2 * margin for length in shape], contract.NOT_NEAR, np.float32)
            self._hit, self._near = np.empty(shape, np.int32), near
        self._set_hits(self._hit, self._near[margin:-margin, margin:-margin])

    def _set_hits(self, face: np.ndarray, near: np.ndarray) -> None:
        task = self._task
        task.hit, task.hit_near, task.near_stride = face.ctypes.data, near.ctypes.data, near.strides[0] // near.itemsize

    @property
    def seen_surface(self) -> SeenSurface | None:
        """That of the image that was prepared, once `find_surface` ran; None where hands do not end with it. Of hands
        of several scales it has the largest: with a smaller one, Gaussians of the large hand would not be its own."""
        seen = [hand.scale for hand, task in zip(self._hands, self._tasks, strict=True) if task.groups > 0]
        return SeenSurface(self._near, max(seen), self._task.outline) if self._task.outline > 0 and seen else None

    def shadow_pixels(self, layers: np.ndarray, lamps: Sequence[Mapping[int, LampDepth]]) -> None:
        """Sets which light is added to the image that was prepared as far as it reaches each pixel.
        layers: (L, 4, H, W), see native/detail_surface.h · lamps: per hand their pictures, which say what their layers
        are"""
        self._task.layers = len(layers)
        pointers = (ctypes.c_void_p * len(layers))(*(layer.ctypes.data for layer in layers))
        self._task.layer, self._lit = ctypes.addressof(pointers), [layers, pointers]
        for task, own in zip(self._tasks, lamps, strict=True):
            of_layer = {depth.layer: depth for depth in own.values()}
            pictures = (LampDepth * len(layers))(*(of_layer.get(place, NO_DEPTH) for place in range(len(layers))))
            task.pictures = ctypes.addressof(pictures)
            self._lit.append(pictures)

    def hits(self, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
        """Of the pose that stands and one hand: see `SurfaceHits`. The camera is of the origin of the positions."""
        shape = (camera.height, camera.width)
        row, near = np.empty(shape, np.int32), np.empty(shape, np.float32)
        self._nearest(camera, shared_pool(0), row, near)
        face = np.where(row < 0, -1, self._hands[0].face_of_row[row])
        with np.errstate(divide="ignore"):
            depth_m = -near if camera.orthographic else 1 / near
        return face, np.where(row < 0, np.float32(np.inf), depth_m)

    def surfaces(self, camera: Camera, hand: int, pool: WorkerPool, near: np.ndarray) -> np.ndarray:
        """Of the pose that stands: fills near (H, W) float32 with how near the nearest surface is, from within, too,
        1/z or, of parallel rays, -z, and where nothing is, below all; returns (3, rows) x, y and near of the vertices
        of one hand, until the next image. The camera is of the origin of the positions."""
        if self._faces is None or self._faces.shape != near.shape:
            self._faces = np.empty(near.shape, np.int32)
        self._nearest(camera, pool, self._faces, near, from_within=True)
        return self._hands[hand].vertices

    def rest(self) -> None:
        """Lets go of the last image."""
        self._keep, self._faces, self._lit = None, None, []
        self._hit, self._near = np.empty((0, 0), np.int32), np.empty((0, 0), np.float32)

    def rows_of_vertices(self, hand: int) -> np.ndarray:
        """(V,) in which row of `surfaces` each vertex of a hand stands."""
        return self._hands[hand].row_of_vertex

    def _nearest(
        self, camera: Camera, pool: WorkerPool, face: np.ndarray, near: np.ndarray, *, from_within: bool = False
    ) -> None:
        """Fills face (H, W) int32 with numbers of the nearest faces and those of their hands, -1 where there are none,
        and near (H, W) float32 with how near they are."""
        self.prepare(None, camera, [0.0] * len(self._hands), from_within=from_within)
        self._set_hits(face, near)
        pool.run(lambda _thread: self.find_surface())

    def find_surface(self) -> None:
        """Finds the nearest faces of what was prepared; every thread of a team calls it."""
        self._call.jg_detail_surface(self.team.ctypes.data, ctypes.addressof(self._task))

    def run(self) -> None:
        """Then draws; every thread of a team calls it."""
        self._call.jg_detail(self.team.ctypes.data, ctypes.addressof(self._task))


class SurfaceHits:
    """Where the surface of one hand is in an image, for learning its texture."""

    def __init__(self, library: Library, hand: DetailedHand) -> None:
        self._drawn = NativeDetail(library, [hand])

    def __call__(self, bones: Bones, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
        """(H, W) int32 number of the nearest face, -1 where there is none; (H, W) float32 depth along the camera's
        axis, meters, infinite there."""
        self._drawn.pose([bones], [np.zeros(3)])
        return self._drawn.hits(camera.about(bones.root_m))


class _Faces:
    """What the task of a hand has of its faces. blocks: in which neighbors stand together; a group is filled up with
    faces without area · rows: (V,) of the vertices"""

    def __init__(
        self, blocks: Blocks, faces: np.ndarray, face_uv: np.ndarray, rows: np.ndarray, *, ends_hand: bool
    ) -> None:
        self.of_row, self.groups = blocks.in_rows(np.arange(len(faces)), np.int32), blocks.count
        texture_xy = np.stack([face_uv[..., 0], 1 - face_uv[..., 1]], -1)

        def in_groups(vertex: np.ndarray) -> np.ndarray:
            of_faces = blocks.in_rows(rows[vertex], np.int32).reshape(blocks.count, LANES, 3)
            return np.ascontiguousarray(of_faces.swapaxes(1, 2))

        self.arrays = {
            "corner": in_groups(faces),
            "opposite": in_groups(opposite_vertices(faces) if ends_hand else faces),
            "corner_uv": blocks.blocked(texture_xy.reshape(-1, 6)),
            "planes": aligned_zeros((self.groups * LANES, FACE_VECTORS, LANES)),
            "bounds": aligned_zeros((self.groups, FACE_BOUNDS, LANES), np.int32),
            "box": aligned_zeros((4, padded_rows(self.groups)), np.int32),
            "wide_box": aligned_zeros((4, padded_rows(padded_rows(self.groups) // LANES)), np.int32),
        }
        # what is beyond the last group touches nothing
        for name in ("box", "wide_box"):
            self.arrays[name][::2], self.arrays[name][1::2] = np.iinfo(np.int32).max, -1


class _Hand:
    """One hand's arrays, and the task that points to them."""

    def __init__(self, hand: DetailedHand) -> None:
        detail, self.power, self.depth_m = hand.detail, hand.power, hand.detail.depth_m
        blocks = Blocks.of(detail.position_m)
        relative = detail.position_m.astype(np.float64) - hand.joints_m[0]
        self._skin_arrays = {"rest": blocks.blocked(np.pad(relative, ((0, 0), (0, 1))))}
        self._skin_arrays |= blocks.bones(hand.weights)
        self._surface = surface_task(blocks)
        self._skin = self._surface.skin
        set_pointers(self._skin, self._skin_arrays)
        self._numbers, self._correctives = aligned_zeros((hand.weights.shape[1], NUMBERS)), {}
        self._rest = hand.rest
        if detail.correctives is not None and hand.rest is not None:
            self._correctives = detail.correctives.arrays(blocks) | {"numbers": self._numbers}
            self._surface.correctives, self._surface.basis = CorrectiveKind.LINEAR, NUMBERS
            set_pointers(self._surface, self._correctives)
        self._detail, self.row_of_vertex = detail, np.argsort(blocks.order)
        self._face_blocks = Blocks.of(detail.position_m[detail.faces].mean(1))
        self._coarse = _Faces(
            self._face_blocks, detail.faces, detail.face_uv, self.row_of_vertex, ends_hand=detail.ends_hand
        )
        self._fine: _Faces | None = None
        side_m = np.linalg.norm(np.diff(detail.position_m[detail.faces[:, :2]], axis=1), axis=-1)
        self._side_m = float(np.median(side_m)) if side_m.size else 0.0
        slopes = None if hand.light is None else detail.slopes
        self._arrays = {
            "vertex": aligned_zeros((3, blocks.rows)),
            "whole": blocks.in_rows(detail.shown),
            "normal": blocks.blocked(detail.normals),
            "turned": aligned_zeros((3, blocks.rows)),
            "texels": np.ascontiguousarray(detail.mips.texels) if slopes is None else detail.texels,
        }
        # a face seen from outside turns left; on the image, whose rows go down, its area is negative
        self.facing = -1.0 if hand.handedness is Handedness.RIGHT else 1.0
        self.task = DetailHand(
            surface=ctypes.addressof(self._surface),
            size_log2=detail.size.bit_length() - 1,
        )
        self.range_m, self.rise_m, self.scale, self._bend = 0.0, 0.0, 1.0, None
        if hand.light is not None and slopes is not None:
            self.range_m = slopes.step_m * BYTES
            self._bend = Bend(detail.position_m, finger_shares(detail.bone_weights), hand.joints_m)
            # keeps what the task points to
            self._light = hand.light
            self._joints_m = hand.joints_m - hand.joints_m[0]
            self._near = np.ascontiguousarray(blocks.in_rows(self._bend.near).T)
            self._arrays |= {
                "nearest": blocks.blocked(hand.light.nearest, np.int32),
                "beside": blocks.blocked(hand.light.beside, np.int32),
                "share": blocks.blocked(hand.light.share),
                "bend": aligned_zeros((blocks.rows,)),
                "slope": aligned_zeros((4, blocks.rows)),
                "gloss": aligned_zeros((5, blocks.rows)),
            }
            self.task.learned = ctypes.addressof(hand.light.task)
        set_pointers(self.task, self._arrays)
        self.set_faces(self.task, fine=False)
        self._linear_offset: np.ndarray | None = None
        self._maps = hand.weights.shape[1]
        self._cap = hand.cap

    @property
    def face_of_row(self) -> np.ndarray:
        """(rows,) numbers of its own faces, as hits tell them."""
        return self._coarse.of_row

    @property
    def vertices(self) -> np.ndarray:
        """(3, rows) x, y, px, and near of its own vertices in the last image, of coarse faces."""
        rows = padded_rows(len(self.row_of_vertex))
        return self._arrays["vertex"].ravel()[: 3 * rows].reshape(3, rows)

    def corner_px(self, camera: Camera) -> float:
        """How far the sides of faces are from a round outline, at the depth of its wrist; infinite where that is behind
        the camera."""
        depth_m = 1.0 if camera.orthographic else camera.camera_from_world[2] @ (*self._skin.shift, 1.0)
        corner_m = self._skin.scale * self._side_m**2 / (8 * FINGER_RADIUS_M)
        return corner_m * max(camera.fx, camera.fy) / depth_m if depth_m > 0 else math.inf

    def cap_seen(self, eye_m: np.ndarray) -> float:
        """0..1, how much of its cap is shown to an eye at (3,)."""
        if self._cap is None or self._linear_offset is None:
            return 0.0
        return self._cap.seen(self._linear_offset, np.array(self._skin.shift), eye_m)

    def set_faces(self, task: DetailHand, *, fine: bool) -> None:
        """Which faces are drawn next. task: the hand's, or a copy of it"""
        if fine and self._fine is None:
            self._fine = self._parted()
            set_pointers(task, self._arrays)
        faces = self._fine if fine and self._fine is not None else self._coarse
        task.groups, task.side_blocks = faces.groups, len(self._arrays["around"]) if fine else 0
        set_pointers(task, faces.arrays)

    def _parted(self) -> _Faces:
        """Makes room for the vertices in the middles of sides; returns the faces between them."""
        detail, parted = self._detail, FineFaces.of(self._detail.faces, self._detail.face_uv, len(self.row_of_vertex))
        rows = padded_rows(len(self.row_of_vertex))
        # beside those of their first ends
        sides = Blocks(np.argsort(self.row_of_vertex[parted.around[:, 0]]))
        in_sides = (sides.count, LANES, AROUND_SIDE)
        around = sides.in_rows(self.row_of_vertex[parted.around], np.int32).reshape(in_sides)
        for name in self._arrays.keys() & {"vertex", "whole", "turned", "bend", "slope", "gloss"}:
            before = self._arrays[name]
            self._arrays[name] = aligned_zeros((*before.shape[:-1], rows + sides.rows))
            self._arrays[name][..., :rows] = before
        self._arrays["whole"][rows:] = sides.in_rows(detail.shown[parted.around[:, :2]].mean(1))
        self._arrays["around"] = np.ascontiguousarray(around.swapaxes(1, 2))
        self._arrays["side_share"] = np.ascontiguousarray(sides.in_rows(parted.share).reshape(in_sides).swapaxes(1, 2))
        row_of = np.concatenate([self.row_of_vertex, rows + np.argsort(sides.order)])
        parts = Blocks((4 * self._face_blocks.order[:, None] + np.arange(4)).ravel())
        return _Faces(parts, parted.faces, parted.face_uv, row_of, ends_hand=True)

    def pose(self, bones: Bones, shift_m: np.ndarray) -> None:
        self._linear_offset = np.ascontiguousarray(bones.linear_offset, np.float32)
        self._skin.linear_offset = address(self._linear_offset, np.float32, "linear_offset", (self._maps, 3, 4))
        # the inverse of a hand without size is finite, as the Gaussians' is
        inverse_scale = 1.0 / max(bones.scale, float(np.finfo(np.float32).tiny))
        self._skin.shift, self._skin.scale, self._skin.inverse_scale = tuple(shift_m), bones.scale, inverse_scale
        if self._rest is not None:
            self._numbers[:JOINT_COUNT] = angle_numbers(bones.angles_rad) - self._rest
        if self._bend is not None:
            joints_m = posed_joints_m(bones.linear_offset, self._joints_m)
            bent = self._bend.of_joints(joints_m[None])[0].astype(np.float32)
            np.matmul(bent, self._near, out=self._arrays["bend"][: self._near.shape[1]])
