"""What a frame did: stages run and skipped, why, how long each took, and how wrong a skip can be."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Stage:
    """One stage of a frame. `bound` says in words how far the picture can differ because of a skip."""

    name: str
    ran: bool
    milliseconds: float = 0.0
    reason: str = ""
    bound: str = ""


@dataclass
class FrameReport:
    """The receipt that comes with every picture."""

    stages: list[Stage] = field(default_factory=list)
    total_ms: float = 0.0
    invalid_gaussians: int = 0
    visible_gaussians: int = 0
    backend: str = ""
    threads: int = 1

    def ran(self, name: str, milliseconds: float, reason: str = "") -> None:
        self.stages.append(Stage(name, True, milliseconds, reason))

    def skipped(self, name: str, reason: str, bound: str) -> None:
        self.stages.append(Stage(name, False, 0.0, reason, bound))

    def as_dict(self) -> dict:
        """Plain data for JSON and for the wire."""
        return {
            "total_ms": self.total_ms,
            "backend": self.backend,
            "threads": self.threads,
            "visible_gaussians": self.visible_gaussians,
            "invalid_gaussians": self.invalid_gaussians,
            "stages": [vars(stage) for stage in self.stages],
        }
