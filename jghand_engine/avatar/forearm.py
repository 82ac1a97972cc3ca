"""Where a hand ends: its opacity fades out along the forearm, or at the wrist, instead of ending in a cut.

It follows from the canonical place of each Gaussian alone, and is laid on an avatar that is to be seen: in pictures,
exports, pages and views alike. What is measured against pictures (`jghand evaluate`) is not faded.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jghand_engine.avatar.avatar import FOREARM_WAY, HandAvatar
from jghand_engine.avatar.end_cap import GAUSSIANS, Dome, EndCap, rising, with_cap

# identifiers of the built-in hand's templates begin so
BUILTIN_TEMPLATE = "makehuman-soma-right-1"
MANO_TEMPLATES = "mano-"
# before the end of a forearm: the ends of its fade, meters. Skin rounds off behind them
FOREARM_FADE_M = (0.010, 0.030)
# of the places farthest along a forearm so many do not say where it ends: some may have strayed
STRAYS = 1 / 1000
# Gaussians go on so far behind a surface that ends the hand: they are its color, in which faint ones would leave holes
BEYOND_M = 0.012
# across the cut at the wrist of the built-in hand, and where it lies. What closed it is up to 3 mm before the cut, as
# deep as Gaussians are under the skin, and is not seen at all
WRIST_WAY, WRIST_CUT_M = np.array([-0.0788, 0.9616, 0.2629]), -0.0031
WRIST_FADE_M = (0.003, 0.015)
# cosine to the eye from which on skin is drawn: a fifth of the raster is saved, and pictures stay as they are. All is
# drawn so far, meters, before its end: few Gaussians lie there, whose gaps those of the far side close
HIDDEN_FROM, OPEN_M = -0.3, 0.05
# of the Gaussians of a cap
CAP_OPACITY = 0.95
# about so many Gaussians lie over one another in a hand's skin: each fades sooner, so that all together fade evenly
LAYERS = 6


def ended(avatar: HandAvatar, *, forearm: bool = True) -> HandAvatar:
    """The avatar as it is shown: faded out at the end of its forearm, or, without one or where it is not wanted, at the
    wrist. An avatar on an unknown template stays as it is."""
    end = _end_of(avatar, forearm=forearm)
    if end is None:
        return avatar
    if not forearm:
        # its mesh is the hand's alone
        avatar = avatar.with_stiff_wrist()
    way, end_m, fade_m = end
    detail = avatar.detail
    beyond_m = BEYOND_M if detail is not None and detail.ends_hand else 0.0
    parts = rising(avatar.position_m @ way - end_m + beyond_m, *fade_m)
    opacity = avatar.opacity * of_each_layer(parts, LAYERS).astype(np.float32)
    if detail is not None:
        # what is not there hides nothing behind it
        whole = rising(detail.position_m @ way - end_m, *fade_m).astype(np.float32)
        stays = (whole > 0)[detail.faces].any(1)
        detail = replace(detail, faces=detail.faces[stays], face_uv=detail.face_uv[stays], whole=whole)
    return replace(avatar, opacity=opacity, detail=detail)


def of_each_layer(parts: np.ndarray, layers: int) -> np.ndarray:
    """(N,) opacity of each of so many that lie over one another and have that of `parts` (N,) all together."""
    return 1 - (1 - parts) ** (1 / layers)


def capped(avatar: HandAvatar) -> HandAvatar:
    """A hand that is shown (`ended`) with a cap, in rows behind those of its anchors, which lie on the first ones.
    One that no surface ends stays as it is."""
    detail, learned, end = avatar.detail, avatar.learned, _end_of(avatar, forearm=avatar.has_forearm)
    if detail is None or not detail.ends_hand or detail.whole is None or learned is None or end is None:
        return avatar
    way, end_m, (none_m, _) = end
    dome = Dome(detail.position_m, -way, -(end_m + none_m))
    skin_m, normal, sigma_m = dome.gaussians()
    position_m = (skin_m - detail.depth_m * normal).astype(np.float32)
    # in all else they are as their neighbors in the skin
    edge = dome.apart_m(avatar.position_m).argsort()[:GAUSSIANS]
    near = edge[np.square(position_m[:, None] - avatar.position_m[edge]).sum(-1).argmin(1)]
    # a short prefix has fewer than anchors
    first = 0 if learned.cast is None else min(len(learned.cast.anchors), len(avatar))
    rows, own = slice(first, first + GAUSSIANS), np.arange(len(avatar))
    more = avatar.rows(np.concatenate([own[:first], near, own[first:]]))
    assert more.learned is not None, "rows of an avatar have what it has"
    for array, values in (
        (more.position_m, position_m),
        (more.sigma_m, sigma_m),
        (more.opacity, CAP_OPACITY),
        (more.learned.normal, normal),
    ):
        array[rows] = values
    weights = avatar.map_weights(skin_m, more.bone_weights[rows]).mean(0)
    cap = EndCap(rows, weights, skin_m.mean(0) - avatar.canonical_joints_m[0], dome.way)
    return replace(more, detail=with_cap(detail, dome), cap=cap)


def hidden_from(position_m: np.ndarray, opacity: np.ndarray, cap: EndCap | None = None) -> np.ndarray:
    """(N,) float32 cosines to the eye up to which skin that faces away is not drawn, as skin before it hides it, of
    canonical places (N, 3), meters. opacity: (N,), 0 behind the end of the hand · cap: which the eye does not see"""
    along_m = position_m @ FOREARM_WAY
    end_m = np.quantile(along_m[opacity > 0], 1 - STRAYS) if (opacity > 0).any() else 0.0
    hidden = np.where(along_m > end_m - OPEN_M, -2, HIDDEN_FROM).astype(np.float32)
    if cap is not None:
        hidden[cap.rows] = 2  # no cosine is larger
    return hidden


def _end_of(avatar: HandAvatar, *, forearm: bool) -> tuple[np.ndarray, float, tuple[float, float]] | None:
    """The way from where it ends into it (3,), where its end is along that, meters, and how far before it nothing and
    all is shown; None: it is shown wherever it is."""
    if forearm and avatar.has_forearm:
        return -FOREARM_WAY, float(np.quantile(avatar.position_m @ -FOREARM_WAY, STRAYS)), FOREARM_FADE_M
    if avatar.info.template.startswith(BUILTIN_TEMPLATE):
        return WRIST_WAY, WRIST_CUT_M, WRIST_FADE_M
    if avatar.info.template.startswith(MANO_TEMPLATES):
        # its hand ends square to the bones, and somewhere else in each file
        return np.array([0.0, 1.0, 0.0]), avatar.position_m[:, 1].min(), WRIST_FADE_M
    return None
