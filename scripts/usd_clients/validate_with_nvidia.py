"""NVIDIA's USD validator on stages, with its rule for Gaussian splats, which its command line leaves out.

    python validate_with_nvidia.py FILE...

Runs in the environment of the clients. Prints JSON: for every file the issues of the splat rule (VG.035), and those of
the rules that the command line runs, by severity.
"""

from __future__ import annotations

import json
import logging
import sys

import usd_validation_nvidia as nvidia  # pyright: ignore[reportMissingImports]
from pxr import Usd
from usd_validation_nvidia.rules import _gaussian_splat  # pyright: ignore[reportMissingImports]

SEVERITIES = ("ERROR", "FAILURE", "WARNING", "INFO")


def issues(path: str, *, of_splats: bool) -> dict[str, list[str]]:
    """The messages of one stage by severity, of the rule for splats or of the usual rules."""
    engine = nvidia.ValidationEngine(init_rules=not of_splats)
    if of_splats:
        engine.enable_rule(_gaussian_splat.GaussianSplatSchemaChecker)
    found: dict[str, list[str]] = {name: [] for name in SEVERITIES}
    # by name the usual rules look into all variants; the rule for splats wants a stage that somebody keeps
    subject = Usd.Stage.Open(path) if of_splats else path
    for issue in engine.validate(subject).issues():
        found.setdefault(issue.severity.name, []).append(str(issue.message))
    return {severity: messages for severity, messages in found.items() if messages}


if __name__ == "__main__":
    logging.disable(logging.WARNING)
    answers = {
        path: {"splats": issues(path, of_splats=True), "all": issues(path, of_splats=False)} for path in sys.argv[1:]
    }
    print(json.dumps(answers))
