# SPDX-License-Identifier: GPL-3.0-or-later
"""The check of the engine: which one was found and how, what it says of itself, what is missing, and the one thing that
mends it. It asks the engine's Python in a process of its own, with a time limit, in a thread. Does not use bpy."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..core import limits
from ..core.wire import protocol
from ..errors import ADVICE, JGHandFailure
from .engine_command import FoundEngine
from .process import cleaned_environment
from .programs import HIDDEN, in_terminal

# what a picture needs, and what the engine's command line needs besides
PACKAGES = ("numpy", "torch", "safetensors", "PIL", "scipy", "tyro", "rich", "pxr", "trimesh")
_MARK = "JGHAND CHECK "
# what a terminal calls any Python
_ANY_PYTHON = "py" if os.name == "nt" else "python3"
# asks a Python about itself; runs there, with nothing but its own packages
_PROBE = f"""
import importlib, json, sys
facts = {{"python": sys.version.split()[0], "packages": {{}}, "missing": [], "broken": {{}}}}
for name in {PACKAGES!r}:
    try:
        facts["packages"][name] = str(getattr(importlib.import_module(name), "__version__", ""))
    except Exception as error:
        if isinstance(error, ModuleNotFoundError) and error.name == name:
            facts["missing"].append(name)
        else:
            facts["broken"][name] = str(error)
try:
    import jghand_engine
    from jghand_engine.service import protocol
    facts["engine"], facts["protocol"] = jghand_engine.__version__, protocol.PROTOCOL_VERSION
    if not facts["missing"] and not facts["broken"]:
        from jghand_engine.native import library
        chosen = library.load()
        facts["kernels"] = chosen.variant if chosen else ""
except Exception as error:
    if not (isinstance(error, ModuleNotFoundError) and error.name == "jghand_engine"):
        facts["broken"]["jghand_engine"] = str(error)
print({_MARK!r} + json.dumps(facts))
"""


@dataclass(frozen=True)
class Finding:
    """One line of the result. good: whether it is as it should be."""

    label: str
    value: str
    good: bool = True


@dataclass(frozen=True)
class CheckResult:
    """findings: what there is · failure: a key of messages.ADVICE, "" when all is well · detail: what was wrong, small
    print · mend: a command for a terminal, or "" · where: in which folder it is to be run, in words, or "" """

    findings: tuple[Finding, ...]
    failure: str = ""
    detail: str = ""
    mend: str = ""
    where: str = ""

    @property
    def good(self) -> bool:
        """Whether the engine can be used."""
        return not self.failure

    @property
    def sentence(self) -> str:
        """What an artist reads first."""
        return "The engine is ready to be used" if self.good else ADVICE[self.failure].sentence

    @property
    def remedy(self) -> str:
        """What to do about it; `mend` is the same as a command, where there is one."""
        return "" if self.good else ADVICE[self.failure].remedy


class EngineCheck:
    """A check on its way: `result` is None until it is done. `close` ends it."""

    def __init__(
        self,
        find: Callable[[], FoundEngine],
        *,
        checkout: Path | None = None,
        environment: Mapping[str, str] = os.environ,
        timeout_s: float = limits.CHECK_S,
    ) -> None:
        """find: called at once, in this thread; may raise JGHandFailure. checkout: JGHand's folder, if it is known."""
        self.result: CheckResult | None = None
        self._environment, self._timeout_s = environment, timeout_s
        self._checkout = checkout if checkout is not None and (checkout / "pyproject.toml").is_file() else None
        self._process: subprocess.Popen[bytes] | None = None
        self._closed = False
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        try:
            found = find()
        except JGHandFailure as failure:
            self.result = self._not_found(failure)
            return
        except (OSError, ValueError) as error:
            self.result = self._not_found(JGHandFailure("no_interpreter", str(error)))
            return
        self._thread = threading.Thread(target=self._work, args=(found,), daemon=True, name="jghand check")
        self._thread.start()

    @property
    def over(self) -> bool:
        """Whether nothing more will come."""
        return self.result is not None or self._thread is None or not self._thread.is_alive()

    def wait(self, timeout_s: float) -> CheckResult | None:
        """Waits for the result, at most so long."""
        if self._thread is not None:
            self._thread.join(timeout_s)
        return self.result

    def close(self) -> None:
        """Ends the check; without a result, when there is none yet."""
        with self._lock:
            self._closed = True
            if self._process is not None:
                with contextlib.suppress(OSError):
                    self._process.kill()

    def _work(self, found: FoundEngine) -> None:
        if found.python is None:
            unknown = Finding("Python", "not known, so it is not looked at: start the engine to see", False)
            self.result = CheckResult((*_of(found), unknown), "unknown_engine")
            return
        try:
            code, output = self._ask(found.python)
            if not self._closed:
                self.result = self._judge(found, code, output)
        except OSError as error:
            self.result = CheckResult(_of(found), "no_interpreter", f"{found.python}: {error.strerror or error}")
        except subprocess.TimeoutExpired:
            self.result = CheckResult(_of(found), "start_timeout", f"no answer within {self._timeout_s:.0f} s")

    def _ask(self, python: str) -> tuple[int, str]:
        with self._lock:
            if self._closed:
                return 1, ""
            self._process = subprocess.Popen(
                [python, "-I", "-c", _PROBE],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                env=cleaned_environment(self._environment),
                creationflags=HIDDEN,
            )
        process = self._process
        try:
            output, _ = process.communicate(timeout=self._timeout_s)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            raise
        return process.returncode, output.decode("utf-8", "replace")

    def _judge(self, found: FoundEngine, code: int, output: str) -> CheckResult:
        """What the answer of the engine's Python means."""
        marked = [line[len(_MARK) :] for line in output.splitlines() if line.startswith(_MARK)]
        if code or not marked:
            words = "\n".join(output.strip().splitlines()[-limits.DETAIL_LINES :])
            return CheckResult(_of(found), "crashed", f"exit code {code}\n{words}".strip())
        facts: dict[str, Any] = json.loads(marked[-1])
        findings = (*_of(found), *_findings(facts))
        if "engine" not in facts and "jghand_engine" not in facts["broken"]:
            return self._with_mend(found, findings, "no_engine", "")
        wrong = [f"{name} is missing" for name in facts["missing"]]
        wrong += [f"{name}: {why}" for name, why in facts["broken"].items()]
        if wrong:
            return self._with_mend(found, findings, "broken_engine", "\n".join(wrong))
        if facts["protocol"] != protocol.PROTOCOL_VERSION:
            detail = f"extension {protocol.PROTOCOL_VERSION}, engine {facts['protocol']}"
            if facts["protocol"] > protocol.PROTOCOL_VERSION:
                return CheckResult(findings, "protocol", f"{detail}: install the newer extension")
            return self._with_mend(found, findings, "protocol", f"{detail}: update the engine")
        return CheckResult(findings)

    def _with_mend(self, found: FoundEngine, findings: tuple[Finding, ...], failure: str, detail: str) -> CheckResult:
        """With the command that installs the engine into the Python that was found."""
        source, where = (".", "JGHand's folder") if self._checkout is None else (str(self._checkout), "")
        command = in_terminal([str(found.python), "-m", "pip", "install", source])
        return CheckResult(findings, failure, detail, command, where)

    def _not_found(self, failure: JGHandFailure) -> CheckResult:
        """With the command that makes an engine."""
        script, where = "scripts/test.py", "JGHand's folder"
        if self._checkout is not None:
            script, where = str(self._checkout / script), ""
        nothing = (Finding("Engine", "none was found", False),)
        return CheckResult(nothing, failure.kind, failure.detail, f'{_ANY_PYTHON} "{script}" --only checks', where)


def _of(found: FoundEngine) -> tuple[Finding, ...]:
    return Finding("Found by", found.origin), Finding("Path", found.program[0])


def _findings(facts: Mapping[str, Any]) -> list[Finding]:
    """What the engine's Python says of itself, one line each."""
    packages, broken = facts["packages"], facts["broken"]
    version = tuple(int(part) for part in facts["python"].split(".")[:2])
    lines = [Finding("Python", facts["python"], version >= (3, 11))]
    if "engine" in facts:
        same = facts["protocol"] == protocol.PROTOCOL_VERSION
        lines.append(Finding("Engine", f"{facts['engine']}, protocol {facts['protocol']}", same))
    else:
        lines.append(Finding("Engine", "does not start" if "jghand_engine" in broken else "not installed", False))
    if packages.get("torch"):
        lines.append(Finding("PyTorch", packages["torch"]))
    if facts["missing"]:
        lines.append(Finding("Missing", ", ".join(facts["missing"]), False))
    others = [name for name in broken if name != "jghand_engine"]
    if others:
        lines.append(Finding("Broken", ", ".join(others), False))
    if "kernels" in facts:
        kernels = facts["kernels"]
        text = f"native kernels, {kernels}" if kernels else "no native kernels: pictures are slow"
        lines.append(Finding("Drawing", text, bool(kernels)))
    return lines
