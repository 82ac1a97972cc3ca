"""A surface that is no usable hand is refused, whatever file it came from."""

from dataclasses import replace

import numpy as np
import pytest

from jghand_engine.errors import InputError
from jghand_engine.template.builtin import load_template, load_template_with_forearm
from jghand_engine.template.mano import check_template


@pytest.mark.parametrize(
    ("field", "change", "message"),
    [
        ("faces", lambda t: np.concatenate([t.faces[:1, ::-1], t.faces[1:]]), "closed surface"),
        ("faces", lambda t: t.faces[:, ::-1], "inside-out"),
        ("faces", lambda t: np.where(t.faces == 7, 1610, t.faces), "vertex numbers 0..1609"),
        ("faces", lambda t: np.where(t.faces == 7, -1, t.faces), "vertex numbers 0..1609"),
        ("faces", lambda t: t.faces[:, [0, 1, 2, 2]], r"faces: wanted shape \(any, 3\)"),
        ("face_uv", lambda t: t.face_uv - 0.1, "coordinates 0..1"),
        ("face_uv", lambda t: t.face_uv + 0.1, "coordinates 0..1"),
        ("face_uv", lambda t: t.face_uv[1:], "UV: wanted shape"),
        ("skin_face_count", lambda t: len(t.faces) + 1, "skin faces"),
        ("skin_face_count", lambda t: 0, "skin faces"),
        ("vertices_m", lambda t: np.where(t.vertices_m > 0.1, np.nan, t.vertices_m), "vertices: wanted finite"),
        ("vertices_m", lambda t: t.vertices_m[:, :2], r"vertices: wanted shape \(any, 3\)"),
        ("bone_weights", lambda t: t.bone_weights * 0.5, "sum to 1"),
        ("bone_weights", lambda t: t.bone_weights[:, :20], "weights: wanted shape"),
        ("joints_m", lambda t: t.joints_m * 1000, "millimeters"),
        ("joints_m", lambda t: t.joints_m[::-1], "joints"),
        ("joints_m", lambda t: t.joints_m[1:], r"joints: wanted shape \(21, 3\)"),
    ],
)
def test_an_unusable_surface_is_refused_with_its_fault(field, change, message):
    template = load_template()
    with pytest.raises(InputError, match=message):
        check_template(replace(template, **{field: change(template)}))


@pytest.mark.parametrize("load", [load_template, load_template_with_forearm])
def test_the_built_in_hands_are_usable(load):
    assert check_template(load()) is load()
