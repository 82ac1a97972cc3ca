from dataclasses import dataclass

DESCRIPTION = "x"


@dataclass(frozen=True)
class Bench:
    x: int = 0
