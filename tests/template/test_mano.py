"""MANO's own file becomes a template. Tried on a made-up hand in a file of the same structure: MANO itself may not be
passed on."""

import pickle

import numpy as np
import pytest
from mano_samples import (
    FILE_FROM_CANONICAL,
    FILE_ROOT,
    FLEXION_RAD,
    Thing,
    mano_fields,
    mano_objects,
    python2_pickle,
    sock,
)

from jghand_engine.errors import InputError
from jghand_engine.hand.orders import bone_lengths
from jghand_engine.template.builtin import load_template
from jghand_engine.template.mano import load_mano, read_mano
from jghand_engine.template.surface import is_closed


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("mano")
    (folder / "MANO_RIGHT.pkl").write_bytes(python2_pickle(mano_objects(mano_fields())))
    (folder / "MANO_LEFT.pkl").write_bytes(python2_pickle(mano_objects(mano_fields(left=True))))
    return folder


@pytest.fixture(scope="module")
def flat(folder):
    """Of a file whose mean hand is flat."""
    fields = mano_fields()
    (folder / "flat.pkl").write_bytes(python2_pickle(mano_objects(fields | {"hands_mean": np.zeros(45)})))
    return load_mano(folder / "flat.pkl")


@pytest.mark.parametrize("protocol", [0, 2])
def test_every_array_comes_back_exactly(tmp_path, protocol):
    fields = mano_fields()
    path = tmp_path / "MANO_RIGHT.pkl"
    path.write_bytes(python2_pickle(mano_objects(fields), protocol))
    read = read_mano(path)
    for name, array in fields.items():
        np.testing.assert_allclose(read[name], array, rtol=1e-14, atol=0, err_msg=name)


def test_arrays_of_any_order_written_by_any_python_are_read(tmp_path):
    fields = mano_fields()
    other = {name: np.asfortranarray(array).astype(array.dtype.newbyteorder(">")) for name, array in fields.items()}
    for protocol in range(5):
        path = tmp_path / f"protocol{protocol}.pkl"
        path.write_bytes(pickle.dumps(other, protocol=protocol))
        read = read_mano(path)
        for name, array in fields.items():
            np.testing.assert_allclose(read[name], array, rtol=1e-14, atol=0, err_msg=f"{name}, protocol {protocol}")


def test_the_flat_hand_lies_in_the_canonical_frame(flat):
    # worst observed 7e-16 m
    np.testing.assert_allclose(flat.joints_m, load_template().joints_m, atol=1e-14)
    expected = mano_fields()["v_template"]
    np.testing.assert_allclose((expected - FILE_ROOT) @ FILE_FROM_CANONICAL, flat.vertices_m[:-1], atol=1e-14)


def test_the_wrist_is_closed_by_a_fan(flat):
    assert is_closed(flat.faces)
    assert len(flat.faces) == flat.skin_face_count + 16
    np.testing.assert_allclose(flat.vertices_m[-1], sock()[0][:16].mean(axis=0), atol=1e-14)
    assert flat.bone_weights[-1, 0] == 1


def test_a_joint_s_weight_goes_to_the_bone_that_starts_there(flat):
    # MANO's joints 3, 6, 12, 9, 15 are the last of index, middle, ring, pinky, thumb; there our last bones start
    for vertex, bone in zip((317, 444, 556, 673, 745), (17, 18, 19, 20, 16), strict=True):
        assert flat.bone_weights[vertex, bone] == 1


def test_a_left_hand_becomes_the_same_right_hand(folder):
    right = load_mano(folder / "MANO_RIGHT.pkl")
    left = load_mano(folder / "MANO_LEFT.pkl")
    np.testing.assert_allclose(left.joints_m, right.joints_m, atol=1e-15)
    np.testing.assert_allclose(left.vertices_m, right.vertices_m, atol=1e-15)
    assert np.array_equal(left.faces, right.faces)


def test_what_rounding_left_of_a_row_of_weights_does_not_move_the_skin(folder, tmp_path):
    fields = mano_fields()
    fields["weights"] = fields["weights"] * (1 + 9e-4 * np.linspace(-1, 1, 778))[:, None]
    (tmp_path / "rounded.pkl").write_bytes(python2_pickle(mano_objects(fields)))
    one, other = (load_mano(p) for p in (tmp_path / "rounded.pkl", folder / "MANO_RIGHT.pkl"))
    # worst observed 1e-16 m; not normalized it would be 1e-4 m
    np.testing.assert_allclose(one.vertices_m, other.vertices_m, atol=1e-15)


def test_the_mean_pose_bends_the_fingers(folder, flat):
    mean = load_mano(folder / "MANO_RIGHT.pkl")
    bones = [mean.joints_m[20 - k] - mean.joints_m[15 - k] for k in range(4)]
    straight = [flat.joints_m[20 - k] - flat.joints_m[15 - k] for k in range(4)]
    turn = 3 * FLEXION_RAD
    rotation = np.array([[1, 0, 0], [0, np.cos(turn), -np.sin(turn)], [0, np.sin(turn), np.cos(turn)]])
    np.testing.assert_allclose(bones, straight @ rotation.T, atol=1e-12)
    np.testing.assert_allclose(bone_lengths(mean.joints_m), bone_lengths(flat.joints_m), atol=1e-12)


def test_pose_corrections_move_the_skin_of_a_bent_hand_only(tmp_path):
    fields = mano_fields()
    fields["posedirs"][100, 2, 4] = 1e-3  # vertex 100 follows the second entry of joint 1's rotation, row 2
    path = tmp_path / "MANO_RIGHT.pkl"
    path.write_bytes(python2_pickle(mano_objects(fields)))
    plain = tmp_path / "plain.pkl"
    plain.write_bytes(python2_pickle(mano_objects(mano_fields())))
    bent, bent_plain = (load_mano(p).vertices_m for p in (path, plain))
    # the entry is (R - 1)[1, 1] of a rotation about the file's z axis, which is our +x
    moved = np.linalg.norm(bent - bent_plain, axis=1)
    assert np.flatnonzero(moved > 1e-12).tolist() == [100]
    assert moved[100] == pytest.approx(1e-3 * (1 - np.cos(FLEXION_RAD)), rel=1e-6)


def test_the_identifier_names_hand_pose_tips_and_layout(folder):
    for name, hand in (("MANO_RIGHT.pkl", "right"), ("MANO_LEFT.pkl", "left")):
        assert load_mano(folder / name).identifier == f"mano-{hand}-mean-manopth-projected"


@pytest.fixture
def beside(folder, tmp_path):
    """A file of MANO's, and where its texture layout is looked for."""
    (tmp_path / "MANO_RIGHT.pkl").write_bytes((folder / "MANO_RIGHT.pkl").read_bytes())
    return tmp_path / "MANO_RIGHT.pkl", tmp_path / "MANO_UV_right.obj"


def write_obj(path, faces, uv):
    lines = ["# a layout", *(f"v {k} 0 0" for k in range(778)), *(f"vt {u:.9f} {v:.9f}" for u, v in uv)]
    lines += ["f " + " ".join(f"{v + 1}/{v + 1}/1" for v in face) for face in faces]
    path.write_text("\n".join(lines))


def test_the_layout_of_the_download_page_is_found_beside_the_file(beside):
    mano, layout = beside
    uv = np.random.default_rng(0).uniform(0, 0.5, (778, 2)).round(9)
    faces = sock()[1]
    shuffled = np.roll(faces[np.random.default_rng(1).permutation(len(faces))], 1, axis=1)
    write_obj(layout, shuffled, uv)
    template = load_mano(mano)
    assert template.identifier == "mano-right-mean-manopth-obj"
    np.testing.assert_allclose(template.face_uv[:1538], uv[faces], atol=1e-12)
    cap = template.face_uv[1538:]
    assert cap.min() >= 0
    assert cap.max() <= 1
    # the layout fills a quarter of the square: the cap is beside it
    assert (cap.max(axis=-1) > 0.5).all()


def test_the_projected_layout_keeps_palm_and_back_apart(flat):
    skin = flat.face_uv[: flat.skin_face_count]
    corners = flat.vertices_m[flat.faces[: flat.skin_face_count]]
    up = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]
    assert (skin[up > 0][..., 0] < 0.5).all()
    assert (skin[up < 0][..., 0] > 0.5).all()
    edge1, edge2 = skin[:, 1] - skin[:, 0], skin[:, 2] - skin[:, 0]
    assert (edge1[:, 0] * edge2[:, 1] - edge1[:, 1] * edge2[:, 0] >= 0).all()


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("v_template", np.zeros((777, 3)), r"v_template: wanted shape \(778, 3\), got \(777, 3\)"),
        ("weights", np.full((778, 16), np.nan), "weights: wanted finite numbers"),
        (
            "weights",
            mano_fields()["weights"] * 1.002,
            "weights: wanted rows of at least 0 that sum to 1, got rows off by 0.002",
        ),
        ("weights", np.tile([1.5, -0.5, *[0] * 14], (778, 1)), "weights: wanted rows of at least 0"),
        ("f", np.full((1538, 3), 778), "f: wanted vertex numbers"),
        ("f", np.full((1538, 3), -1), "f: wanted vertex numbers"),
        ("kintree_table", np.zeros((2, 16), int), "kintree_table: wanted MANO's tree"),
        ("hands_mean", "lbs", "hands_mean: wanted an array, got a str"),
        ("shapedirs", Thing("chumpy.reordering", "vstack", {}), "shapedirs: wanted an array, got a Record"),
    ],
)
def test_a_wrong_field_is_named(tmp_path, name, value, message):
    path = tmp_path / "MANO_RIGHT.pkl"
    path.write_bytes(python2_pickle({**mano_objects(mano_fields()), name: value}))
    with pytest.raises(InputError, match=message):
        load_mano(path)


def test_missing_fields_are_listed(tmp_path):
    path = tmp_path / "SMPL.pkl"
    path.write_bytes(python2_pickle({"v_template": np.zeros((3, 3))}))
    with pytest.raises(InputError, match="hands_mean"):
        load_mano(path)
