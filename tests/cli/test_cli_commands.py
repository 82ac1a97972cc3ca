"""The command line as people use it: what it writes, what it says, how it ends."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from command_line import run

from jghand_engine import __version__
from jghand_engine.avatar import builtin
from jghand_engine.cli import VERBS, bench, main
from jghand_engine.cli.inputs import load_motion, read_sequence
from jghand_engine.cli.options import FormatOptions, MotionOptions, color, pixels
from jghand_engine.errors import InputError
from jghand_engine.export.pictures import read_png
from jghand_engine.export.usd.package import UsdOptions
from jghand_engine.export.usd.stage import Variant
from jghand_engine.gpu import choice, device
from jghand_engine.gpu.blend import GpuBlend
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.kinematics import Fist
from jghand_engine.hand.orders import JointOrder, from_level
from jghand_engine.hand.poses import named_pose, pose_sequence_of_names
from jghand_engine.native.library import runnable_variants
from jghand_engine.render.settings import PRESETS

SMALL = ("--size", "64x48", "--preset", "draft")


@pytest.fixture(scope="module")
def avatar():
    return builtin.load_painted(handedness=Handedness.RIGHT)


# ---- help and arguments ----------------------------------------------------------------------------------------------


def test_the_help_names_every_verb_and_an_example(capsys):
    with pytest.raises(SystemExit) as end:
        main(["--help"])
    assert not end.value.code
    shown = capsys.readouterr().out
    assert all(verb in shown for verb in VERBS)
    assert "jghand render --poses" in shown


@pytest.mark.parametrize("verb", VERBS)
def test_the_help_of_a_verb_explains_every_option(verb, capsys):
    with pytest.raises(SystemExit) as end:
        main([verb, "--help"])
    assert not end.value.code
    shown = capsys.readouterr().out
    if verb != "serve":
        assert f"jghand {verb}" in shown, "an example"
    assert "None" not in shown
    assert "Union" not in shown


def test_the_version_is_the_packages(capsys):
    assert main(["--version"]) == 0
    assert __version__ in capsys.readouterr().out


@pytest.mark.parametrize("words", [[], ["fly"], ["render"], ["render", "--out", "x", "--order", "mano"], ["info"]])
def test_a_mistake_in_the_arguments_ends_with_2(words, capsys):
    with pytest.raises(SystemExit) as end:
        main(words)
    assert end.value.code == 2
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (":", slice(0, None, 1)),
        ("3:9", slice(3, 10, 1)),
        ("3-9", slice(3, 10, 1)),
        ("1-2400:2", slice(1, 2401, 2)),
        ("0:99:2", slice(0, 100, 2)),
        ("5", slice(5, 6, 1)),
        ("4:", slice(4, None, 1)),
    ],
)
def test_frames_are_counted_with_the_last_one(text, expected):
    assert MotionOptions(frames=text).frame_slice() == expected


@pytest.mark.parametrize("text", ["", "a:b", "-3:4", "1:2:3:4", "1.5", "1--3", "5-", "1:2-3", "5:2", "0:9:0"])
def test_frames_that_make_no_sense_are_refused(text):
    with pytest.raises(InputError, match="--frames"):
        MotionOptions(frames=text).frame_slice()


def test_sizes_and_colors_are_read():
    assert pixels("512x334") == (512, 334)
    assert color("#ff8000") == (1.0, 128 / 255, 0.0)
    for text in ("512", "0x4", "512x", "axb", "-4x4"):
        with pytest.raises(InputError, match="--size"):
            pixels(text)
    with pytest.raises(InputError, match="#rrggbb"):
        color("red")


# ---- render ----------------------------------------------------------------------------------------------------------


def test_render_writes_pictures_camera_and_figures(tmp_path, capsys):
    out, figures = tmp_path / "out", tmp_path / "figures.json"
    assert run("render", "--poses", "open,fist", "--frames", "0:2", "--out", out, "--json", figures, *SMALL) == 0
    pictures = sorted(out.glob("*.png"))
    assert [path.name for path in pictures] == [f"frame_0000{i}.png" for i in range(3)]
    first = read_png(pictures[0])
    assert first.shape == (48, 64, 4)
    assert 0.05 < (first[..., 3] > 128).mean() < 0.6, "the hand is there, and not everywhere"
    assert not first[0].any(), "the border is empty"
    report = json.loads(figures.read_text())
    assert report["frames"] == 3
    assert report["stages"]["whole frame"]["median_ms"] > 0
    shown = capsys.readouterr()
    assert "median ms" in shown.out
    assert not shown.err


def test_of_many_angles_that_were_not_trained_the_three_farthest_are_told_and_the_figures_have_all(tmp_path, capsys):
    report = tmp_path / "figures.json"
    canonical = builtin.load_painted(handedness=Handedness.RIGHT).canonical_joints_m
    # a left fist that is said to be a right one bends its fingers backwards
    fist = pose_sequence_of_names(["fist"], canonical, handedness=Handedness.LEFT)
    np.save(tmp_path / "bent.npy", from_level(fist.joints_m[:1], JointOrder.STANDARD))
    words = ("--motion", tmp_path / "bent.npy", "--hand", "right", "--out", tmp_path / "out", "--json", report)
    assert run("render", *words, "--size", "32x24") == 0
    told = [line for line in capsys.readouterr().out.splitlines() if "that was trained" in line or "less far" in line]
    all_of_them = json.loads(report.read_text())["out_of_range"]
    assert len(told) == 4
    assert f"and {len(all_of_them) - 3} angles more" in told[3]
    assert sorted((one["beyond_rad"] for one in all_of_them), reverse=True)[0] == all_of_them[0]["beyond_rad"]


@pytest.mark.parametrize("command", ["render", "export"])
@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "none of them"),
        (("--poses", "open", "--motion", "x"), "both"),
        (("--poses", "open", "--frames", "soon"), "soon"),
        (("--poses", "open", "--fps", "nan"), "nan"),
    ],
)
def test_a_mistake_in_the_words_is_told_before_anything_is_loaded(command, words, said, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(builtin, "load_avatar_called", lambda _: pytest.fail("loaded"))
    assert run(command, *words, "--out", tmp_path) == 2
    assert said in capsys.readouterr().err


def test_render_shows_the_hand_in_the_light_of_a_file(tmp_path):
    sky = np.zeros((8, 16, 3), np.float32)
    sky[:4, :, 0] = 3.0
    np.save(tmp_path / "red.npy", sky)
    words = ("render", "--poses", "open", "--frames", "0", *SMALL)
    assert run(*words, "--out", tmp_path / "lit", "--light", tmp_path / "red.npy") == 0
    assert run(*words, "--out", tmp_path / "captured") == 0
    (lit,), (captured,) = (sorted((tmp_path / name).glob("*.png")) for name in ("lit", "captured"))
    red, green, blue, _ = np.moveaxis(read_png(lit), -1, 0)
    assert red.max() > 0.2
    assert max(green.max(), blue.max()) < 0.02
    assert read_png(captured)[..., 1].max() > 0.3
    # another light is another render
    np.save(tmp_path / "red.npy", 2 * sky)
    again = ("--out", tmp_path / "lit", "--light", tmp_path / "red.npy", "--skip-existing")
    assert run(*words, *again) == 2


def test_lamps_in_the_words_light_the_hand_as_those_of_a_file(tmp_path, capsys):
    lamps = [{"kind": "sun", "rgb": [3, 2, 1], "place_m": [0.8, 0.6, 0.6], "angle_rad": 0.01},
             {"kind": "point", "rgb": [0, 0, 0.2], "place_m": [0.1, 0.2, 0.3]}]  # fmt: skip
    words = ("--lamp", "sun:rgb=3/2/1,place=0.8/0.6/0.6,angle=0.01", "--lamp", "point:rgb=0/0/0.2,place=0.1/0.2/0.3")
    for name, kept in (("both", lamps), ("sun", lamps[:1])):
        (tmp_path / f"{name}.json").write_text(json.dumps({"format": "jghand-light", "version": 1, "lamps": kept}))
    lights = {"file": ("--light", tmp_path / "both.json"), "words": words,
              "beside": ("--light", tmp_path / "sun.json", *words[2:])}  # fmt: skip
    for name, light in lights.items():
        command = ("render", "--poses", "open", "--frames", "0", *SMALL, "--out", tmp_path / name)
        assert run(*command, *light) == 0
        assert (
            read_png(tmp_path / name / "frame_00000.png").tobytes()
            == read_png(tmp_path / "file" / "frame_00000.png").tobytes()
        )
    assert run(*command, "--lamp", words[1], "--skip-existing") == 2, "another light is another render"
    assert run(*command, "--lamp", "moon:rgb=1/1/1") == 2
    assert "kind in --lamp moon:rgb=1/1/1" in capsys.readouterr().err


def test_the_camera_that_render_wrote_makes_the_same_picture_again(tmp_path):
    first, again = tmp_path / "first", tmp_path / "again"
    assert run("render", "--poses", "point", "--frames", "0", "--out", first, *SMALL) == 0
    camera = first / "camera.json"
    assert (
        run("render", "--poses", "point", "--frames", "0", "--out", again, "--preset", "draft", "--camera", camera) == 0
    )
    assert (read_png(first / "frame_00000.png") == read_png(again / "frame_00000.png")).all()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--camera", "camera.json", "--size", "512x334"), "Leave --size out"),
        (("--budget-ms", "10", "--preset", "final"), "Leave one of them out"),
    ],
)
def test_an_option_that_another_overrules_is_refused_and_not_ignored(words, said, tmp_path, capsys, monkeypatch):
    """Also where it says what would be taken without it."""
    monkeypatch.setattr(builtin, "load_avatar_called", lambda _: pytest.fail("loaded"))
    assert run("render", "--poses", "open", "--out", tmp_path, *words) == 2
    assert said in capsys.readouterr().err


def test_a_background_makes_opaque_pictures(tmp_path):
    words = ("render", "--poses", "point", "--frames", "0", "--out", tmp_path, *SMALL, "--background", "#336699")
    assert run(*words) == 0
    picture = read_png(tmp_path / "frame_00000.png")
    assert picture.shape[2] == 3
    assert picture[0, 0].tolist() == [0x33, 0x66, 0x99]


def test_render_writes_a_video_of_every_frame(tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="the extra `video` is not installed")
    video = tmp_path / "hand.mp4"
    assert run("render", "--poses", "open,fist", "--frames", "0:4", "--out", tmp_path, "--video", video, *SMALL) == 0
    frames, _ = ffmpeg.count_frames_and_secs(str(video))
    assert frames == 5


def test_a_real_capture_is_rendered_upright_and_whole(tmp_path, shared_data):
    motion = shared_data / "real/human_joint_right.npy"
    words = ("render", "--motion", motion, "--order", "mediapipe", "--hand", "right", "--frames", "0:600:300")
    assert run(*words, "--out", tmp_path, *SMALL, "--camera", "front") == 0
    for frame in (0, 300, 600):
        alpha = read_png(tmp_path / f"frame_{frame:05d}.png")[..., 3]
        assert 0.05 < (alpha > 128).mean() < 0.6
        assert not alpha[:, [0, -1]].any()
        # the forearm leaves the picture below
        assert not alpha[0].any()


# ---- motions ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def wobbling(tmp_path, avatar):
    """A plain array in standard order whose bones change their length by millimeters, as estimates do."""
    sequence = pose_sequence_of_names(["open", "fist"], avatar.canonical_joints_m, handedness=Handedness.RIGHT)
    noise = np.random.default_rng(3).normal(0, 2e-3, sequence.joints_m.shape)
    noise[:, 0] = 0
    path = tmp_path / "wobbling.npy"
    np.save(path, from_level(sequence.joints_m + noise, JointOrder.STANDARD))
    return path


def options(path, **more):
    return MotionOptions(motion=path, format=FormatOptions(order="mediapipe", hand="right"), **more)


def test_estimated_joints_do_not_pulse(wobbling, avatar):
    motion = load_motion(options(wobbling), avatar)
    lengths_m = motion.sequence.bone_lengths_m
    assert np.ptp(lengths_m, axis=0).max() < 1e-12
    assert any("median" in note for note in motion.notes)


@pytest.mark.parametrize("keep", [True, False])
def test_a_part_of_a_motion_is_repaired_as_the_whole_is(wobbling, avatar, keep):
    joints = np.load(wobbling)
    joints[5:8, 4] = np.nan
    np.save(wobbling, joints)
    whole = load_motion(options(wobbling, keep_bone_lengths=keep), avatar)
    part = load_motion(options(wobbling, keep_bone_lengths=keep, frames="6:12:2"), avatar)
    assert np.array_equal(part.sequence.joints_m, whole.sequence.joints_m[6:13:2])
    assert any("3 of" in note for note in part.notes)
    assert part.sequence.filled.tolist() == [True, False, False, False], "frame 6 was filled from 4 and 8"


def test_a_gap_outside_the_part_stops_nothing(wobbling, avatar):
    joints = np.load(wobbling)
    joints[5, 4] = np.nan
    np.save(wobbling, joints)
    assert len(load_motion(options(wobbling, on_missing="stop", frames="6:8"), avatar).sequence) == 3
    with pytest.raises(InputError, match="all 21 joints"):
        load_motion(options(wobbling, on_missing="stop", frames="4:8"), avatar)


def test_bone_lengths_of_the_file_are_kept_when_asked_for(wobbling, avatar):
    motion = load_motion(options(wobbling, keep_bone_lengths=True), avatar)
    assert np.ptp(motion.sequence.bone_lengths_m, axis=0).max() > 1e-3
    assert not any("Bone lengths" in note for note in motion.notes)


def test_named_poses_have_the_avatars_bones(avatar):
    motion = load_motion(MotionOptions(poses="open, fist"), avatar)
    canonical = avatar.canonical_joints_m
    measured = np.linalg.norm(canonical[3] - canonical[0])
    assert np.allclose(motion.sequence.bone_lengths_m[:, 2], measured, atol=1e-12)


def test_named_poses_close_as_the_avatars_skin_wants(avatar):
    thick = replace(avatar, fist=Fist((-5.0, 2.0, 1.0)))
    last, wanted = load_motion(MotionOptions(poses="open, fist"), thick).sequence.joints_m[-1], thick.canonical_joints_m
    closed = named_pose("fist", wanted, handedness=Handedness.RIGHT, fist=thick.fist)
    np.testing.assert_allclose(last, closed, atol=1e-12)
    assert np.abs(last - named_pose("fist", wanted, handedness=Handedness.RIGHT)).max() > 2e-3


# ---- the other verbs -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["builtin", "painted"])
def test_info_tells_what_an_avatar_is(tmp_path, capsys, name):
    assert run("info", name, "--json", tmp_path / "info.json") == 0
    facts = json.loads((tmp_path / "info.json").read_text())
    assert facts["kind"] == "avatar"
    assert facts["gaussians"] == len(builtin.load_avatar_called(name))
    assert facts["license"] in capsys.readouterr().out


def test_info_tells_what_a_motion_is(wobbling, capsys):
    assert run("info", wobbling, "--order", "mediapipe", "--hand", "right") == 0
    shown = capsys.readouterr().out
    assert "hand length mm" in shown
    assert "right" in shown


def test_export_writes_a_stage_that_info_understands(tmp_path, capsys):
    usd, figures = tmp_path / "usd", tmp_path / "figures.json"
    assert run("export", "--poses", "open,fist", "--frames", "0:1", "--out", usd, "--json", figures) == 0
    assert json.loads(figures.read_text())["frames"] == 2
    capsys.readouterr()
    assert run("info", usd / "hand.usda") == 0
    shown = capsys.readouterr().out
    assert "ParticleField3DGaussianSplat" in shown
    assert "hand.splats.usdc" in shown
    assert re.search(r"what is wrong +none", shown)


def test_check_usd_ends_with_0_for_our_stage_and_2_with_sentences_for_a_broken_one(tmp_path, capsys):
    assert run("export", "--poses", "open", "--frames", "0", "--out", tmp_path, "--avatar", "painted") == 0
    capsys.readouterr()
    stage = tmp_path / "hand.usda"
    assert run("check-usd", stage) == 0
    assert capsys.readouterr().out == "Nothing is wrong.\nLooked at: 60000 Gaussians, variants 4, frames 1.\n"
    stage.write_text(re.sub(r"\s*(fallbackPrimTypes = \{[^}]*\}|defaultPrim = .*)", "", stage.read_text()))
    assert run("check-usd", stage, "--json", tmp_path / "findings.json") == 2
    shown = capsys.readouterr().out
    told = json.loads((tmp_path / "findings.json").read_text())
    assert any("no default prim" in error for error in told["errors"])
    assert any("fallbackPrimTypes" in note for note in told["notes"])
    assert "ERROR: there is no default prim" in shown
    assert "note: [splats]: the root layer names no fallbackPrimTypes" in shown


@pytest.fixture
def usd_options(monkeypatch):
    """Collects the options with which a stage is to be written; none is."""
    seen = []

    def export(folder, avatar, sequence, cameras, options):
        seen.append(options)
        raise InputError("enough seen")

    monkeypatch.setattr("jghand_engine.cli.export.export_stage", export)
    return seen


def test_export_hands_its_options_on(tmp_path, usd_options):
    words = ("--name", "mine", "--radiance", "linear", "--width-factor", "2")
    assert run("export", "--poses", "open", "--out", tmp_path, *words, "--default-variant", "mesh") == 2
    assert usd_options == [UsdOptions("mine", Variant.MESH, "linear", 2.0)]


@pytest.mark.parametrize(
    ("words", "variant", "width_factor"),
    [
        (("--for", "usdview"), Variant.POINTS_SKINNED, 2.0),
        (("--for", "blender"), Variant.POINTS, 2.0),
        (("--for", "houdini"), Variant.POINTS, 1.0),
        (("--for", "omniverse"), Variant.SPLATS, 1.0),
        ((), Variant.SPLATS, 1.0),
        (("--for", "blender", "--default-variant", "mesh", "--width-factor", "1.5"), Variant.MESH, 1.5),
    ],
)
def test_a_preset_chooses_what_was_not_asked_for(tmp_path, usd_options, words, variant, width_factor):
    assert run("export", "--poses", "open", "--out", tmp_path, *words) == 2
    assert usd_options == [UsdOptions(default_variant=variant, width_factor=width_factor)]


def test_export_leaves_a_shot_that_was_edited_alone_unless_told(tmp_path, capsys):
    words = ("export", "--poses", "open", "--frames", "0", "--avatar", "painted", "--out", tmp_path)
    assert run(*words) == 0
    with (tmp_path / "hand.shot.usda").open("a") as stream:
        stream.write("# my lights\n")
    assert run(*words) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert "my lights" in (tmp_path / "hand.shot.usda").read_text()
    assert run(*words, "--overwrite") == 0
    assert "my lights" not in (tmp_path / "hand.shot.usda").read_text()


def test_export_writes_splat_files_too(tmp_path, capsys):
    figures = tmp_path / "figures.json"
    words = ("--frames", "2:4:2", "--out", tmp_path, "--first-frame", "9", "--up", "z", "--json", figures)
    command = ("export", "ply", "--poses", "open", "--avatar", "painted", *words)
    assert run(*command) == 0
    assert sorted(path.name for path in tmp_path.glob("*.ply")) == ["hand.0011.ply", "hand.0013.ply"]
    told = json.loads(figures.read_text())
    assert told["bytes"] == sum(path.stat().st_size for path in tmp_path.glob("*.ply"))
    assert len(told["made_from"]["joints_sha256"]) == 64, "who asked for it can see whether it is of what was asked"
    assert "2 frames" in capsys.readouterr().out
    assert run(*command) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert run(*command, "--overwrite") == 0
    assert "stay there" not in capsys.readouterr().out
    assert run(*command[:4], "--avatar", "painted", *words[2:], "--frames", "3") == 0
    assert "2 other frames of hand stay there" in capsys.readouterr().out


def test_splats_are_written_in_the_light_of_a_file(tmp_path, capsys):
    world, figures = (
        {"format": "jghand-light", "version": 1, "world": {"rgb": [0.1, 0.2, 0.4]}},
        tmp_path / "figures.json",
    )
    (tmp_path / "blue.json").write_text(json.dumps(world))
    words = ("--frames", "0", "--out", tmp_path / "lit", "--light", tmp_path / "blue.json", "--json", figures)
    assert run("export", "ply", "--poses", "open", *words) == 0
    assert json.loads(figures.read_text())["light"] == "scene"
    assert "light: scene" in capsys.readouterr().out
    (path,) = (tmp_path / "lit").iterdir()
    header, _, body = path.read_bytes().partition(b"end_header\n")
    red, blue = np.frombuffer(body, "<f4").reshape(-1, header.count(b"property float"))[:, [6, 8]].mean(0)
    # skin is red: the light is blue
    assert blue > red


def test_export_writes_a_web_page(tmp_path, capsys):
    figures, page = tmp_path / "figures.json", tmp_path / "page"
    words = ("--avatar", "painted", "--name", "My hand", "--gaussians", "500", "--camera", "back", "--json", figures)
    assert run("export", "web", "--poses", "open,fist", "--frames", "0:3", "--out", page, *words) == 0
    assert "<title>My hand</title>" in (page / "index.html").read_text()
    told = json.loads(figures.read_text())
    assert (told["frames"], told["gaussians"], told["page"]) == (4, 500, str(page / "index.html"))
    assert told["bytes"] == {path.name: path.stat().st_size for path in page.iterdir()}
    assert "4 frames, 500 Gaussians" in capsys.readouterr().out


@pytest.mark.parametrize(
    "words",
    [
        ("ply", "--radiance", "linear"),
        ("usd", "--axes", "rub"),
        ("glb", "--package", "usdz"),
        ("web", "--radiance", "linear"),
        ("web", "--axes", "rub"),
        ("web", "--light", "sky.hdr"),
        ("usd", "--light", "sky.hdr"),
        ("usd", "--lamp", "sun:rgb=1/1/1,place=0/1/0"),
        ("web", "--up", "z"),
        ("spz", "--camera", "back"),
    ],
)
def test_export_refuses_an_option_of_the_other_format(tmp_path, words, capsys):
    assert run("export", *words, "--poses", "open", "--out", tmp_path / "out") == 2
    assert "without effect" in capsys.readouterr().err


@pytest.mark.graphics_card
@pytest.mark.usefixtures("soft_fingers")
def test_a_graphics_card_draws_the_same_pictures(tmp_path, capsys):
    words = ("--poses", "open", "--size", "48x32", "--out")
    assert run("render", *words, tmp_path / "card", "--backend", "gpu") == 0
    assert device.open_device().name in capsys.readouterr().out
    assert run("render", *words, tmp_path / "processor") == 0
    card, processor = (read_png(next((tmp_path / name).rglob("*.png"))).astype(int) for name in ("card", "processor"))
    assert np.abs(card - processor).max() <= 1  # a rounding, in 8 bits


@pytest.mark.graphics_card
def test_a_named_card_that_is_not_there_is_an_error_with_what_was_seen(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv(device.ADAPTER_VARIABLE, "no such card")
    assert run("render", "--poses", "open", "--out", tmp_path / "card", "--backend", "gpu") == 2
    assert "no such card" in capsys.readouterr().err


@pytest.mark.graphics_card
def test_shards_are_not_drawn_by_a_card_here_and_the_processor_there(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("JGHAND_CACHE_DIR", str(tmp_path / "cache"))
    render = ("render", "--poses", "open,fist", "--frames", "0-1", "--size", "48x32", "--out", tmp_path / "wave")
    assert run(*render, "--shard", "1/2") == 0
    choice.remember(device.open_device(), gpu_ms=1.0, processor_ms=2.0)
    capsys.readouterr()
    assert run(*render, "--shard", "2/2") == 2
    assert "frames of another device" in " ".join(capsys.readouterr().err.split())


@pytest.mark.graphics_card
def test_what_the_processor_draws_for_a_card_is_not_measured_as_its(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("JGHAND_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(GpuBlend, "_draw", lambda *_: (_ for _ in ()).throw(RuntimeError("stalled")))
    monkeypatch.setattr(choice, "_check", lambda *_: None)
    assert run("bench", "--size", "48x32", "--backend", "gpu") == 3
    assert "stalled" in capsys.readouterr().err
    assert not choice.remembered()


@pytest.mark.graphics_card
def test_bench_remembers_whether_the_card_is_faster(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("JGHAND_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(bench, "ROUNDS", 2)
    assert run("bench", "--size", "48x32", "--backend", "gpu", "--json", tmp_path / "bench.json") == 0
    report = json.loads((tmp_path / "bench.json").read_text())
    assert report["graphics_card"] == device.open_device().name
    kept = json.loads((tmp_path / "cache" / "gpu.json").read_text())
    medians = {one["section"]: one["median_ms"] for one in report["measurements"] if not one["name"].startswith(" ")}
    assert kept["gpu_ms"] == medians["preset viewport, gpu"]
    assert kept["processor_ms"] == medians["preset viewport, processor"]
    faster = "graphics card" if kept["gpu_ms"] < kept["processor_ms"] else "processor"
    assert f"auto draws with the {faster}" in capsys.readouterr().out


def test_bench_measures_every_preset_with_the_kernels_that_it_tells(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(bench, "ROUNDS", 2)
    slowest = runnable_variants()[-1]
    assert run("bench", "--size", "48x32", "--backend", slowest, "--json", tmp_path / "bench.json") == 0
    report = json.loads((tmp_path / "bench.json").read_text())
    assert report["machine"]["backend"] == slowest
    assert {one["section"] for one in report["measurements"]} == {f"preset {name}" for name in PRESETS}
    assert report["machine"]["cores"] > 0
    assert "preset viewport" in capsys.readouterr().out


def test_a_hand_of_odd_proportions_is_taken_when_it_is_said_to_be_one(tmp_path):
    """A cartoon's: the check of bone lengths, which finds wrong orders and units, is left out."""
    from jghand_engine.hand.sequence import PoseSequence
    from jghand_engine.motion.files import write_motion
    from jghand_engine.template.builtin import load_template

    joints_m = 30 * load_template().joints_m[None]
    joints_m[:, 6:] *= 0.5
    write_motion(tmp_path / "odd.npz", PoseSequence(joints_m, 30.0, Handedness.RIGHT))
    with pytest.raises(InputError):
        read_sequence(tmp_path / "odd.npz", FormatOptions())
    read = read_sequence(tmp_path / "odd.npz", FormatOptions(any_proportions=True))
    assert np.abs(read.joints_m - joints_m).max() == 0
