"""One step of learning a hand: a pose, some pictures of it, the loss, the update. METHOD 4.

Everything is drawn by the functions that draw the finished avatar (`learn.skinning`, `learn.rasterize`). What a pose
needs of the bones never changes while training, and is computed once per pose.

What is learned lies on the training's device: planes, networks, skin, Adam. Rasterizer, shadow and the losses of
pictures run on the CPU; posed Gaussians go there and their gradients come back (`_draw_view`). On the CPU nothing is
copied.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from scipy.spatial import KDTree
from torch import Tensor

from jghand_engine.avatar.avatar import AvatarInfo, HandAvatar, forearm_way
from jghand_engine.avatar.correctives import PoseNetwork
from jghand_engine.avatar.learned import no_light
from jghand_engine.captures.captures import by_pose
from jghand_engine.captures.sample import Sample
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.sequence import HandPose
from jghand_engine.hand.skeleton import Skeleton, Transform
from jghand_engine.learn.baselines import transform_called
from jghand_engine.learn.canonical_points import place_points
from jghand_engine.learn.cast_shadow import LampsSeen
from jghand_engine.learn.detail import PIXEL_MAX_M, DetailLearner, Ratio
from jghand_engine.learn.frames import HandFrames
from jghand_engine.learn.known_light import LitHand, Pose, trained_on
from jghand_engine.learn.losses import l1_loss, mask_loss, offset_loss, ssim_loss, tone_loss
from jghand_engine.learn.model import LearnedHand
from jghand_engine.learn.options import TrainOptions, at_part
from jghand_engine.learn.perceptual import PerceptualMetric
from jghand_engine.learn.pictures import LruCache, Pictures, View, tone
from jghand_engine.learn.planes import roughness
from jghand_engine.learn.pose_features import octave_of_wave
from jghand_engine.learn.pose_net import Correction
from jghand_engine.learn.rasterize import rasterize
from jghand_engine.learn.reference import Picture
from jghand_engine.learn.shadow import darken, printed_visibility
from jghand_engine.learn.skeleton import BoneTransforms, angle_ranges
from jghand_engine.learn.skinning import PosedSkin, SkinMaps, map_weights, pose_skin, see_lamps, seen_from, skin_maps
from jghand_engine.learn.tensors import HandTensors, mapped
from jghand_engine.learn.trainable import GAUSSIANS, LOSS
from jghand_engine.native.library import load as load_native
from jghand_engine.native.threads import thread_count
from jghand_engine.render.camera import Camera
from jghand_engine.render.gate import ShadowGate, fade
from jghand_engine.render.settings import RenderSettings
from jghand_engine.render.shadow import ShadowStyle
from jghand_engine.template.mesh import HandTemplate

# second moments below this are noise: Adam's own 1e-8 would hold back planes whose texels are seldom seen
ADAM_EPS = 1e-15
# ... and of what a pose needs of the bones, bytes; 3.5 MB each at 40,000 Gaussians
POSE_CACHE_BYTES = 2_000_000_000
# of the mean square of a texel's gradients, what a step keeps: texels are seen once in some hundred steps. There is no
# momentum, so that one that is not seen does not move
TEXTURE_MEMORY = 0.99
# visibility below which the shadow is black: its power with the learned gain has a finite gradient
VISIBILITY_MIN = 1e-3

CPU = torch.device("cpu")


@dataclass(frozen=True)
class Material:
    """What a hand is learned from.

    train:      pictures to learn from, of one hand
    judged:     fixed views by which progress is judged, at least one; the first is shown
    template:   where the Gaussians start
    info:       names of the finished avatar
    perceptual: metric of the perceptual term, or None
    """

    train: Sequence[Sample]
    judged: Sequence[Sample]
    template: HandTemplate
    info: AvatarInfo
    perceptual: PerceptualMetric | None = None


@dataclass(frozen=True)
class _PosedBones:
    """What never changes of one pose.

    bones:  its transforms
    maps:   of the skin
    shadow: strength of the self-shadow, 0..1
    seen:   which lamps are seen; None where no cast shadow is learned
    """

    bones: BoneTransforms
    maps: SkinMaps
    shadow: float
    seen: LampsSeen | None

    def nbytes(self) -> int:
        """Memory of the maps, bytes; the rest is small."""
        tensors = [*vars(self.maps).values(), *([] if self.seen is None else vars(self.seen).values())]
        return sum(tensor.nbytes for tensor in tensors)


class HandTraining:
    """A Trainable (`learn.trainable`): learns `material` as `options` say, with torch's part on `device`."""

    def __init__(self, material: Material, options: TrainOptions, device: torch.device = CPU) -> None:
        _check_joints(material)
        self.options, self._material, self._device = options, material, device
        self._handedness = material.train[0].handedness
        model = options.model
        points = place_points(
            material.template,
            model.gaussians,
            depth_m=model.shell_depth_m,
            area_power=model.area_power,
            depth_of_points=model.depth_of_points,
            seed=options.seed,
        )
        hand = LearnedHand(points, model, options.seed)
        # of the CPU, where bones and what they do to the skin are computed, once a pose
        with torch.no_grad():
            self._points, self._cast = points, hand.cast_shadow(len(points))
        self.hand = hand.on(device)
        self._info = replace(material.info, transform=options.transform)
        self._transform = transform_called(
            options.transform,
            points.joints_m.numpy(),
            handedness=self._handedness,
            swing=model.swing,
            scale_mode=model.scale_mode,
            forearm_way=forearm_way(material.template.identifier),
        )
        self._gate = ShadowGate(points.joints_m.numpy())
        self._poses = by_pose(material.train)
        self._names = sorted(self._poses)
        steps = [-(-len(self._poses[name]) // options.schedule.views) for name in self._names]
        self._rounds = [[pose for pose, own in enumerate(steps) if own > turn] for turn in range(max(steps))]
        self._known: LruCache[_PosedBones] = LruCache(POSE_CACHE_BYTES, _PosedBones.nbytes)
        self._pictures = Pictures(known_light=model.known_light)
        self._relit = None
        if model.known_light:
            assert self._cast is not None
            self._relit = LitHand(self._cast, points.joints_m, model.left_out)
        self._settings = RenderSettings()
        self._library = load_native("auto")
        self._octave = octave_of_wave(model.pose.octaves).to(device)
        # fused and joined forms of the update are tried on the CPU; Metal takes the plain ones
        self._fast = device.type != "mps"
        self._optimizer = self._new_optimizer()
        self._detail = self._new_detail()
        if self._detail is not None:
            self._texture_optimizer = torch.optim.Adam(
                [self._detail.texture], betas=(0.0, TEXTURE_MEMORY), eps=ADAM_EPS, fused=self._fast
            )
        self._steps = 1
        self._count = 0
        # of the training that is over, for what is shown and baked: as much of the encoding as has been learned
        self._part = 0.0

    def _new_optimizer(self) -> torch.optim.Adam:
        schedule, hand = self.options.schedule, self.hand
        fast = [hand.log_sigma, hand.pose_net.angles.planes, *hand.planes.parameters(), *hand.light_parameters()]
        known = {id(parameter) for parameter in fast}
        slow = [parameter for parameter in hand.parameters() if id(parameter) not in known]
        groups = [{"params": slow, "lr": schedule.rate}, {"params": fast, "lr": schedule.plane_rate}]
        # the fused form is four times as fast on the CPU and gives the same bits every time
        return torch.optim.Adam(groups, eps=ADAM_EPS, fused=self._fast)

    def _new_detail(self) -> DetailLearner | None:
        """For pictures that hold more than Gaussians do."""
        about, model = self._material.info.learned_from, self.options.model
        fine = about is not None and 0 < about.pixel_m <= PIXEL_MAX_M
        if self.options.schedule.detail_from is None or not fine or self.options.transform is not Transform.JOINTS:
            return None
        skeleton = Skeleton(
            self._points.joints_m.numpy(),
            handedness=self._handedness,
            swing=model.swing,
            scale_mode=model.scale_mode,
            forearm_way=forearm_way(self._material.template.identifier),
        )
        return DetailLearner(self._material.template, skeleton)

    # ---- Trainable ---------------------------------------------------------------------------------------------------

    def plan(self, steps: int) -> None:
        self._steps = max(steps, 1)

    def step(self, number: int) -> dict[str, float]:
        self._part = part = min(number / self._steps, 1.0)
        self._refine(part)
        self._find_detail(part)
        stride = int(at_part(self.options.schedule.strides, part))
        samples = self._draw(number)
        seeds = [(self.options.seed, number, index) for index in range(len(samples))]
        views = [self._pictures.view(sample, stride, seed) for sample, seed in zip(samples, seeds, strict=True)]
        self._set_rates(number, part)
        terms = self._terms(samples[0], views, part, self._read_frames(samples[0], number))
        loss = torch.stack([term.cpu() for term in terms.values()]).sum()
        self._optimizer.zero_grad(set_to_none=True)
        if self._detail is not None:
            self._texture_optimizer.zero_grad(set_to_none=True)
        loss.backward()
        norm = torch.nn.utils.get_total_norm(list(self.gradients().values()), foreach=self._fast)
        # shortened by a norm that is not finite, all gradients would be so too, and hide which one it was
        if bool(torch.isfinite(norm)):
            if (longest := self.options.schedule.gradient_norm) is not None:
                torch.nn.utils.clip_grads_with_norm_(self.hand.parameters(), longest, norm, foreach=self._fast)
            self._optimizer.step()
            self.hand.keep_in_range()
            if self._detail is not None and self._detail.is_found:
                self._texture_optimizer.step()
                self._detail.keep_in_range()
        figures = {name: float(term.detach()) for name, term in terms.items()}
        return {LOSS: float(loss.detach()), GAUSSIANS: float(self._count), "gradient": float(norm), **figures}

    def tensors(self) -> dict[str, Tensor]:
        """See Trainable: parameters under their names, Adam's moments behind `adam.`."""
        named = {name: parameter.data for name, parameter in self.hand.named_parameters()}
        for name, parameter in self.hand.named_parameters():
            state = self._started(self._optimizer, parameter)
            named |= {f"adam.{name}.{moment}": state[moment] for moment in ("exp_avg", "exp_avg_sq", "step")}
        if self._detail is not None:
            state = self._started(self._texture_optimizer, self._detail.texture)
            named |= {f"detail.{name}": tensor for name, tensor in self._detail.state_dict().items()}
            named |= {f"detail.texture.{moment}": state[moment] for moment in ("exp_avg_sq", "step")}
        return named

    def load_tensors(self, tensors: Mapping[str, Tensor]) -> None:
        with torch.no_grad():
            for name, own in self.tensors().items():
                own.copy_(tensors[name])
        self.hand.keep_in_range()

    def scalars(self) -> dict[str, Any]:
        """See Trainable: how many Gaussians take part so far, and the part of the training that is over."""
        return {"count": self._count, "part": self._part}

    def load_scalars(self, scalars: Mapping[str, Any]) -> None:
        self._count, self._part = int(scalars["count"]), float(scalars.get("part", 1.0))

    def gradients(self) -> dict[str, Tensor]:
        return {name: parameter.grad for name, parameter in self.hand.named_parameters() if parameter.grad is not None}

    def preview(self) -> np.ndarray:
        view, ours = self._drawn(self._material.judged[0])
        return torch.cat([view.rgb, ours], 1).numpy()

    def fixed_psnr(self) -> float:
        """See Trainable: on the cuts of the fixed views."""
        pairs = [self._drawn(sample) for sample in self._material.judged]
        errors = torch.stack([(view.rgb - ours).square().mean() for view, ours in pairs])
        return float(-10 * torch.log10(errors.clamp_min(1e-10)).mean())

    def avatar(self) -> HandAvatar:
        """See Trainable: plain numbers, apart from what goes on learning; its angle ranges are those of the poses."""
        with torch.no_grad():
            info = replace(self._info, pose_statistics=angle_ranges(self._transform, self._joints_m()))
            avatar = self.hand.avatar(info, handedness=self._handedness).avatar()
        if self._detail is not None:
            avatar = replace(avatar, detail=self._detail.detail())
        learned, waves = avatar.learned, self._wave_weight(self._part)
        assert learned is not None
        if waves is not None and isinstance(learned.correctives, PoseNetwork):
            learned.correctives.weights["encoding_in.weight"] *= waves.cpu().numpy()
        if learned.response is not None and learned.cast is not None:
            cast = replace(learned.cast, lamp_rgb=np.zeros_like(learned.cast.lamp_rgb))
            response = replace(learned.response, trained_on=trained_on(self._material.train))
            return replace(
                avatar, learned=replace(learned, light=no_light(), shadow=None, cast=cast, response=response)
            )
        look = replace(self.hand.shadow_look(), printed=self.options.printed_shadow) if self.options.shadow else None
        return replace(avatar, learned=replace(learned, shadow=look))

    # ---- what a step does --------------------------------------------------------------------------------------------

    def _draw(self, number: int) -> list[Sample]:
        """Pictures of one pose by different cameras. An epoch shows every picture once, in rounds of all poses; where
        the views do not divide the cameras, the last step of a pose shows some of the epoch's pictures again."""
        views, seed = self.options.schedule.views, self.options.seed
        epoch, place = divmod(number, sum(map(len, self._rounds)))
        turn = 0
        while place >= len(self._rounds[turn]):
            place -= len(self._rounds[turn])
            turn += 1
        poses = self._rounds[turn]
        pose = poses[np.random.default_rng([seed, epoch, 0, turn]).permutation(len(poses))[place]]
        samples = self._poses[self._names[pose]]
        cameras = np.random.default_rng([seed, epoch, 1, pose]).permutation(len(samples))
        return [samples[cameras[(turn * views + view) % len(samples)]] for view in range(min(views, len(samples)))]

    def _refine(self, part: float) -> None:
        """Lets the Gaussians of a finer level of detail join, with the radii of their neighbors."""
        total = len(self.hand.points)
        wanted = max(1, round(total * at_part(self.options.schedule.levels, part)))
        if wanted <= self._count:  # a plan that grows longer takes none away
            return
        if self._count:
            position_m = self._points.position_m.numpy()
            _, nearest = KDTree(position_m[: self._count]).query(position_m[self._count : wanted])
            self.hand.spread_radii(self._count, torch.from_numpy(np.asarray(nearest)))
        self._count = wanted

    def _find_detail(self, part: float) -> None:
        """Puts the surface of the detail where the Gaussians are, once."""
        start = self.options.schedule.detail_from
        if self._detail is not None and start is not None and part >= start and not self._detail.is_found:
            self._detail.find(self.avatar(), self._material.train, self._pictures)

    def _detail_of(self, sample: Sample, views: Sequence[View]) -> Ratio | None:
        """What multiplies the colors of these pictures of that pose."""
        if self._detail is None or not self._detail.is_found:
            return None
        return self._detail.ratios(sample.hand, [view.camera for view in views])

    def _set_rates(self, number: int, part: float) -> None:
        schedule = self.options.schedule
        warm_up = max(1.0, min(schedule.warm_up_steps, schedule.warm_up_part * self._steps))
        fall = schedule.last_part ** min(1.0, self._steps / schedule.settle_steps)
        factor = fall**part * min(1.0, (number + 1) / warm_up)
        for group, rate in zip(self._optimizer.param_groups, (schedule.rate, schedule.plane_rate), strict=True):
            group["lr"] = rate * factor
        if self._detail is not None:
            self._texture_optimizer.param_groups[0]["lr"] = schedule.texture_rate * factor

    def _terms(
        self, sample: Sample, views: Sequence[View], part: float, read: HandFrames | None = None
    ) -> dict[str, Tensor]:
        """The weighted terms of the loss of one pose. read: see `_read_frames`"""
        weights, avatar = self.options.loss, self._live()
        posed = self._posed_bones(sample)
        skin, correction = self._pose(avatar, posed, part, read)
        terms: dict[str, list[Tensor]] = {"l1": [], "ssim": [], "mask": [], "perceptual": []}
        detail = self._detail_of(sample, views)
        for view in views:
            rgb, alpha = self._draw_in_light(avatar, skin, posed, view, detail)
            terms["l1"].append(weights.l1 * l1_loss(rgb, view.rgb))
            terms["mask"].append(weights.mask * mask_loss(alpha, view.mask))
            if weights.ssim:
                terms["ssim"].append(weights.ssim * ssim_loss(rgb, view.rgb))
            if self._material.perceptual is not None and part >= self.options.schedule.perceptual_from:
                unlike = self._material.perceptual.distance(rgb.to(self._device), view.rgb.to(self._device))
                terms["perceptual"].append(weights.perceptual * unlike.cpu())
        mean = {name: torch.stack(values).mean() for name, values in terms.items() if values}
        moved_m = avatar.position_m - self.hand.points.position_m[: self._count]
        wrist_m, middle_tip_m = self.hand.points.joints_m[[0, 18]]
        size_m = float((middle_tip_m - wrist_m).norm())
        mean["offset"] = weights.offset * offset_loss(moved_m, correction.offset_m, hand_size_m=size_m)
        mean["tone"] = weights.tone * tone_loss(correction.shade)
        if weights.roughness:
            mean["roughness"] = weights.roughness * self.hand.planes.roughness()
        if weights.angle_roughness:
            mean["angle_roughness"] = weights.angle_roughness * roughness(self.hand.pose_net.angles.planes)
        return mean

    def _read_frames(self, sample: Sample, number: int) -> HandFrames | None:
        """The frames whose angles the pose's network reads in this step; None: those of the bones."""
        if not self.options.joint_noise_m:
            return None
        noise = np.random.default_rng([self.options.seed, number]).normal(size=(21, 3))
        if self._handedness is Handedness.LEFT:  # a left hand is learned as its mirror image is
            noise[:, 0] *= -1
        frames = self._transform.frames(torch.from_numpy(sample.joints_m + self.options.joint_noise_m * noise).float())
        return mapped(frames, lambda tensor: tensor.to(self._device))

    def _live(self) -> HandTensors:
        return self.hand.avatar(self._info, handedness=self._handedness, count=self._count)

    def _pose(
        self, avatar: HandTensors, posed: _PosedBones, part: float, read: HandFrames | None = None
    ) -> tuple[PosedSkin, Correction]:
        """The skin of a pose, and what the pose changes on it. read: see `_read_frames`"""
        correction = self.hand.pose_net(read or posed.bones.frames, len(avatar), self._wave_weight(part))
        maps = mapped(posed.maps, lambda tensor: tensor[: len(avatar)])
        return pose_skin(avatar, posed.bones, correction, maps=maps, seen=posed.seen), correction

    def _wave_weight(self, part: float) -> Tensor | None:
        """How much each wave of the encoding counts: octave after octave, each faded in by half a cosine."""
        waves = self.options.schedule.waves
        if waves is None or part >= waves[1]:
            return None
        progress = (part - waves[0]) / (waves[1] - waves[0]) * (float(self._octave.max()) + 1)
        return 0.5 - 0.5 * torch.cos(torch.pi * (progress - self._octave).clamp(0, 1))

    def _draw_in_light(
        self, avatar: HandTensors, skin: PosedSkin, posed: _PosedBones, view: View, detail: Ratio | None = None
    ) -> tuple[Tensor, Tensor]:
        """As `_draw_view`; in known light as `View.rgb` has it. detail: see `_detail_of`"""
        if self._relit is None or view.lit is None:
            return self._draw_view(avatar, skin, posed.shadow, view.camera, detail)
        points = self.hand.points
        pose = Pose(posed.bones, posed.maps, points.position_m, points.normal)
        gaussians = self._relit.gaussians(avatar, skin, pose, view.lit, torch.from_numpy(view.camera.eye_m))
        picture = rasterize(mapped(gaussians, Tensor.cpu), view.camera, self._settings)
        return tone(view.lit.exposure * _with_detail(picture, view.camera, detail)), picture.alpha

    def _draw_view(
        self, avatar: HandTensors, skin: PosedSkin, shadow: float, camera: Camera, detail: Ratio | None = None
    ) -> tuple[Tensor, Tensor]:
        """Color (H, W, 3) and alpha (H, W) of one view, with gradients."""
        gaussians = mapped(seen_from(skin, torch.from_numpy(camera.eye_m), avatar), Tensor.cpu)
        picture = rasterize(gaussians, camera, self._settings)
        rgb = _with_detail(picture, camera, detail)
        if not (self.options.shadow and shadow > 0):
            return rgb, picture.alpha
        gain, tint = (number.cpu() for number in self.hand.shadow())
        if self.options.printed_shadow:
            seen = printed_visibility(picture.depth_sum, picture.alpha, self.options.shadow_samples)
        else:
            # drawn in white on white the pass gives the visibility itself; its constants are learned outside of it
            white = torch.ones_like(picture.alpha)[None].expand(3, -1, -1)
            planes = torch.cat([white, picture.alpha[None], picture.depth_sum[None]])
            style = ShadowStyle(samples=self.options.shadow_samples, tint=(1.0, 1.0, 1.0))
            seen = darken(planes, camera, style, library=self._library, threads=thread_count(0))[0]
            seen = seen.clamp_min(VISIBILITY_MIN) ** (gain / style.gain)
        return rgb * (1 - shadow * tint * (1 - seen[..., None])), picture.alpha

    def _posed_bones(self, sample: Sample) -> _PosedBones:
        return self._known.get(sample.pose, lambda: self._new_posed_bones(sample.hand))

    def _new_posed_bones(self, hand: HandPose) -> _PosedBones:
        bones = self._transform.bones(torch.from_numpy(hand.joints_m).float(), hand.forearm)
        maps = skin_maps(map_weights(self._points.position_m, self._points.bone_weights, bones), bones)
        with torch.no_grad():
            cast = None if self._relit is not None else self._cast
            seen = None if cast is None else see_lamps(cast, bones)
        gate = 1.0 if self.options.printed_shadow else fade(self._gate.score(hand.joints_m, float(bones.scale)))
        posed = _PosedBones(bones, maps, gate, seen)
        return mapped(posed, lambda tensor: tensor.to(self._device))

    def _drawn(self, sample: Sample) -> tuple[View, Tensor]:
        """A view and ours of it, 0..1."""
        with torch.no_grad():
            view, avatar = self._pictures.view(sample), self._live()
            posed = self._posed_bones(sample)
            skin, _ = self._pose(avatar, posed, self._part)
            rgb, _ = self._draw_in_light(avatar, skin, posed, view, self._detail_of(sample, [view]))
            return replace(view, rgb=view.rgb.clamp(0, 1)), rgb.clamp(0, 1)

    def _joints_m(self) -> Tensor:
        """(P, 21, 3) joints of all poses that are learned from."""
        return torch.from_numpy(np.stack([self._poses[name][0].joints_m for name in self._names]))

    def _started(self, optimizer: torch.optim.Adam, parameter: torch.nn.Parameter) -> dict[str, Tensor]:
        """Adam's moments of a parameter; zeros before its first step, as Adam itself would begin."""
        state = optimizer.state[parameter]
        if not state:
            state["step"] = torch.zeros((), device=self._device if self._fast else "cpu")
            state["exp_avg"], state["exp_avg_sq"] = torch.zeros_like(parameter), torch.zeros_like(parameter)
        return state


def _check_joints(material: Material) -> None:
    """One joint that is not known would make a whole step's gradients unknown."""
    for sample in (*material.train, *material.judged):
        if not np.isfinite(sample.joints_m).all():
            raise InputError(f"joints of {sample.image}", wanted="21 known joints", came="NaN or infinity",
                             remedy="Leave that pose out, or look at it with `jghand check-data`.")  # fmt: skip


def _with_detail(picture: Picture, camera: Camera, detail: Ratio | None) -> Tensor:
    """(H, W, 3) the colors of a picture, multiplied by detail."""
    return picture.rgb if detail is None else picture.rgb * detail(camera, picture.alpha, picture.depth_sum)
