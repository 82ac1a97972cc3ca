"""Where a hand ends: its opacity fades out along the forearm, or at the wrist, instead of ending in a cut.

It follows from the canonical place of each Gaussian alone, and is laid on an avatar that is to be seen: in pictures,
exports, pages and views alike. What is measured against pictures (`jghand evaluate`) is not faded.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from jghand_engine.avatar.avatar import FOREARM_WAY, HandAvatar

# identifiers of the built-in hand's templates begin so
BUILTIN_TEMPLATE = "makehuman-soma-right-1"
MANO_TEMPLATES = "mano-"
# along the forearm of the built-in hand, from the wrist: the ends of its fade, meters. Its skin rounds off behind them
FOREARM_FADE_M = (0.125, 0.105)
# across the cut at the wrist of the built-in hand, and where it lies. What closed it is up to 3 mm before the cut, as
# deep as Gaussians are under the skin, and is not seen at all
WRIST_WAY, WRIST_CUT_M = np.array([-0.0788, 0.9616, 0.2629]), -0.0031
WRIST_FADE_M = (0.003, 0.015)
# about so many Gaussians lie over one another in a hand's skin: each fades sooner, so that all together fade evenly
LAYERS = 6


def ended(avatar: HandAvatar, *, forearm: bool = True) -> HandAvatar:
    """The avatar as it is shown: faded out at the end of its forearm, or, without one or where it is not wanted, at the
    wrist. An avatar on an unknown template stays as it is."""
    shown_at = _shown_at(avatar, forearm=forearm)
    if shown_at is None:
        return avatar
    if not forearm:
        # its mesh is the hand's alone
        avatar = avatar.with_stiff_wrist()
    detail, opacity = avatar.detail, avatar.opacity * shown_at(avatar.position_m).astype(np.float32)
    if detail is not None:
        # what is not there hides nothing behind it
        whole = (1 - (1 - shown_at(detail.position_m)) ** LAYERS).astype(np.float32)
        stays = (whole > 0)[detail.faces].any(1)
        detail = replace(detail, faces=detail.faces[stays], face_uv=detail.face_uv[stays], whole=whole)
    return replace(avatar, opacity=opacity, detail=detail)


def _shown_at(avatar: HandAvatar, *, forearm: bool) -> Callable[[np.ndarray], np.ndarray] | None:
    """How much is shown, 0..1, at canonical places (N, 3); None: all of it, wherever it is."""
    if forearm and avatar.has_forearm:
        return lambda place: _rising(place @ FOREARM_WAY, *FOREARM_FADE_M)
    if avatar.info.template.startswith(BUILTIN_TEMPLATE):
        return lambda place: _rising(place @ WRIST_WAY - WRIST_CUT_M, *WRIST_FADE_M)
    if avatar.info.template.startswith(MANO_TEMPLATES):
        # its hand ends square to the bones, and somewhere else in each file
        end_m = avatar.position_m[:, 1].min()
        return lambda place: _rising(place[:, 1] - end_m, *WRIST_FADE_M)
    return None


def _rising(along: np.ndarray, none: float, whole: float) -> np.ndarray:
    """(N,) 0 at `none` and beyond it, 1 at `whole`; LAYERS of them cover smoothly more and more between."""
    part = ((along - none) / (whole - none)).clip(0, 1)
    return 1 - (1 - part * part * (3 - 2 * part)) ** (1 / LAYERS)
