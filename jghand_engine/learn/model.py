"""The learnable hand of METHOD 4.1: feature planes and decoders that give HandTensors, with gradients to all of them.

There is one way of posing, `skinning.pose_skin`, for learning and for drawing: the model makes an avatar whose tensors
remember how they were made, or, when learning is over, one whose tensors are plain numbers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from typing import Any

import torch
from torch import Tensor, nn

from jghand_engine.avatar.avatar import (
    DEEP_M,
    DEEP_RADII,
    SIGMA_MAX_M,
    SIGMA_MIN_M,
    UVD_RANGE_M,
    AvatarInfo,
    sigma_scale_for_prefix,
)
from jghand_engine.avatar.correctives import PoseNetShape
from jghand_engine.avatar.learned import LOG_STRETCH_MAX, SH_COUNT, Ellipsoid, ShadowLook, flesh_of
from jghand_engine.avatar.relighting import REFLECTANCE, SHADE_GAIN, SOFTNESS, THROWN_BACK
from jghand_engine.hand.joints import Handedness
from jghand_engine.learn.canonical_points import CanonicalPoints
from jghand_engine.learn.cast_shadow import CastTensors, place_anchors
from jghand_engine.learn.light import LightTensors, unit
from jghand_engine.learn.planes import IdentityPlanes
from jghand_engine.learn.pose_net import PoseNet
from jghand_engine.learn.scene_light import CORNER_MAX, CORNER_MIN, ResponseTensors
from jghand_engine.learn.tensors import HandTensors, LearnedTensors, mapped
from jghand_engine.native import contract

# standard deviation of feature planes at the start (METHOD 4.2)
PLANE_START_STD = 0.1
# how far a learned normal may leave the template's, per unit of the decoder's output
NORMAL_BEND = 0.3
# logarithm of the greatest and least shine over their middle: skin is equally glossy nearly everywhere, and cameras
# that were not learned from show what was taken for gloss
SHINE_SPREAD = 0.5
# lobes of the gloss at the start: wide, lambda of exp(lambda (cos - 1)), and nearly dark, before the softplus;
# a sharper lobe than the last is narrower than what a Gaussian of half a millimeter can show
LOBE_SHARPNESS_START = 5.0
LOBE_SHARPNESS_MAX = 60.0
LOBE_RAW_START = -4.5
# learnable range of the shadow's darkness g (METHOD 5.2: 4 to 12; wider, because a shadow may be better off)
SHADOW_GAIN_RANGE = (1.0, 12.0)
# lamps around the hand, and points of the skin at which they are counted: one per 20 mm^2
LAMPS = 64
ANCHORS = 2048
# logarithm of a lamp's brightness per unit of its parameter: lamps differ much more than other parameters do
LAMP_RATE = 10.0
# light that reaches skin which sees no lamp, from other skin, over that of all lamps together, at the start
BOUNCED_START = 0.03

# of a response: logarithms of how far the spread and the reflectance of a Gaussian leave those of the hand; the GGX
# roughness of skin; no skin mirrors more at right angles
SOFTNESS_SPREAD, REFLECTANCE_SPREAD = 0.7, 1.5
ROUGHNESS_LEAST, ROUGHNESS_SPAN = 0.25, 0.4
REFLECTANCE_MAX = 0.1

# towards the corners of a cube: where the lobes of the gloss begin
_LOBES = [(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)]


class OffsetFrame(StrEnum):
    """Axes of the pose's offsets: turned with the hand (METHOD 2.9), or the world's, as the paper prints it."""

    TURNED = "turned"
    WORLD = "world"


class LightPart(StrEnum):
    """What an ablation leaves out of the light that falls on a hand.

    bounce:    light that skin throws onto skin
    shadows:   all that fingers hide of lamps and world, and what they throw back instead
    softness:  the rounded corner of cosines, down to its least width
    gloss:     what skin mirrors
    lamps:     lamps that are computed apart: they are part of the world then, as the hand's middle sees them
    shadows_and_lamps: 16 harmonics of the world are left, and what is mirrored of it
    """

    BOUNCE = "bounce"
    SHADOWS = "shadows"
    SOFTNESS = "softness"
    GLOSS = "gloss"
    LAMPS = "lamps"
    SHADOWS_AND_LAMPS = "shadows and lamps"


@dataclass(frozen=True)
class ModelOptions:
    """What is learned; METHOD 4.2 has the two configurations.

    gaussians:        how many
    shell_depth_m:    how deep under the skin they start
    area_power:       how bones share them, see `place_points`
    depth_of_points:  whether the depth coordinate spans the points instead of a fixed range, see `place_points`
    swing:            as `JointTransform` takes it
    scale_mode:       as `JointTransform` takes it
    offset_frame:     axes of the pose's offsets
    pose:             the shape of the pose's network
    plane_texels:     of the identity planes, along u and v
    depth_texels:     of the identity planes, along the depth
    hidden:           width of the identity decoder
    one_decoder:      whether one network decodes all of the identity, or offset, color and opacity have one each
    identity_reach_m: longest identity offset along an axis
    opacity_bias:     before the sigmoid, at the start
    anisotropic:      whether a Gaussian has three radii and a rotation instead of one radius (METHOD 4.3)
    lit:              whether the light of the capture is learned apart from the colors
    glossy:           whether reflections are learned
    cast_shadow:      whether the lamps are learned that the fingers hide from the palm
    known_light:      whether it is learned how skin answers light that is known, instead of one light with the skin
    left_out:         part of known light that is not computed
    """

    gaussians: int = 40_000
    shell_depth_m: float = 0.001
    area_power: float = 0.78
    depth_of_points: bool = False
    swing: str = "minimal"
    scale_mode: str = "axial"
    offset_frame: OffsetFrame = OffsetFrame.TURNED
    pose: PoseNetShape = field(default_factory=PoseNetShape)
    plane_texels: int = 256
    depth_texels: int = 32
    hidden: int = 128
    one_decoder: bool = True
    identity_reach_m: float = 0.008
    opacity_bias: float = 2.0
    anisotropic: bool = False
    lit: bool = True
    glossy: bool = True
    cast_shadow: bool = True
    known_light: bool = False
    left_out: LightPart | None = None


class LearnedHand(nn.Module):
    """points: where its Gaussians start · options: what is learned · seed: of the random start of the parameters."""

    def __init__(self, points: CanonicalPoints, options: ModelOptions, seed: int) -> None:
        super().__init__()
        self.options, self.points = options, points
        if options.cast_shadow:
            self._anchors = place_anchors(points.position_m, points.normal, points.bone_weights, ANCHORS)
            skin_m, joints_m = self._anchors.position_m.numpy(), points.joints_m.numpy()
            flesh, own = flesh_of(skin_m, joints_m, fitted=options.known_light)
            self._flesh, self._own = torch.from_numpy(flesh), torch.from_numpy(own)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self._make_parameters()

    def _make_parameters(self) -> None:
        options, points = self.options, self.points
        self.planes = IdentityPlanes(points.uvd, texels=options.plane_texels, depth_texels=options.depth_texels)
        # offset 3, color 3, opacity 1, normal 3, shine or reflectance 1, spread 1, roughness 1
        widths = (13 if options.known_light else 11,) if options.one_decoder else (3, 3, 1)
        inputs, hidden = self.planes.width, options.hidden
        self.decoders = nn.ModuleList(
            nn.Sequential(
                nn.Linear(inputs, hidden), nn.ReLU(), nn.Linear(hidden, hidden), nn.ReLU(), nn.Linear(hidden, width)
            )
            for width in widths
        )
        self.log_sigma = nn.Parameter(points.sigma_m.log())
        if options.anisotropic:
            self.log_stretch = nn.Parameter(torch.zeros(len(points), 3))
            self.quaternion = nn.Parameter(torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(len(points), 1))
        self.pose_net = PoseNet(points.bone_weights, points.uvd, options.pose)
        self.irradiance = nn.Parameter(torch.zeros(SH_COUNT, 3))
        self.lobe_direction = nn.Parameter(torch.tensor(_LOBES))
        self.lobe_log_sharpness = nn.Parameter(torch.full((len(_LOBES),), math.log(LOBE_SHARPNESS_START)))
        self.lobe_raw_rgb = nn.Parameter(torch.full((len(_LOBES), 3), LOBE_RAW_START))
        self.raw_rim = nn.Parameter(torch.zeros(()))
        if options.cast_shadow:
            self.raw_lamps = nn.Parameter(torch.zeros(LAMPS, 3))
            self.raw_bounced = nn.Parameter(torch.logit(torch.full((3,), BOUNCED_START)))
        if options.known_light:
            self.log_softness = nn.Parameter(torch.tensor(SOFTNESS).log())
            self.log_reflectance = nn.Parameter(torch.tensor(math.log(REFLECTANCE)))
        low, high = SHADOW_GAIN_RANGE
        self.raw_shadow_gain = nn.Parameter(torch.logit(torch.tensor(math.log(contract.SHADOW_GAIN / low, high / low))))
        self.raw_shadow_tint = nn.Parameter(torch.logit(torch.tensor(contract.SHADOW_TINT)))
        for plane in (self.planes.uv.texels, self.planes.ud.texels, self.planes.vd.texels, self.pose_net.angles.planes):
            nn.init.normal_(plane, std=PLANE_START_STD)
        heads: list[Any] = [decoder[-1] for decoder in self.decoders]  # pyright: ignore[reportIndexIssue]
        for last in (*heads, self.pose_net.out):
            nn.init.zeros_(last.weight)
            nn.init.zeros_(last.bias)
        with torch.no_grad():
            heads[-1].bias[6 if options.one_decoder else 0] = options.opacity_bias
        self.keep_in_range()

    def _decoded(self, count: int) -> Tensor:
        """(count, 13) what the identity is made of. Networks apart predict nothing behind the opacity: that is 0."""
        features = self.planes(count)
        out = torch.cat([decoder(features) for decoder in self.decoders], 1)
        return nn.functional.pad(out, (0, 13 - out.shape[1]))

    def avatar(self, info: AvatarInfo, *, handedness: Handedness, count: int = 0) -> HandTensors:
        """The hand as it is now, with gradients. count: of its Gaussians, a prefix whose radii grow as
        `HandAvatar.prefix` says; 0: all."""
        count = count or len(self.points)
        points, options = self.points, self.options
        out = self._decoded(count)
        offset_m = options.identity_reach_m * torch.tanh(out[:, :3])
        sigma_m = self.log_sigma[:count].exp()
        return HandTensors(
            info=replace(info, template=points.template, swing=options.swing, scale_mode=options.scale_mode),
            handedness=handedness,
            canonical_joints_m=points.joints_m,
            position_m=points.position_m[:count] + offset_m,
            sigma_m=grown_radii(sigma_m, sigma_scale_for_prefix(count, len(points)), points.uvd[:count, 2]),
            opacity=torch.sigmoid(out[:, 6]),
            rgb=torch.sigmoid(out[:, 3:6]),
            bone_weights=points.bone_weights[:count],
            uvd=points.uvd[:count],
            learned=LearnedTensors(
                normal=unit(points.normal[:count] + NORMAL_BEND * out[:, 7:10]),
                shine=torch.exp(SHINE_SPREAD * torch.tanh(out[:, 10])) if options.glossy else out.new_zeros(count),
                response=self.response(out) if options.known_light else None,
                light=self.light(),
                correctives=self.pose_net.prefix(count),
                shadow=self.shadow_look(),
                world_offsets=options.offset_frame is OffsetFrame.WORLD,
                ellipsoid=self.ellipsoid(count),
                cast=self.cast_shadow(count),
            ),
        )

    def on(self, device: torch.device) -> LearnedHand:
        """Moves parameters and Gaussians to `device`; canonical joints stay in float64 on the CPU. Returns itself."""
        self.to(device)
        names = [f.name for f in fields(self.points) if f.name not in ("joints_m", "template")]
        self.points = replace(self.points, **{name: getattr(self.points, name).to(device) for name in names})
        if self.options.cast_shadow:
            self._anchors = mapped(self._anchors, lambda tensor: tensor.to(device))
            self._flesh, self._own = self._flesh.to(device), self._own.to(device)
        return self

    def ellipsoid(self, count: int) -> Ellipsoid[Tensor] | None:
        """Of the first `count` Gaussians, with gradients; None for spheres."""
        if not self.options.anisotropic:
            return None
        return Ellipsoid(self.log_stretch[:count], self.quaternion[:count])

    def light_parameters(self) -> list[nn.Parameter]:
        """What the light is made of: few numbers that every pixel speaks for."""
        few = [self.irradiance, self.lobe_direction, self.lobe_log_sharpness, self.lobe_raw_rgb, self.raw_rim]
        few += [self.raw_shadow_gain, self.raw_shadow_tint]
        if self.options.known_light:
            few += [self.log_softness, self.log_reflectance]
        return [*few, self.raw_lamps, self.raw_bounced] if self.options.cast_shadow else few

    def cast_shadow(self, count: int) -> CastTensors | None:
        """On the first `count` Gaussians, with gradients; None where it is not learned."""
        if not self.options.cast_shadow:
            return None
        lamp_rgb = torch.softmax(LAMP_RATE * self.raw_lamps, 0)
        bounced = torch.sigmoid(self.raw_bounced)
        return CastTensors(lamp_rgb, bounced, self._anchors.prefix(count), self._flesh, self._own)

    def response(self, out: Tensor) -> ResponseTensors:
        """How the skin answers light, with gradients. out: (N, 13) of the decoder"""
        response = ResponseTensors(
            spread=torch.exp(SOFTNESS_SPREAD * torch.tanh(out[:, 11])),
            roughness=ROUGHNESS_LEAST + ROUGHNESS_SPAN * torch.sigmoid(out[:, 12]),
            reflectance=torch.exp(self.log_reflectance + REFLECTANCE_SPREAD * torch.tanh(out[:, 10])),
            softness=self.log_softness.exp(),
            bounce=self._thrown_back(out.detach()),
            shade_gain=SHADE_GAIN,
        )
        match self.options.left_out:
            case LightPart.BOUNCE:
                return replace(response, bounce=torch.zeros_like(response.bounce))
            case LightPart.SOFTNESS:
                return replace(response, softness=torch.full_like(response.softness, CORNER_MIN))
            case LightPart.GLOSS:
                return replace(response, reflectance=torch.zeros_like(response.reflectance))
        return response

    def _thrown_back(self, out: Tensor) -> Tensor:
        """(3,) as `relighting.thrown_back` has it. out: (N, 13) of the decoder"""
        weight = torch.sigmoid(out[:, 6]) * self.log_sigma[: len(out)].detach().exp().square()
        return THROWN_BACK * (weight @ torch.sigmoid(out[:, 3:6]) / weight.sum())

    def light(self) -> LightTensors:
        """The light as it is now, with gradients."""
        irradiance = self.irradiance if self.options.lit else torch.zeros_like(self.irradiance)
        return LightTensors(
            irradiance=irradiance,
            lobe_direction=self.lobe_direction,
            lobe_sharpness=self.lobe_log_sharpness.exp(),
            lobe_rgb=nn.functional.softplus(self.lobe_raw_rgb),
            rim=nn.functional.softplus(self.raw_rim),
        )

    def shadow_look(self) -> ShadowLook:
        """The shadow's constants as plain numbers."""
        with torch.no_grad():
            gain, tint = self.shadow()
        red, green, blue = tint.tolist()
        return ShadowLook(float(gain), (red, green, blue))

    def shadow(self) -> tuple[Tensor, Tensor]:
        """Gain () and tint (3,) of the shadow as they are now, with gradients, inside their ranges."""
        low, high = SHADOW_GAIN_RANGE
        gain = low * (high / low) ** torch.sigmoid(self.raw_shadow_gain)
        return gain, torch.sigmoid(self.raw_shadow_tint)

    def keep_in_range(self) -> None:
        """Brings radii, stretches and lobes that left their range back to its edge, after every change of parameters.

        A clamp while the avatar is made would take the gradient of what is beyond the edge: it could never return.
        """
        with torch.no_grad():
            self.log_sigma.clamp_(math.log(SIGMA_MIN_M), math.log(SIGMA_MAX_M))
            self.lobe_log_sharpness.clamp_(max=math.log(LOBE_SHARPNESS_MAX))
            if self.options.known_light:
                self.log_softness.clamp_(math.log(CORNER_MIN), math.log(CORNER_MAX))
                self.log_reflectance.clamp_(max=math.log(REFLECTANCE_MAX))
            if self.options.anisotropic:
                self.log_stretch.clamp_(-LOG_STRETCH_MAX, LOG_STRETCH_MAX)

    def spread_radii(self, known: int, nearest: Tensor) -> None:
        """Gives Gaussians from `known` on the learned growth of their neighbor among the first `known`.

        nearest: (N - known,) index of that neighbor. Called when a finer level of detail joins the training.
        """
        with torch.no_grad():
            start = self.points.sigma_m.log()
            growth = (self.log_sigma[:known] - start[:known])[nearest.to(start.device)]
            self.log_sigma[known : known + len(nearest)] = start[known : known + len(nearest)] + growth
        self.keep_in_range()


def grown_radii(sigma_m: Tensor, scale: float, uvd_depth: Tensor) -> Tensor:
    """`avatar.grown_radii` with gradients."""
    if scale == 1.0:
        return sigma_m
    depth_m = (0.5 - uvd_depth) * (2 * UVD_RANGE_M)
    limit_m = torch.where(depth_m > DEEP_M, depth_m / DEEP_RADII, torch.inf)
    return torch.maximum(sigma_m, torch.minimum(sigma_m * scale, limit_m)).clamp(max=SIGMA_MAX_M)
