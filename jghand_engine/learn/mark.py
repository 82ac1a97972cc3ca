"""What tells a folder of a training from any other. Imports nothing: jobs of a scheduler ask it, and have no torch."""

from __future__ import annotations

# held while a training runs in the folder; says with which options it began
LOCK, MARK = "lock", "training.json"
