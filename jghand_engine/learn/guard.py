"""The guard: the first value that is not finite is found within the step in which it appears, and undone.

Every step one fused check reads all gradients and the whole state; only when it sees something are the tensors looked
at one by one. The last good state is a copy in memory, at most GUARD_KEEP_STEPS old: the training goes back to it and
leaves out the step that failed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

import torch

from jghand_engine.errors import JGHandError
from jghand_engine.learn.checkpoint import Snapshot
from jghand_engine.learn.trainable import Trainable

# steps between two copies of the state in memory, to which the guard goes back: a copy costs a few milliseconds
GUARD_KEEP_STEPS = 50
# ... and at the beginning, where the plan of a time budget has to find the speed
GUARD_KEEPS_AT_FIRST = (2, 5, 10, 20)
# steps that were left out, after which a training gives up: one or two happen, more are a fault of the model
GUARD_RECOVERIES_MAX = 5


def find_non_finite(figures: Mapping[str, float], training: Trainable) -> list[str]:
    """What a step left that is not finite, in the order in which it computes, such as "gradient planes.uv (2 NaN)".

    Costs one pass over memory when there is nothing.
    """
    bad = [f"figure {name} ({value})" for name, value in figures.items() if not math.isfinite(value)]
    parts = {"gradient": training.gradients(), "state": training.tensors()}
    floating = [tensor for part in parts.values() for tensor in part.values() if tensor.is_floating_point()]
    # the norm overflows for huge finite values too: then the exact look finds nothing
    if bad or not math.isfinite(float(torch.nn.utils.get_total_norm(floating))):
        bad += [found for kind, part in parts.items() for found in _in_tensors(kind, part)]
    return bad


def _in_tensors(kind: str, tensors: Mapping[str, torch.Tensor]) -> Iterator[str]:
    for name, tensor in tensors.items():
        counts = ((int(tensor.isnan().sum()), "NaN"), (int(tensor.isinf().sum()), "infinite"))
        if text := ", ".join(f"{count} {what}" for count, what in counts if count):
            yield f"{kind} {name} ({text})"


def recovered(good: Snapshot, number: int, findings: list[str], training: Trainable) -> Snapshot:
    """Puts `training` back into its last good state; that state with step `number` among those left out.

    JGHandError when that happened too often.
    """
    state = good.restore(training)
    state.skipped = sorted({*state.skipped, number})
    if len(state.skipped) > GUARD_RECOVERIES_MAX:
        raise JGHandError(
            f"{len(state.skipped)} steps of the training gave values that are not finite, "
            f"at last step {number}: {findings[0]}",
            remedy="Look at the pictures with `jghand check-data`.",
        )
    return replace(good, state=state)
