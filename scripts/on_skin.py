"""A hand's Gaussians below its person's skin, in every pose.

Pictures of half a millimeter per pixel leave a bent knuckle thinner by one than it is. And a person's forearm keeps
still while the palm, which carries it in a pose of 21 joints, arches: what learned from pictures without knowing that
has it up to a centimeter off, and a few large Gaussians deep inside. Of a person whose skin is computed its place is
known in every pose.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from other_person import Somebody
from registration import still_forearm
from scipy.spatial import KDTree
from torch.nn import functional

from jghand_engine.avatar.avatar import FOREARM_WAY, HandAvatar
from jghand_engine.avatar.posing import Posing
from jghand_engine.avatar.skin_task import BLEND_DET_MIN
from jghand_engine.captures.making.poses import varied_poses
from jghand_engine.captures.making.rig import RiggedHand
from jghand_engine.captures.skin.surface import SkinSurface
from jghand_engine.hand.joints import Handedness
from jghand_engine.learn.pose_features import Angles
from jghand_engine.learn.pose_net import PoseNet
from jghand_engine.learn.tier_prices import pose_net_of
from jghand_engine.template.closest import Surface

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
# how many Gaussians are beside one, which of them are on the outside, and by which part of how far one lies below these
# it stays below them: large ones, far below, fill an outline badly
BESIDE, OUTERMOST, SUNK = 32, 0.85, 0.4
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
    whose joints it has, as they are on the whole. Cheaper tiers are left out. InputError for an avatar without a
    network."""
    learned, network = avatar.learned, pose_net_of(avatar)
    assert learned is not None
    poses = _wanted(avatar, one)
    bone_weights, uvd = torch.from_numpy(avatar.bone_weights), torch.from_numpy(avatar.uvd)
    before, net = (PoseNet.of(network, bone_weights, uvd) for _ in range(2))
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
            shade = before.part(rows)(angles).shade
        apart_mm = 1e3 * (found.offset_m + constant_m[rows] - poses.offset_m[pose, rows])
        loss = functional.smooth_l1_loss(apart_mm, torch.zeros_like(apart_mm), beta=ROBUST_MM)
        loss = loss + SHADE_WEIGHT * (found.shade - shade).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        rate.step()
        if step % (STEPS // 4) == STEPS // 4 - 1:
            constant_m = _constant(net, poses)
    position_m = avatar.position_m + constant_m.numpy()
    return replace(avatar, position_m=position_m, learned=replace(learned, correctives=net.plain(), distilled=None))


def _constant(net: PoseNet, poses: _Poses) -> torch.Tensor:
    """(N, 3) meters: what the network lacks on the mean."""
    with torch.no_grad():
        pairs = zip(poses.offset_m, poses.angles_rad, strict=True)
        return torch.stack([offset_m - net(Angles.of(angles)).offset_m for offset_m, angles in pairs]).mean(0)


def _wanted(avatar: HandAvatar, one: Somebody) -> _Poses:
    hand = RiggedHand(one.identity)
    posed = hand.pose(varied_poses(hand, POSES, SEED).angles_deg)
    surface, right = SkinSurface(one.identity, LEVELS, one.maps), avatar.for_hand(Handedness.RIGHT)
    posing, skeleton = Posing(right), right.skeleton()
    skin = surface.faces[: one.identity.skin_face_count * 4**LEVELS]
    resting = Surface(surface.posed(one.identity.vertices_m, surface.bent(one.identity.joints_m[None])[0]), skin)
    home = resting.closest(posing(one.identity.joints_m).position_m.astype(np.float64))
    net = PoseNet.of(pose_net_of(avatar), torch.from_numpy(avatar.bone_weights), torch.from_numpy(avatar.uvd))
    weights = avatar.map_weights(avatar.position_m, avatar.bone_weights).astype(np.float64)
    below_m, outwards, offsets_m, turns, angles_rad = [], [], [], [], []
    poses = zip(
        hand.skin(posed), posed.joints_m, surface.bent(posed.joints_m), still_forearm(one, posed.joints_m), strict=True
    )
    for vertices_m, joints_m, bent, forearm in poses:
        bones, skin_m = skeleton.bones(joints_m, np.float64, forearm=forearm), surface.posed(vertices_m, bent)
        outwards.append(Surface(skin_m, skin).normals(home.face, home.barycentric).astype(np.float32))
        on_skin_m = np.einsum("nk,nkc->nc", home.barycentric, skin_m[skin[home.face]])
        below_m.append((posing(joints_m, forearm).position_m - on_skin_m).astype(np.float32))
        maps = np.einsum("vb,bij->vij", weights, bones.linear_offset)[..., :3]
        size = np.cbrt(np.maximum(np.abs(np.linalg.det(maps)), BLEND_DET_MIN * bones.scale**3))
        turns.append((bones.scale * maps / size[:, None, None]).astype(np.float32))
        angles_rad.append(torch.from_numpy(bones.angles_rad).float())
        with torch.no_grad():
            offsets_m.append(net(Angles.of(angles_rad[-1])).offset_m.numpy())
    depth_m = np.stack([(below * normal).sum(1) for below, normal in zip(below_m, outwards, strict=True)])
    behind_m = (avatar.position_m - avatar.canonical_joints_m[0]) @ FOREARM_WAY
    part = np.clip((behind_m - FROM_M) / (TO_M - FROM_M), 0, 1)
    part = (part * part * (3 - 2 * part)).astype(np.float32)
    usual_m = np.median(depth_m, 0)
    # those that lie below others in a forearm were never seen, and may have any color: they stay below them
    _, near = KDTree(home.point_m).query(home.point_m, BESIDE)
    below_others_m = np.minimum(usual_m - np.quantile(usual_m[near], OUTERMOST, axis=1), 0).astype(np.float32)
    usual_m += part * (np.median(usual_m[behind_m < FROM_M]) + SUNK * below_others_m - usual_m)
    for k, (below, normal, turn) in enumerate(zip(below_m, outwards, turns, strict=True)):
        apart_m = usual_m - depth_m[k]
        apart_m -= (1 - part) * np.clip(apart_m, -SLACK_M, SLACK_M)
        missing_m = apart_m[:, None] * normal
        missing_m -= part[:, None] * (below - depth_m[k][:, None] * normal)
        offsets_m[k] = offsets_m[k] + np.linalg.solve(turn, missing_m[..., None])[..., 0]
    return _Poses(torch.from_numpy(np.stack(offsets_m)), torch.stack(angles_rad))
