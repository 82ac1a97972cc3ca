"""Is this a usable hand surface? Asked of every template, whatever file it came from."""

from __future__ import annotations

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.hand.joints import JOINT_COUNT
from jghand_engine.hand.orders import check_hand_size, check_order
from jghand_engine.template.mesh import HandTemplate
from jghand_engine.template.surface import enclosed_volume, is_closed
from jghand_engine.template.weights import check_weight_rows


def check_template(template: HandTemplate) -> HandTemplate:
    """Returns the template, or raises an InputError that names what is wrong with it."""
    name = f"template {template.identifier!r}"
    vertices, faces, joints = template.vertices_m, template.faces, template.joints_m
    expect_shape(f"{name}, vertices", vertices, (None, 3))
    expect_shape(f"{name}, faces", faces, (None, 3))
    expect_shape(f"{name}, UV", template.face_uv, (len(faces), 3, 2))
    expect_shape(f"{name}, joints", joints, (JOINT_COUNT, 3))
    expect_shape(f"{name}, weights", template.bone_weights, (len(vertices), JOINT_COUNT))
    for part, array in (("vertices", vertices), ("joints", joints), ("UV", template.face_uv)):
        if not np.isfinite(array).all():
            raise InputError(f"{name}, {part}", wanted="finite numbers", came="NaN or infinity")
    if faces.size == 0 or faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError(f"{name}, faces", wanted=f"vertex numbers 0..{len(vertices) - 1}", came="others")
    if not 0 < template.skin_face_count <= len(faces):
        raise InputError(f"{name}, skin faces", wanted=f"1..{len(faces)}", came=str(template.skin_face_count))
    if template.face_uv.min() < 0 or template.face_uv.max() > 1:
        raise InputError(f"{name}, UV", wanted="coordinates 0..1", came="others")
    if not is_closed(faces):
        raise InputError(
            f"{name}, faces", wanted="a closed surface, all faces turned alike", came="an open or torn one"
        )
    if enclosed_volume(vertices, faces) <= 0:
        raise InputError(
            f"{name}, faces", wanted="corners counter-clockwise from outside", came="an inside-out surface"
        )
    check_weight_rows(template.bone_weights, f"{name}, weights")
    check_hand_size(joints)
    check_order(joints)
    return template


def expect_shape(name: str, array: np.ndarray, shape: tuple[int | None, ...]) -> None:
    """Raises InputError unless `array` has `shape`, where None stands for any number."""
    if array.ndim != len(shape) or any(n not in (None, m) for n, m in zip(shape, array.shape, strict=True)):
        wanted = ", ".join("any" if n is None else str(n) for n in shape)
        raise InputError(name, wanted=f"shape ({wanted})", came=str(array.shape))
