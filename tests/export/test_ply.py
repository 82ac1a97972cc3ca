"""PLY files hold what the engine computes, in the layout and the axes that splat viewers expect."""

import numpy as np
import pytest
from small_avatars import ellipsoid_avatar
from usd_samples import engine_gaussians, lively_motion, small_avatar

from jghand_engine.errors import InputError
from jghand_engine.export.splats.cloud import AXES_FROM_RUB, RUB_FROM_UP, SH_C0
from jghand_engine.export.splats.files import SplatOptions, export_splats
from jghand_engine.export.splats.ply import PROPERTIES
from jghand_engine.hand.joints import Handedness

FRAMES = 3
# worst observed: the steps of float32 at 0.5 m, and what logit and logarithm lose of opacity and size
POSITION_ERROR_M, SHARE_ERROR = 1e-7, 2e-6


def fields(path) -> dict[str, np.ndarray]:
    """A reader of its own: by name, as the header says."""
    content = path.read_bytes()
    end = content.index(b"end_header\n") + len(b"end_header\n")
    lines = content[:end].decode("ascii").splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    names = [line.split()[2] for line in lines if line.startswith("property float ")]
    (count,) = [int(line.split()[2]) for line in lines if line.startswith("element vertex ")]
    table = np.frombuffer(content, "<f4", offset=end).reshape(count, len(names))
    return {name: table[:, place] for place, name in enumerate(names)}


def columns(data: dict[str, np.ndarray], *names: str) -> np.ndarray:
    return np.stack([data[name] for name in names], -1).astype(np.float64)


@pytest.fixture(scope="module", params=list(Handedness))
def exported(request, tmp_path_factory):
    avatar, motion = small_avatar(), lively_motion(request.param, FRAMES)
    report = export_splats(tmp_path_factory.mktemp("ply"), avatar, motion, SplatOptions(first_frame=7))
    return report, avatar, motion


def test_there_is_a_file_for_every_frame_with_its_number(exported):
    report, avatar, _ = exported
    assert [path.name for path in report.files] == ["hand.0007.ply", "hand.0008.ply", "hand.0009.ply"]
    assert report.bytes == sum(path.stat().st_size for path in report.files)
    assert 0 < report.files[0].stat().st_size - 4 * len(PROPERTIES) * len(avatar) < 1000


def test_positions_colors_opacities_and_sizes_are_the_engines(exported):
    report, avatar, motion = exported
    centers, radii = engine_gaussians(avatar, motion)
    for path, center, radius in zip(report.files, centers, radii, strict=True):
        data = fields(path)
        assert np.abs(columns(data, "x", "y", "z") * [1, -1, -1] - center).max() <= POSITION_ERROR_M
        rgb = columns(data, "f_dc_0", "f_dc_1", "f_dc_2") * SH_C0 + 0.5
        assert np.abs(rgb - avatar.rgb).max() <= SHARE_ERROR
        opacity = 1 / (1 + np.exp(-data["opacity"].astype(np.float64)))
        assert np.abs(opacity - avatar.opacity).max() <= SHARE_ERROR
        sizes = np.exp(columns(data, "scale_0", "scale_1", "scale_2"))
        assert np.abs(sizes / radius[:, None] - 1).max() <= SHARE_ERROR
        assert (columns(data, "rot_0", "rot_1", "rot_2", "rot_3") == [1, 0, 0, 0]).all()
        assert (columns(data, "nx", "ny", "nz") == 0).all()


@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize("axes", ["rdf", "rub"])
def test_axes_are_turned_and_never_mirrored(tmp_path, axes, up):
    turn = AXES_FROM_RUB[axes] @ RUB_FROM_UP[up]
    assert np.linalg.det(turn) == pytest.approx(1)
    up_in_file = turn @ {"y": [0, 1, 0], "z": [0, 0, 1]}[up]
    assert up_in_file.tolist() == {"rdf": [0, -1, 0], "rub": [0, 1, 0]}[axes]


def test_an_avatar_of_ellipsoids_is_refused(tmp_path):
    with pytest.raises(InputError, match="wanted Gaussians that are balls, got ellipsoids"):
        export_splats(tmp_path, ellipsoid_avatar(), lively_motion(Handedness.RIGHT, 1), SplatOptions())
    assert list(tmp_path.iterdir()) == []


def test_a_motion_is_made_in_parts_whose_frames_keep_their_numbers(tmp_path):
    avatar, motion, options = small_avatar(), lively_motion(Handedness.RIGHT, 7), SplatOptions(first_frame=3)
    whole = export_splats(tmp_path / "whole", avatar, motion, options)
    parts = [
        export_splats(tmp_path / "parts", avatar, motion, options, frames=frames).files
        for frames in (range(4, 7), range(0, 4, 2), range(1, 4, 2))
    ]
    assert [path.name for path in parts[1]] == ["hand.0003.ply", "hand.0005.ply"]
    assert sorted(path.name for part in parts for path in part) == [path.name for path in whole.files]
    for path in whole.files:
        assert path.read_bytes() == (tmp_path / "parts" / path.name).read_bytes()


@pytest.mark.parametrize("wrong", [{"name": "a/b"}, {"name": ""}, {"axes": "xyz"}, {"up": "x"}, {"suffix": "obj"}])
def test_options_that_make_no_file_are_refused(wrong):
    with pytest.raises(InputError):
        SplatOptions(**wrong)
