# SPDX-License-Identifier: GPL-3.0-or-later
"""How often something that failed is tried again, and when: a few times with a rest between, then not any more.

No clock, no Blender. A driver that lost its textures may have them again a moment later; one that cannot draw at all
would fail at every redraw of a view.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..core import limits


@dataclass(frozen=True)
class Attempts:
    """failed: times in a row · again_s: not before then, on any clock that only goes forward"""

    failed: int = 0
    again_s: float = 0.0

    def allowed(self, now_s: float) -> bool:
        """Whether it may be tried now."""
        return self.failed < limits.DRAW_TRIES and now_s >= self.again_s

    def after_failure(self, now_s: float) -> Attempts:
        """It failed once more."""
        return Attempts(self.failed + 1, now_s + limits.DRAW_REST_S)

    def due_s(self) -> float | None:
        """When it is tried again; None where that is not to come."""
        return self.again_s if 0 < self.failed < limits.DRAW_TRIES else None
