"""The hard hands of the stability study: every singularity of the transform from joints to skin, by name. METHOD 2.10.

All are right hands of the built-in template's proportions in meters, unless their name says otherwise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import torch
from torch import Tensor

from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import named_pose
from jghand_engine.hand.skeleton import swing_pole
from jghand_engine.learn.skeleton import JointTransform
from jghand_engine.template.builtin import load_template

# distances, as parts of the hand's size, at which hands beside a singularity are tried as well
JITTERS = (1e-12, 1e-9, 1e-7, 1e-5, 1e-3)
# error of the joints whose effect on the skin is measured, meters: that of a good motion capture
NUDGE_M = 5e-4
# largest gradient times hand size (METHOD 2.11)
GRADIENT_MAX = 1e5

_THUMB, _INDEX, _MIDDLE, _RING = range(4)


@dataclass(frozen=True)
class HandCase:
    """name: in words · joints_m: (21, 3) float64, level order · handedness: as it is declared"""

    name: str
    joints_m: Tensor
    handedness: Handedness = Handedness.RIGHT

    @property
    def size_m(self) -> float:
        """Largest extent of a joint from the wrist along an axis; that of the template where all joints coincide."""
        size = float((self.joints_m - self.joints_m[:1]).abs().max())
        return size if size > 0 else template_size_m()


@cache
def template_joints_m() -> Tensor:
    """(21, 3) float64, the canonical right hand."""
    return torch.from_numpy(load_template().joints_m.copy())


@cache
def template_size_m() -> float:
    joints_m = template_joints_m()
    return float((joints_m - joints_m[:1]).abs().max())


def posed(name: str) -> Tensor:
    """(21, 3) float64 joints of a named pose."""
    return torch.from_numpy(named_pose(name, load_template().joints_m, handedness=Handedness.RIGHT).copy())


def along_finger(joints_m: Tensor, finger: int, directions: Tensor) -> Tensor:
    """The hand with one finger's phalanges along `directions` (3, 3), as long as they were."""
    moved = joints_m.clone()
    for level in range(3):
        bone, parent = 6 + 5 * level + finger, 1 + 5 * level + finger
        moved[bone] = moved[parent] + (joints_m[bone] - joints_m[parent]).norm() * directions[level]
    return moved


def metacarpal_axes(joints_m: Tensor, finger: int) -> Tensor:
    """Frame (3, 3) of a finger's metacarpal: columns out of the palm, flexion axis, along the bone."""
    return JointTransform(template_joints_m().numpy(), handedness=Handedness.RIGHT).frames(joints_m).S[finger]


def straight_finger(joints_m: Tensor, finger: int, signs: tuple[int, int, int] = (1, 1, 1)) -> Tensor:
    """A finger in line with its metacarpal; from a sign of -1 on it lies folded back on itself."""
    direction = metacarpal_axes(joints_m, finger)[:, 2]
    return along_finger(joints_m, finger, torch.tensor(signs, dtype=torch.float64)[:, None] * direction)


def bent_finger(joints_m: Tensor, finger: int, angle_rad: float) -> Tensor:
    """A straight finger with each of its three joints bent by `angle_rad`, towards the palm."""
    S = metacarpal_axes(joints_m, finger)
    angles = torch.arange(1, 4, dtype=torch.float64)[:, None] * angle_rad
    return along_finger(joints_m, finger, angles.cos() * S[:, 2] + angles.sin() * S[:, 0])


def abducted(joints_m: Tensor, finger: int, beside_rad: float = 0.0, side: int = 1) -> Tensor:
    """A finger turned sideways to `beside_rad` short of 90 degrees: there the flexion is undefined."""
    S = metacarpal_axes(joints_m, finger)
    along = side * S[:, 1] * math.cos(beside_rad) + S[:, 2] * math.sin(beside_rad)
    return along_finger(joints_m, finger, along.expand(3, 3))


def turned_back(joints_m: Tensor, finger: int, local: Tensor) -> Tensor:
    """A finger along `local` (3,) of the frame that its first phalanx has in the canonical hand's pose."""
    transform = JointTransform(template_joints_m().numpy(), handedness=Handedness.RIGHT)
    rest, bent = transform.frames(template_joints_m()).S, transform.frames(joints_m).S
    return along_finger(joints_m, finger, (bent[finger] @ rest[finger].T @ rest[5 + finger] @ local).expand(3, 3))


def backwards_sideways(joints_m: Tensor, finger: int, beside_rad: float = 0.0) -> Tensor:
    """A finger turned to where the swing has no answer (METHOD 2.5), or `beside_rad` beside it."""
    y, z = swing_pole()
    pole = torch.tensor([0.0, y * math.cos(beside_rad), z * math.cos(beside_rad)], dtype=torch.float64)
    pole[0] = math.sin(beside_rad)
    return turned_back(joints_m, finger, pole)


def flattened_palm(joints_m: Tensor, part: float) -> Tensor:
    """The hand with its knuckles (and what hangs on them) drawn to the line through the middle one, but for `part`."""
    moved = joints_m.clone()
    middle = joints_m[3] - joints_m[0]
    direction = middle / middle.norm()
    for finger in range(5):
        reach = joints_m[1 + finger] - joints_m[0]
        onto = (reach @ direction) * direction
        shift = (part - 1) * (reach - onto)
        moved[1 + finger :: 5] += shift
    return moved


def scaled_bones(joints_m: Tensor, factors: Tensor) -> Tensor:
    """The hand with every bone (20,) times its factor, directions kept."""
    moved = joints_m.clone()
    for bone in range(1, 21):
        parent = 0 if bone <= 5 else bone - 5
        moved[bone] = moved[parent] + factors[bone - 1] * (joints_m[bone] - joints_m[parent])
    return moved


def _moved(joints_m: Tensor, **places: Tensor) -> Tensor:
    moved = joints_m.clone()
    for name, place in places.items():
        moved[int(name[1:])] = place
    return moved


def _fingers() -> dict[str, Tensor]:
    base = posed("relaxed")
    straight = base
    for finger in range(5):
        straight = straight_finger(straight, finger)
    return {
        "ordinary: relaxed": base,
        "ordinary: fist": posed("fist"),
        "all fingers straight": straight,
        "index exactly straight": straight_finger(base, _INDEX),
        "index folded back at its tip joint": straight_finger(base, _INDEX, (1, 1, -1)),
        "index folded back at its middle joint": straight_finger(base, _INDEX, (1, -1, -1)),
        "index folded back at its knuckle": straight_finger(base, _INDEX, (-1, -1, -1)),
        "index folded back exactly through itself": turned_back(base, _INDEX, torch.tensor([0, 0, -1]).double()),
        "index turned backwards and sideways": backwards_sideways(base, _INDEX),
        "middle finger sideways, +90 degrees": abducted(base, _MIDDLE),
        "middle finger sideways, -90 degrees": abducted(base, _MIDDLE, side=-1),
        "middle finger sideways, 90 degrees less 1e-6": abducted(base, _MIDDLE, 1e-6),
        "thumb sideways, 90 degrees": abducted(base, _THUMB),
    }


def _palms() -> dict[str, Tensor]:
    base = posed("relaxed")
    line = torch.tensor([0.0, 0.09, 0.0], dtype=torch.float64)
    return {
        "two palm bones in line": _moved(base, j5=0.9 * base[4]),
        "two knuckles crossed": _moved(base, j2=base[3], j3=base[2]),
        "palm collapsed to a line": _moved(base, **{f"j{i}": line * (1 + 0.01 * i) for i in range(1, 6)}),
        "a knuckle at the wrist": _moved(base, j3=base[0]),
        "all knuckles at the wrist": _moved(base, **{f"j{i}": base[0] for i in range(1, 6)}),
        "a bone without length": _moved(base, j12=base[7]),
        "a finger tip without length": _moved(base, j17=base[12]),
        "a finger without length": _moved(base, j7=base[2], j12=base[2], j17=base[2]),
        "all joints at one point": torch.full((21, 3), 0.3, dtype=torch.float64),
        "all joints on a line": torch.outer(torch.arange(21), torch.tensor([0.01, 0, 0])).double(),
    }


def _places_and_units() -> dict[str, Tensor]:
    base = posed("relaxed")
    up_down = torch.where(torch.arange(20) % 2 == 0, 1.5, 0.5).double()
    generator = torch.Generator().manual_seed(0)
    cloud = 0.06 * torch.randn(21, 3, dtype=torch.float64, generator=generator)
    return {
        "millimeters": base * 1e3,
        "kilometers": base * 1e-3,
        "units of 1e12": base * 1e12,
        "units of 1e-12": base * 1e-12,
        "10 m from the origin": base + 10.0,
        "1 km from the origin": base + 1000.0,
        "turned upside down": base * torch.tensor([1.0, -1.0, -1.0], dtype=torch.float64),
        "all bones +50 %": scaled_bones(base, torch.full((20,), 1.5, dtype=torch.float64)),
        "all bones -50 %": scaled_bones(base, torch.full((20,), 0.5, dtype=torch.float64)),
        "bones +50 % and -50 % in turn": scaled_bones(base, up_down),
        "random points that are no hand": cloud,
        "mirrored hand declared as a right one": mirrored(base),
    }


def mirrored(joints_m: Tensor) -> Tensor:
    return joints_m * torch.tensor([-1.0, 1.0, 1.0], dtype=joints_m.dtype)


@cache
def hand_cases() -> dict[str, HandCase]:
    joints = _fingers() | _palms() | _places_and_units()
    cases = {name: HandCase(name, joints_m) for name, joints_m in joints.items()}
    cases["left hand"] = HandCase("left hand", mirrored(posed("relaxed")), Handedness.LEFT)
    return cases


def beside(case: HandCase, count: int) -> Tensor:
    """The hand itself and `count` hands at each of some distances from it, (N, 21, 3): singularities hide beside their
    exact places, too. Units and places far away are left as they are."""
    here = case.joints_m[None]
    if case.name.startswith(("units", "millimeters", "kilometers")) or "origin" in case.name:
        return here
    generator = torch.Generator().manual_seed(len(case.name))
    near = [
        case.joints_m + part * case.size_m * torch.randn(count, 21, 3, dtype=torch.float64, generator=generator)
        for part in JITTERS
    ]
    return torch.cat([here, *near])
