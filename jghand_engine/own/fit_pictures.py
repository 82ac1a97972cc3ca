"""How well a hand explains pictures: its outline against the mask, its colors against the film's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from jghand_engine.own.fit_colors import SkinColors, skin_colors
from jghand_engine.own.fit_surface import FitSurface, Kept
from jghand_engine.own.fit_views import Sight

# where a hand covers more than this its color is compared; color is divided by no less than the second
COVERED_MIN, COVERED_FLOOR = 0.7, 0.3


@dataclass(frozen=True)
class FitPictures:
    """A hand before the pictures, with all that changes slowly as the fit goes on.

    factor: of the radii, see fit_surface.outline_factor
    """

    surface: FitSurface
    pictures: Sequence[Sight]
    kept: Kept
    factor: float

    def colors(self, joints_m: Tensor, shape: Tensor) -> SkinColors:
        """What the pictures give to the skin as joints (F, 21, 3) and shape (SHAPE_COUNT,) stand."""
        with torch.no_grad():
            posed = self.surface.posed(joints_m, shape, self.kept)
        return skin_colors(self.surface, posed, self.kept, self.pictures, self.factor)

    def errors(self, pictures: Tensor, joints_m: Tensor, shape: Tensor, colors: SkinColors | None = None) -> Tensor:
        """(B, 2) of some pictures: squared errors of the outline, and absolute ones of the color, part of the hand's
        area. joints_m: (B, 21, 3) of those. Without colors the second is 0."""
        kept = self.kept.of(pictures)
        posed = self.surface.posed(joints_m, shape, kept)
        errors = []
        for row, picture in enumerate(pictures.tolist()):
            sight = self.pictures[picture]
            rgb = self.surface.hand.rgb if colors is None else colors.of(posed.normal[row], kept.shade[row])
            drawn = self.surface.draw(posed, row, sight.view.camera, rgb.to(joints_m), self.factor)
            area = (sight.side * sight.mask).sum().clamp_min(1)
            outline = (sight.side * (drawn.alpha - sight.mask) ** 2).sum() / area
            covered = sight.side * sight.mask * (drawn.alpha.detach() > COVERED_MIN)
            shown = drawn.rgb / drawn.alpha.clamp_min(COVERED_FLOOR)[..., None]
            color = (covered * (shown - sight.rgb).abs().sum(-1)).sum() / area
            errors.append(torch.stack([outline, torch.zeros_like(color) if colors is None else color]))
        return torch.stack(errors)
