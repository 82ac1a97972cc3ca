"""The extension's own player reads what the engine writes, and nothing that is damaged."""

from __future__ import annotations

import numpy as np
import pytest

from blender_addon.core import limits
from blender_addon.errors import JGHandFailure
from blender_addon.export import splat_cache


def test_a_frame_of_the_engine_is_the_hand_in_the_world_with_z_up(tmp_path):
    files = pytest.importorskip("jghand_engine.export.splats.files", reason="needs the engine's packages")
    from small_avatars import small_avatar
    from test_recording import a_recording

    from jghand_engine.color import srgb_to_linear
    from jghand_engine.export.motion import HandMotion
    from jghand_engine.motion.read import read_motion_file

    recording, avatar = a_recording(2), small_avatar()
    recording.save(tmp_path / "m.npz")
    sequence = read_motion_file(tmp_path / "m.npz").sequence
    options = files.SplatOptions("splat", "Hand", "rdf", recording.first_frame, "z")
    files.export_splats(splat_cache.cache_folder(tmp_path, "Hand"), avatar, sequence, options)
    for index, frame in enumerate(recording.frames):
        read = splat_cache.read_frame(splat_cache.frame_path(tmp_path, "Hand", frame))
        posed = HandMotion(avatar, sequence).frame(index)
        assert np.abs(read.positions_m - posed.positions_m).max() <= 1e-7
        assert np.abs(read.radius_m / posed.sigma_m - 1).max() <= 1e-6
        # half a step of 8 bits, where sRGB is steepest
        assert np.abs(read.rgba[:, :3] - srgb_to_linear(avatar.rgb.numpy())).max() <= 0.005
        assert np.abs(read.rgba[:, 3] - avatar.opacity.numpy()).max() <= 0.5 / 255 + 1e-6


@pytest.mark.parametrize(
    "content", [b"", b"x" * 33, np.full(8, np.nan, "<f4").tobytes(), b"\0" * (limits.CACHE_FRAME_MAX_BYTES + 32)]
)
def test_a_damaged_frame_is_refused(tmp_path, content):
    path = tmp_path / "Hand.0001.splat"
    path.write_bytes(content)
    with pytest.raises(JGHandFailure) as caught:
        splat_cache.read_frame(path)
    assert caught.value.kind == "no_bake"


def test_a_frame_that_is_not_there_is_told(tmp_path):
    with pytest.raises(JGHandFailure):
        splat_cache.read_frame(splat_cache.frame_path(tmp_path, "Hand", -3))
