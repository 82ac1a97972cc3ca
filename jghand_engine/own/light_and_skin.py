"""The light of a film and the skin that stands in it, from what its pictures show of every Gaussian.

The relightable model run backward (docs/LIGHT.md). In the picture f a Gaussian n shows

    color_nf = albedo_n * exp(shade_nf) / pi * sum_j reach_nfj light_j + gloss_nf

with light_j of the 64 cells of one world, and reach_nfj how a Gaussian takes it: the cosine, what the hand's own flesh
leaves of it, and what other skin throws back. Logarithms part the albedo from the light: of each Gaussian its mean over
the pictures is taken out, and what is left is the light's alone, as the hand turns in it. Logarithms of the cells are
smooth over the sphere and among the channels, as far as nothing speaks against it (Gauss-Newton, the prior that of a
Gaussian process), so light is never negative, and a lamp is as bright as it is. What the film cannot tell is how bright
its light is, and how white: a white card in the hand's place is taken to be white on average.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.spatial import KDTree
from torch import Tensor

from jghand_engine.avatar.avatar import HandAvatar, LearnedFrom
from jghand_engine.avatar.cast_task import FLESH_SOFTNESS, LAMP_HALF_WIDTH
from jghand_engine.avatar.learned import lamp_directions
from jghand_engine.avatar.relighting import thrown_back
from jghand_engine.avatar.scene_light import CELL_ROWS, CELLS, SceneLight, World
from jghand_engine.hand.joints import Handedness
from jghand_engine.learn.cast_shadow import CastTensors
from jghand_engine.learn.scene_light import (
    Flesh,
    LampRows,
    Patches,
    ResponseTensors,
    Shadows,
    Skin,
    matt,
    past_flesh,
    reached,
    towards_eye,
)
from jghand_engine.learn.skinning import posed_anchors
from jghand_engine.learn.tensors import HandTensors
from jghand_engine.native.scene_light_task import LAMP_NUMBERS
from jghand_engine.own.gather import FEW_PICTURES, Observations, Shown, counted
from jghand_engine.own.skin_prior import whole_skin

# Gaussians that the light is found from, the first ones, which cover the hand
LIGHT_GAUSSIANS = 3000
# rounds of the light and of the gloss that it makes, and steps in each; no step is longer, as a factor
LIGHT_ROUNDS, LIGHT_STEPS, STEP_MAX = 4, 2, 1.0
# light around the hand, as it may be: spread of its logarithm, how far it is alike (concentration of a spherical
# Gaussian, some 35 degrees wide), and spread of its color's logarithm. Those of Blender's worlds that no test film has
# (city, studio, sunrise, sunset), turned any way, with up to two lamps in the front half, have 1.5, 4 to 8, and 0.3
LIGHT_SPREAD, LIGHT_SHARPNESS, HUE_SPREAD = 1.4, 5.0, 0.25
# so much more of it, as a logarithm, comes from above than from below (1.9 in those worlds); and from the camera and
# from the sides than from straight behind the hand, as people are told to film: no skin that a film shows faces there.
# With this, films of a man and a woman and photographs of them are nearest to the truth, together
LIGHT_RISE, LIGHT_FALL = 2.0, 1.25
# what is behind the hand in the pictures lights it from there, though no skin that a film shows faces it: from within
# so many degrees of straight behind, as walls go on beyond what a telephone sees, 20 to 35 degrees to each side
BEHIND_DEG = 55.0
# how bright that is beside the light on the skin, the skin's own brightness tells, if it sends back so large a part of
# its light: the mean of channels and of skins but for dark ones, which send back down to a tenth. Hence the spread of
# the logarithm; and that of each direction about it, as walls are uneven
SKIN_ALBEDO, BEHIND_SPREAD, BEHIND_NOISE = 0.33, 0.7, 0.3
# skin that turns away from the camera is brighter than the model of known light has it, as a logarithm for a cosine of
# 0: 0.17 to 0.22, 0.26 to 0.34 and 0.31 to 0.37 in two rendered films whose light is known, of dark and of light skin,
# less a fifth since the model's gloss rises as much towards grazing light as theirs. Without it that would be taken for
# light from the sides and from behind
LIMB_RGB = (0.15, 0.25, 0.3)
# the light is found from skin that faces the camera: cosines from which on it counts, and counts wholly. Towards its
# outline skin shows the wall too, and shines; that would be taken for light from behind
FACING, SQUARE = 0.5, 0.8
# what a picture says of a Gaussian's logarithm beyond this is hardly believed; each counts as so much of one that has
# nothing to do with the others, for normals and poses that are a little off are off in all of them
LOG_NOISE, INDEPENDENT = 0.15, 0.05
# precision of the logarithm of what a white card sends back: as good as known
CARD_BELIEF = 1e5
# of albedos: the same, and where two pictures disagree
ALBEDO_NOISE, ALBEDO_ROUNDS, DISAGREE = 0.12, 3, 0.12
# Gaussians around one, itself included, that agree on which pictures they believe: one by one they would be freckled
# where a shadow from outside lies in half of them
AROUND = 24
# gloss is at most so much of what pictures show of a Gaussian, in any channel: in a shadow from outside, of which the
# world does not know, it would take more than all, and leave black skin
GLOSS_PART_MAX = 0.6
# rounds in which what a picture still lacks is given back to the Gaussians
SHARPENED = 3
# a color or an albedo below is black, one above white
LEAST, MOST = 0.004, 0.95
_NO_LAMPS = LampRows(np.ones(1), *(np.zeros((0, len(LAMP_NUMBERS))) for _ in range(2)))


@dataclass(frozen=True)
class Answer:
    """How the skin of a pose answers one light: color = albedo * matt + gloss, both (N, 3)."""

    matt: Tensor
    gloss: Tensor


@dataclass(frozen=True)
class SeenSkin:
    """What the pictures say of N Gaussians.

    albedo:      (N, 3) linear; where nothing was seen it means nothing
    reflectance: (N,) the avatar's, less where pictures show less than its gloss
    seen:        (N,) how well, in pictures: each counts 0 to 1
    world:       the film's light
    """

    albedo: Tensor
    reflectance: Tensor
    seen: Tensor
    world: World


@dataclass(frozen=True)
class Origin:
    """What is written down of where a skin comes from. name: of the film · digest: of its pictures · handedness: of the
    hand that it shows"""

    name: str
    digest: str
    handedness: Handedness


class LitFilm:
    """The light that falls on the hand of each picture."""

    def __init__(self, avatar: HandAvatar, observed: Observations) -> None:
        learned = avatar.learned
        assert learned is not None
        assert learned.response is not None
        hand = HandTensors.of(avatar)
        assert hand.learned is not None
        assert hand.learned.cast is not None
        self._cast: CastTensors = hand.learned.cast
        self.response = ResponseTensors.of(learned.response, torch.float32)
        self._patches = Patches.of(self._cast.anchors)
        self._directions = torch.from_numpy(lamp_directions(CELLS)).float()
        self.observed = observed
        _, around = KDTree(avatar.position_m).query(avatar.position_m, k=min(AROUND, len(avatar)))
        self.around = torch.from_numpy(np.asarray(around))
        self._anchors, self._visible = zip(*(self._seen_of_world(one) for one in observed.shown), strict=True)

    @torch.no_grad()
    def _seen_of_world(self, one: Shown) -> tuple[Skin, Tensor]:
        """Anchors of a pose, root-relative, and what they see of the cells (A, CELLS)."""
        around, ends_m = posed_anchors(self._cast, one.bones)
        anchors, flesh = Skin(*around), Flesh.of(self._cast, ends_m, one.bones.scale)
        half_width = torch.full((1, 1), LAMP_HALF_WIDTH)
        return anchors, past_flesh(anchors, flesh, self._directions[None], FLESH_SOFTNESS, half_width)

    def reach(self, count: int) -> tuple[Tensor, Tensor]:
        """(F, count, CELLS) how the first Gaussians take each cell's light themselves, and from skin that is white."""
        cast, ways, patches = self._cast.prefix(count), self._directions.T, self._patches
        again = float(self.response.bounce.mean())
        own, thrown = [], []
        for one, anchors, visible in zip(self.observed.shown, self._anchors, self._visible, strict=True):
            cosine = (anchors.normal @ ways).clamp_min(0)
            hidden = (cosine * (1 - visible)).sum(1, keepdim=True) / cosine.sum(1, keepdim=True)
            # thrown to and fro as by skin of a mean color; `beyond` has the rest
            thrown_back = patches.mean(cosine * visible / (1 - again * hidden))
            bounced = patches.evened(patches.faced(anchors, hidden) @ thrown_back, hidden)
            own.append((one.normal[:count] @ ways).clamp_min(0) * cast.anchors.spread(visible))
            thrown.append(cast.anchors.spread(bounced))
        return torch.stack(own), torch.stack(thrown)

    @torch.no_grad()
    def answers(self, world: World, reflectance: Tensor | None = None) -> list[Answer]:
        """Of the skin of each picture, as the renderer finds them. reflectance: (N,); None: the avatar's"""
        response = self.response if reflectance is None else replace(self.response, reflectance=reflectance)
        return [self._answer(number, SceneLight(world), response) for number in range(len(self.observed))]

    def _answer(self, number: int, light: SceneLight, response: ResponseTensors) -> Answer:
        one, anchors = self.observed.shown[number], self._anchors[number]
        count, white = len(one.position_m), torch.ones_like(one.position_m)
        at_anchors, at_skin = torch.zeros(0, len(self._cast.anchors)), torch.zeros(0, count)
        fallen = Shadows(self._patches, self._visible[number], at_anchors, at_skin)
        skin, eye_m = Skin(one.position_m - one.bones.root_m, one.normal), -one.bones.root_m
        got = reached(self._cast, anchors, fallen, light, _NO_LAMPS, response)
        lit = matt(white, skin, got, light, _NO_LAMPS, response, one.shade)
        return Answer(lit, towards_eye(torch.zeros_like(white), skin, eye_m, got, light, _NO_LAMPS, response))


def film_light(film: LitFilm) -> tuple[World, list[Answer]]:
    """The world that the hand stands in, and how skin with the avatar's gloss answers it."""
    observed, count = film.observed, min(LIGHT_GAUSSIANS, film.observed.color.shape[1])
    color, cosine = observed.color[:, :count], torch.stack([one.facing[:count] for one in observed.shown])
    squarely = ((cosine - FACING) / (SQUARE - FACING)).clamp(0, 1)
    weight = counted(observed.seen[:, :count] * squarely * observed.trust[:, :count])
    # what the cells do not say of how skin answers: the pose's shade, and all that the renderer does beyond
    limb = (1 - cosine)[..., None] * torch.tensor(LIMB_RGB)
    beyond = torch.stack([one.shade[:count] for one in observed.shown]) * film.response.shade_gain
    own, thrown = film.reach(count)
    ways, gloss = lamp_directions(CELLS), torch.zeros_like(color)
    precision = _precision(ways)
    likely = torch.from_numpy(likely_light(ways)).float()[:, None].expand(CELLS, 3)
    wall, belief = _of_wall(film.observed.behind, ways)
    log_light, world, answers = likely, World.of_cells(likely.exp().double().numpy()), []
    for _ in range(LIGHT_ROUNDS):
        skin = (color - gloss).clamp_min(LEAST).log()
        target, exposure = skin - beyond - limb, (weight[..., None] * skin).sum() / (3 * weight.sum())
        seen = wall - exposure + np.log(SKIN_ALBEDO)
        for _ in range(LIGHT_STEPS):
            held = precision @ _by_channel(likely - log_light) + belief @ _by_channel(seen - log_light)
            found = _normal_equations(log_light, target, weight, (own, thrown, film.response.bounce))
            step = torch.linalg.solve(precision + belief + found[0], held + found[1]).reshape(3, CELLS).T.float()
            log_light = log_light + step * (STEP_MAX / step.abs().max().clamp_min(STEP_MAX))
        world = World.of_cells(log_light.exp().double().numpy())
        answers = film.answers(world)
        gloss = torch.stack([answer.gloss[:count] for answer in answers])
        matt_rgb = torch.stack([answer.matt[:count] for answer in answers]).clamp_min(LEAST)
        beyond = matt_rgb.log() - _taken(log_light, own, thrown, film.response.bounce)
    return world, answers


def likely_light(ways: np.ndarray) -> np.ndarray:
    """(L,) logarithms of the light from directions (L, 3), before anything is seen: towards the camera is +z, up in its
    pictures +y."""
    return LIGHT_RISE / 2 * ways[:, 1] + LIGHT_FALL * np.minimum(ways[:, 2], 0)


def _of_wall(behind: Tensor | None, ways: np.ndarray) -> tuple[Tensor, Tensor]:
    """Logarithm (CELLS, 3) of the light from directions (CELLS, 3) where all is as bright as what is behind the hand,
    (3,), and the precision with which that is known, (3 CELLS, 3 CELLS), channel by channel; 0 where nothing is."""
    if behind is None:
        return torch.zeros(CELLS, 3), torch.zeros(3 * CELLS, 3 * CELLS).double()
    solid_angle = torch.from_numpy(World(np.ones((CELL_ROWS, 2 * CELL_ROWS, 3))).terms.light).float()
    wall = np.tile(ways[:, 2] < -np.cos(np.radians(BEHIND_DEG)), 3)
    count, precision = wall.sum(), np.zeros((3 * CELLS, 3 * CELLS))
    spread = BEHIND_SPREAD**2 * np.ones((count, count)) + BEHIND_NOISE**2 * np.eye(count)
    precision[np.ix_(wall, wall)] = np.linalg.inv(spread)
    return (behind.clamp_min(LEAST) * solid_angle).log(), torch.from_numpy(precision)


def _by_channel(values: Tensor) -> Tensor:
    """(3 CELLS,) double, of (CELLS, 3)."""
    return values.T.reshape(-1).double()


def _taken(log_light: Tensor, own: Tensor, thrown: Tensor, bounce: Tensor) -> Tensor:
    """(F, S, 3) logarithm of what a white card in the place of each Gaussian sends back."""
    light = log_light.exp()
    each = [(own + bounce[channel] * thrown) @ light[:, channel] for channel in range(3)]
    return (torch.stack(each, -1) / np.pi).clamp_min(LEAST).log()


def _normal_equations(
    log_light: Tensor, target: Tensor, weight: Tensor, reach: tuple[Tensor, Tensor, Tensor]
) -> tuple[Tensor, Tensor]:
    """Of a step of Gauss and Newton, channel by channel: matrix (3 CELLS, 3 CELLS) and right side (3 CELLS,), double as
    single precision is too little for their numbers. target: (F, S, 3) logarithm of albedo times light · weight:
    (F, S)"""
    own, thrown, bounce = reach
    matrix, right = torch.zeros(3 * CELLS, 3 * CELLS).double(), torch.zeros(3 * CELLS).double()
    for channel in range(3):
        part = (own + bounce[channel] * thrown) * log_light[:, channel].exp()
        got = part.sum(-1, keepdim=True).clamp_min(1e-6)
        slope, card = part / got, (got[..., 0] / np.pi).log()
        here = slice(channel * CELLS, (channel + 1) * CELLS)
        # a white card is white on average
        moves, level = (weight[..., None] * slope).sum((0, 1)).double(), (weight * card).sum().double()
        moves, level = moves / weight.sum(), level / weight.sum()
        matrix[here, here] += CARD_BELIEF * torch.outer(moves, moves)
        right[here] -= CARD_BELIEF * level * moves
        rest, believed = target[..., channel] - card, weight
        for _ in range(2):
            whole = believed.sum(0).clamp_min(1e-6)
            left = rest - (believed * rest).sum(0) / whole
            believed = weight / (1 + (left / LOG_NOISE).square())
        # the albedo, whatever it is, drops out with each Gaussian's mean
        whole = believed.sum(0).clamp_min(1e-6)
        left = rest - (believed * rest).sum(0) / whole
        slope = slope - (believed[..., None] * slope).sum(0) / whole[:, None]
        rows = (slope * believed.sqrt()[..., None]).reshape(-1, CELLS)
        much = INDEPENDENT / LOG_NOISE**2
        matrix[here, here] += much * (rows.T @ rows).double()
        right[here] += much * (rows.T @ (left * believed.sqrt()).reshape(-1)).double()
    return matrix, right


def _precision(directions: np.ndarray) -> Tensor:
    """(3 CELLS, 3 CELLS) of logarithms of light, channel by channel; the mean of each is free."""
    alike = np.exp(LIGHT_SHARPNESS * (directions @ directions.T - 1)) + 1e-3 * np.eye(CELLS)
    among = LIGHT_SPREAD**2 * np.ones((3, 3)) + HUE_SPREAD**2 * np.eye(3)
    free = 1e3 * np.kron(np.eye(3), np.ones((CELLS, CELLS)))
    return torch.from_numpy(np.linalg.inv(np.kron(among, alike) + free))


@dataclass(frozen=True, eq=False)
class OwnHand:
    """
    avatar: of the film's hand, lit by any scene
    seen:   (N,) how well its Gaussians were seen, in pictures
    world:  the film's light, around the hand of its pictures, which is a right one in every case
    """

    avatar: HandAvatar
    seen: np.ndarray
    world: World


def skin_from(observed: Observations, avatar: HandAvatar, origin: Origin) -> OwnHand:
    """The avatar with the skin of the hand in the film, lit by any scene, and the film's light, its own.

    avatar: in the shape of the hand, of known light
    """
    lit = LitFilm(avatar, observed)
    found = seen_skin(lit, torch.tensor(avatar.opacity))
    learned = avatar.learned
    assert learned is not None
    assert learned.response is not None
    seen, albedo = found.seen.double().numpy(), found.albedo.double().numpy()
    rgb = np.clip(whole_skin(avatar, albedo, seen), LEAST, MOST)
    cells = found.world.terms.light
    if origin.handedness is Handedness.LEFT:
        # pictures were mirrored; so are the directions of the second half of the cells, of those of the first
        cells = np.roll(cells, CELLS // 2, 0)
    reflectance = found.reflectance.numpy().astype(np.float32)
    response = replace(
        learned.response,
        bounce=thrown_back(avatar, rgb),
        reflectance=reflectance,
        trained_on={},
        film_light=cells.astype(np.float32),
    )
    sizes_m = [float(-one.position_m[:, 2].mean()) / one.camera.fx for one in observed.shown]
    # two fifths of the pictures have finer pixels
    pixel_m = float(np.quantile(sizes_m, 0.4))
    info = replace(
        avatar.info,
        name=f"Hand of {origin.name}",
        license=f"{avatar.info.license}; skin: the user's own",
        learned_from=LearnedFrom(origin.name, "film", len(observed), origin.digest, pixel_m),
    )
    own = replace(
        avatar.for_hand(origin.handedness),
        info=info,
        rgb=rgb.astype(np.float32),
        learned=replace(learned, response=response),
        # fine marks of another skin
        detail=None,
    )
    return OwnHand(own, seen, found.world)


@torch.no_grad()
def seen_skin(film: LitFilm, opacity: Tensor) -> SeenSkin:
    """Light and albedo; where few photographs disagree, by the best of them instead of a mean. opacity: (N,) of the
    Gaussians"""
    observed = film.observed
    best = len(observed) < FEW_PICTURES
    world, answers = film_light(film)
    weight, color = counted(observed.seen * observed.trust), list(observed.color)
    reflectance = _reflectance(film, answers, weight)
    answers = film.answers(world, reflectance)
    albedo = _albedo(color, answers, weight, film.around, best=best)
    known = (weight.sum(0) > 0)[:, None]
    for _ in range(SHARPENED):
        # what no picture shows has the color of the rest: it shines through gaps
        shown = torch.where(known, albedo, albedo[known[:, 0]].median(0).values)
        color = []
        for one, answer in zip(observed.shown, answers, strict=True):
            drawn = shown * answer.matt + answer.gloss
            with torch.enable_grad():
                missing, _ = one.given_back(drawn, opacity)
            color.append(drawn + missing)
        albedo = _albedo(color, answers, weight, film.around, best=best)
    return SeenSkin(albedo, reflectance, weight.sum(0), world)


def _reflectance(film: LitFilm, answers: list[Answer], counts: Tensor) -> Tensor:
    """(N,) the avatar's, lower where its gloss would be more than its part. counts: (F, N) of the pictures"""
    gloss = (counts[..., None] * torch.stack([answer.gloss for answer in answers])).sum(0)
    most = GLOSS_PART_MAX * (counts[..., None] * film.observed.color).sum(0)
    return film.response.reflectance * (most / gloss.clamp_min(1e-12)).amin(1).where(gloss[:, 0] > 0, 1).clamp(0, 1)


def _albedo(color: list[Tensor], answers: list[Answer], counts: Tensor, around: Tensor, *, best: bool) -> Tensor:
    """(N, 3) from colors (N, 3) in F pictures, each of which counts so much (F, N): their mean, pictures left out that
    disagree there with the others. around: (N, A) who else is there"""
    each = torch.stack([
        ((mean - answer.gloss) / answer.matt.clamp_min(LEAST)).clamp(LEAST, MOST).log()
        for mean, answer in zip(color, answers, strict=True)
    ])  # fmt: skip
    believed = counts
    middle = each[0]
    for _ in range(ALBEDO_ROUNDS):
        middle = (believed[..., None] * each).sum(0) / believed.sum(0).clamp_min(1e-6)[:, None]
        apart = counts * (each - middle).mean(-1)
        apart = torch.stack([one[around].sum(1) / much[around].sum(1).clamp_min(1e-6)
                             for one, much in zip(apart, counts, strict=True)])  # fmt: skip
        believed = counts / (1 + (apart / ALBEDO_NOISE).square())
    if best:
        one = each[counts.argmax(0), torch.arange(counts.shape[1])]
        weight = counts[..., None]
        apart = (weight * (each - middle).square()).sum(0) / weight.sum(0).clamp_min(1e-6)
        middle = torch.where(apart.amax(1, keepdim=True) > DISAGREE**2, one, middle)
    return middle.exp()
