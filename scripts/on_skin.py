"""A hand's Gaussians below its person's skin, in every pose.

Pictures of half a millimeter per pixel leave a bent knuckle thinner by one than it is. And a person's forearm keeps
still while the palm, which carries it in a pose of 21 joints, arches: what learned from pictures without knowing that
has it up to a centimeter off, in few Gaussians deep inside, most of which were never seen. Of a person whose skin is
computed its place is known in every pose, and its color.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from other_person import Somebody
from torch.nn import functional

from jghand_engine.avatar.avatar import FOREARM_WAY, HandAvatar
from jghand_engine.avatar.learned import Anchors, SkinResponse
from jghand_engine.avatar.posing import Posing
from jghand_engine.avatar.relighting import thrown_back
from jghand_engine.avatar.skin_task import BLEND_DET_MIN
from jghand_engine.captures.making.poses import varied_poses
from jghand_engine.captures.making.rig import RiggedHand
from jghand_engine.captures.skin.color import RGB_LIMITS
from jghand_engine.captures.skin.surface import SkinSurface
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.learn.cast_shadow import place_anchors
from jghand_engine.learn.pose_features import Angles
from jghand_engine.learn.pose_net import PoseNet
from jghand_engine.learn.tier_prices import pose_net_of
from jghand_engine.template.closest import ClosestPoints, Surface
from jghand_engine.template.texture import sample_bilinear

# poses that the network learns, and with which seed: none of a capture's
POSES, SEED = 160, 2
# the mesh on which Gaussians lie
LEVELS = 1
# behind the wrist, meters, from the first on, Gaussians are put on the skin more and more, from the second on wholly
# and as deep as those of the hand; before it they move along the skin's normal alone, as they have the colors of where
# they lie
FROM_M, TO_M = 0.0, 0.02
# apart from its usual depth by less than this a Gaussian stays: it has learned its color and its shade there
SLACK_M = 0.0005
# steps of Gaussians by chance in a pose by chance; rate at the first and the last
STEPS, AT_ONCE, RATES = 4000, 4000, (2e-3, 1e-5)
# residual from which on it counts by its length alone, mm: skin that the network cannot follow does not spoil the rest
ROBUST_MM = 0.3
# of the shade, which stays what it was, against square millimeters
SHADE_WEIGHT = 20.0


@dataclass(frozen=True)
class _Poses:
    """offset_m: (P, N, 3) that Gaussians are to get in canonical axes · angles_rad: (P, 37)"""

    offset_m: torch.Tensor
    angles_rad: torch.Tensor


def on_skin(avatar: HandAvatar, one: Somebody) -> HandAvatar:
    """The avatar with its network and its places such that Gaussians are in all poses as deep below a person's skin,
    whose joints it has, as they are on the whole; those of the forearm look as the person's maps say. Cheaper tiers are
    left out; `uvd` stays where Gaussians began, for the network knows them by it. InputError for an avatar without a
    network, or one that did not learn in known light.
    """
    learned, network = avatar.learned, pose_net_of(avatar)
    if learned is None or learned.response is None:
        raise InputError(f"avatar {avatar.info.name}", wanted="one that learned in known light", came="another")
    home = _Home.of(avatar, one)
    bone_weights, uvd = torch.from_numpy(avatar.bone_weights), torch.from_numpy(avatar.uvd)
    before, net = (PoseNet.of(network, bone_weights, uvd) for _ in range(2))
    poses, on_arm = _wanted(avatar, one, home, before), torch.from_numpy(home.on_arm[:, None])
    net.requires_grad_(True)
    constant_m = _constant(net, poses)
    optimizer = torch.optim.Adam(net.parameters(), lr=RATES[0])
    rate = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, STEPS, RATES[1])
    chance = torch.Generator().manual_seed(SEED)
    for step in range(STEPS):
        rows = torch.randint(len(avatar), (AT_ONCE,), generator=chance)
        pose = int(torch.randint(len(poses.offset_m), (), generator=chance))
        angles = Angles.of(poses.angles_rad[pose])
        found = net.part(rows)(angles)
        with torch.no_grad():
            shade = (1 - on_arm[rows]) * before.part(rows)(angles).shade
        apart_mm = 1e3 * (found.offset_m + constant_m[rows] - poses.offset_m[pose, rows])
        loss = functional.smooth_l1_loss(apart_mm, torch.zeros_like(apart_mm), beta=ROBUST_MM)
        loss = loss + SHADE_WEIGHT * (found.shade - shade).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        rate.step()
        if step % (STEPS // 4) == STEPS // 4 - 1:
            constant_m = _constant(net, poses)
    learned = replace(learned, correctives=net.plain(), distilled=None)
    moved = replace(avatar, position_m=avatar.position_m + constant_m.numpy(), learned=learned)
    return home.painted(with_anchors(moved), one)


def with_anchors(avatar: HandAvatar) -> HandAvatar:
    """The avatar with its shadows found where its Gaussians are now."""
    learned = avatar.learned
    if learned is None or learned.cast is None:
        return avatar
    position_m, normal, weights = map(torch.from_numpy, (avatar.position_m, learned.normal, avatar.bone_weights))
    placed = place_anchors(position_m, normal, weights, len(learned.cast.anchors))
    anchors = Anchors(**{name: tensor.numpy() for name, tensor in vars(placed).items()})
    return replace(avatar, learned=learned.with_anchors(anchors, avatar.canonical_joints_m))


@dataclass(frozen=True)
class _Home:
    """Where Gaussians are in the hand at rest.

    surface: of the person · skin: (F, 3) its faces · near: places on them · normal: (N, 3) there
    on_arm: (N,) 0..1, how much of a Gaussian is the forearm's
    """

    surface: SkinSurface
    skin: np.ndarray
    near: ClosestPoints
    normal: np.ndarray
    on_arm: np.ndarray

    @classmethod
    def of(cls, avatar: HandAvatar, one: Somebody) -> _Home:
        surface, joints_m = SkinSurface(one.identity, LEVELS, one.maps), one.identity.joints_m
        skin = surface.faces[: one.identity.skin_face_count * 4**LEVELS]
        resting = Surface(surface.posed(one.identity.vertices_m, surface.bent(joints_m[None])[0]), skin)
        near = resting.closest(Posing(avatar.for_hand(Handedness.RIGHT))(joints_m).position_m.astype(np.float64))
        behind_m = (avatar.position_m - avatar.canonical_joints_m[0]) @ FOREARM_WAY
        part = np.clip((behind_m - FROM_M) / (TO_M - FROM_M), 0, 1)
        on_arm = (part * part * (3 - 2 * part)).astype(np.float32)
        return cls(surface, skin, near, resting.normals(near.face, near.barycentric), on_arm)

    def painted(self, avatar: HandAvatar, one: Somebody) -> HandAvatar:
        """The avatar with the forearm's color from a person's maps, by how it answers light like the hand."""
        learned, arm = avatar.learned, self.on_arm[:, None]
        assert learned is not None
        assert learned.response is not None
        uv = np.einsum("nk,nkc->nc", self.near.barycentric, self.surface.face_uv[self.near.face])
        albedo = sample_bilinear(one.blurred(one.maps.rgb), uv)
        on_hand = self.on_arm == 0
        albedo = (albedo * np.median(avatar.rgb[on_hand] / albedo[on_hand], 0)).clip(*RGB_LIMITS)
        normal = (1 - arm) * learned.normal + arm * self.normal
        normal = (normal / np.linalg.norm(normal, axis=1, keepdims=True)).astype(np.float32)
        rows = {name: getattr(learned.response, name) for name in SkinResponse.ROWS}
        usual = {name: row + self.on_arm * (np.median(row[on_hand]) - row) for name, row in rows.items()}
        rgb = ((1 - arm) * avatar.rgb + arm * albedo).astype(np.float32)
        response = replace(learned.response, bounce=thrown_back(avatar, rgb), **usual)
        return replace(avatar, rgb=rgb, learned=replace(learned, normal=normal, response=response))


def _constant(net: PoseNet, poses: _Poses) -> torch.Tensor:
    """(N, 3) meters: what the network lacks on the mean."""
    with torch.no_grad():
        pairs = zip(poses.offset_m, poses.angles_rad, strict=True)
        return torch.stack([offset_m - net(Angles.of(angles)).offset_m for offset_m, angles in pairs]).mean(0)


def _wanted(avatar: HandAvatar, one: Somebody, home: _Home, net: PoseNet) -> _Poses:
    hand, right = RiggedHand(one.identity), avatar.for_hand(Handedness.RIGHT)
    posed = hand.pose(varied_poses(hand, POSES, SEED).angles_deg)
    surface, near, posing, skeleton = home.surface, home.near, Posing(right), right.skeleton()
    weights = avatar.map_weights(avatar.position_m, avatar.bone_weights).astype(np.float64)
    below_m, outwards, offsets_m, turns, angles_rad = [], [], [], [], []
    poses = zip(hand.skin(posed), posed.joints_m, surface.bent(posed.joints_m), hand.forearm(posed), strict=True)
    for vertices_m, joints_m, bent, forearm in poses:
        bones, skin_m = skeleton.bones(joints_m, np.float64, forearm=forearm), surface.posed(vertices_m, bent)
        outwards.append(Surface(skin_m, home.skin).normals(near.face, near.barycentric).astype(np.float32))
        on_skin_m = np.einsum("nk,nkc->nc", near.barycentric, skin_m[home.skin[near.face]])
        below_m.append((posing(joints_m, forearm).position_m - on_skin_m).astype(np.float32))
        maps = np.einsum("vb,bij->vij", weights, bones.linear_offset)[..., :3]
        size = np.cbrt(np.maximum(np.abs(np.linalg.det(maps)), BLEND_DET_MIN * bones.scale**3))
        turns.append((bones.scale * maps / size[:, None, None]).astype(np.float32))
        angles_rad.append(torch.from_numpy(bones.angles_rad).float())
        with torch.no_grad():
            offsets_m.append(net(Angles.of(angles_rad[-1])).offset_m.numpy())
    depth_m = np.stack([(below * normal).sum(1) for below, normal in zip(below_m, outwards, strict=True)])
    usual_m, on_arm = np.median(depth_m, 0), home.on_arm
    usual_m += on_arm * (np.median(usual_m[on_arm == 0]) - usual_m)
    for k, (below, normal, turn) in enumerate(zip(below_m, outwards, turns, strict=True)):
        apart_m = usual_m - depth_m[k]
        apart_m -= (1 - on_arm) * np.clip(apart_m, -SLACK_M, SLACK_M)
        missing_m = apart_m[:, None] * normal
        missing_m -= on_arm[:, None] * (below - depth_m[k][:, None] * normal)
        offsets_m[k] = offsets_m[k] + np.linalg.solve(turn, missing_m[..., None])[..., 0]
    return _Poses(torch.from_numpy(np.stack(offsets_m)), torch.stack(angles_rad))
