"""What of the skin's detail files hold: textures, and colors of Gaussians."""

from dataclasses import replace

import numpy as np
from detail_samples import detailed, flat, noise
from show_splat_file import BLACK, psnr_db

from jghand_engine.avatar.builtin import load_avatar_called
from jghand_engine.avatar.detail_mips import filled, skin_texels
from jghand_engine.export.pictures import flatten
from jghand_engine.export.skin import MEAN_PX, with_detail_in_colors
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import named_pose
from jghand_engine.render.framing import framing_camera
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import preset


def test_beside_the_skin_a_texture_goes_on():
    """What it held there is seen on no level."""
    texture = noise(256)
    skin = skin_texels(detailed(texture).detail.face_uv, 256)
    np.testing.assert_array_equal(filled(texture, skin)[skin], texture[skin])
    of_one_color = np.where(skin[..., None], np.uint8([200, 90, 40]), texture)
    assert (filled(of_one_color, skin) == [200, 90, 40]).all()


def test_gaussians_have_the_ratio_of_the_texture_under_them():
    avatar = detailed(flat(MEAN_PX, np.log(0.5)))
    colored = with_detail_in_colors(avatar)
    assert colored.detail is None
    ratio = colored.rgb / avatar.rgb
    changed = np.abs(ratio - 0.5).max(1) < 0.01
    assert changed.mean() > 0.5
    np.testing.assert_array_equal(colored.rgb[~changed], avatar.rgb[~changed])


def test_pictures_of_these_gaussians_are_nearer_to_those_of_the_texture_but_of_fists():
    avatar = load_avatar_called("builtin")
    # colors hold no slopes, and no outline
    avatar = replace(avatar, detail=replace(avatar.detail, relief=None, ends_hand=False))
    renderers = [
        HandRenderer(one, preset("viewport"))
        for one in (avatar, with_detail_in_colors(avatar), replace(avatar, detail=None))
    ]
    # observed: 0.85, -0.09 and -0.21. The texture holds nothing wide and takes away what Gaussians show of it, these
    # hold nothing finer than they are, and in a fist it slides a millimeter on them: colors gain nothing there, and
    # lose nothing that is seen
    for pose, view, gain_db in (("open", "front", 0.7), ("fist", "front", -0.2), ("fist", "back", -0.3)):
        joints_m = named_pose(pose, avatar.canonical_joints_m, handedness=Handedness.RIGHT)
        camera = framing_camera(joints_m[None], Handedness.RIGHT, view, width=768, height=768)
        true, colored, without = (flatten(one.render(joints_m, camera).rgba, BLACK) for one in renderers)
        print(f"{psnr_db(true, colored):.2f} dB, {psnr_db(true, without):.2f} dB without")
        assert psnr_db(true, colored) > psnr_db(true, without) + gain_db
