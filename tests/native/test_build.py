"""The build: constants that two languages share, stamps, and the compilers that may be used."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from jghand_engine import gpu
from jghand_engine.avatar import lamp_rows
from jghand_engine.errors import InputError, RetryError
from jghand_engine.native import binding, build, contract, library, scene_light_task, selftest, tasks


def test_the_kernels_constants_are_those_of_python():
    text = (build.SOURCE_FOLDER / "constants.h").read_text()
    found = {name: float(value) for name, value in re.findall(r"constexpr \w+ (\w+) = ([-\d.e]+)f?;", text)}
    python = vars(contract) | vars(tasks)
    shared = {name: value for name, value in found.items() if name in python}
    assert set(found) - set(shared) == {"LN2", "LOG2E"}
    assert shared == {name: python[name] for name in shared}
    assert {
        "BLUR_PX2",
        "VAR_MAX_PX2",
        "RGB_MAX",
        "POSITION_MAX_M",
        "COVARIANCE_SLACK",
        "TILE_PX",
        "GRADIENT_STRIPES",
    } <= set(shared)
    assert {"SHADOW_FAR_M", "SHADOW_SAMPLES_MAX", "SHADOW_STRIPES"} <= set(shared)
    # and stand nowhere else
    for path in build.source_files():
        if path.name != "constants.h":
            assert not re.search(rf"constexpr \w+ ({'|'.join(shared)})\b", path.read_text()), path.name


def test_the_shaders_constants_are_those_of_python():
    text = (Path(gpu.__file__).parent / "blend.wgsl").read_text()
    for name in ("FRONT_MIN", "COVER_FROM", "BENEATH_FROM", "BENEATH_WHOLE", "COVER_WHOLE"):
        assert re.findall(rf"const {name} = ([\d.]+);", text) == [f"{getattr(contract, name):g}"]


def test_a_scene_has_as_many_lamps_as_the_kernel_has_room_for_shadows():
    text = (build.SOURCE_FOLDER / "scene_light.h").read_text()
    assert re.findall(r"constexpr int SLOTS_MAX = (\d+);", text) == [str(lamp_rows.LAMPS_MAX)]
    # and what is kept of those that are drawn apart
    for name in ("LAYERS_MAX", "APART"):
        assert re.findall(rf"constexpr int {name} = (\d+);", text) == [str(getattr(scene_light_task, name))]


@pytest.fixture
def sources(tmp_path, monkeypatch):
    """A small source folder of its own, with an empty library folder beside it."""
    folder = tmp_path / "native"
    folder.mkdir()
    for name in ("library.cpp", "export.h"):
        shutil.copy(build.SOURCE_FOLDER / name, folder)
    monkeypatch.setattr(build, "SOURCE_FOLDER", folder)
    monkeypatch.setattr(build, "LIBRARY_FOLDER", folder / "lib")
    return folder


def some_target() -> build.Target:
    targets = [target for target in build.host_targets() if not target.folder]
    if not targets:
        pytest.skip(f"no native library for {build.host_platform()}")
    return targets[-1]


def needs_compiler() -> None:
    try:
        build.find_compiler()
    except RetryError as error:
        pytest.skip(str(error))


def test_a_library_knows_its_sources_and_a_change_makes_it_stale(sources):
    needs_compiler()
    target, folder = some_target(), sources / "lib"
    assert not build.has_these_sources(target, folder)
    path = build.build(target, folder)
    assert build.has_these_sources(target, folder)
    stamp = build.read_stamp(path)
    assert stamp is not None
    assert stamp.compiler == build.find_compiler().name
    assert build.build_all([target], folder) == []  # nothing to do
    (sources / "export.h").write_text((sources / "export.h").read_text() + "// changed\n")
    assert not build.has_these_sources(target, folder)


def test_line_endings_do_not_make_a_library_stale(sources):
    target = some_target()
    before = build.source_hash(target)
    for path in build.source_files():
        path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    assert build.source_hash(target) == before


def test_sources_that_do_not_compile_leave_the_old_library_alone(sources):
    needs_compiler()
    target, folder = some_target(), sources / "lib"
    path = build.build(target, folder)
    before = path.read_bytes()
    (sources / "broken.cpp").write_text("this is not C++\n")
    with pytest.raises(RetryError, match=r"broken\.cpp"):
        build.build(target, folder)
    assert path.read_bytes() == before
    assert [file.name for file in folder.iterdir()] == [path.name]  # nothing half-written


def test_a_compiler_that_does_not_exist_is_named(sources, monkeypatch):
    monkeypatch.setenv("JGHAND_CXX", "/nowhere/clang++")
    with pytest.raises(InputError, match="/nowhere/clang"):
        build.build(some_target(), sources / "lib")


def test_without_any_compiler_the_remedy_is_said(monkeypatch):
    monkeypatch.delenv("JGHAND_CXX", raising=False)
    monkeypatch.delenv("CXX", raising=False)
    monkeypatch.setattr(build.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(RetryError, match="pip install ziglang"):
        build.find_compiler()


def test_fast_math_is_refused_by_the_sources():
    needs_compiler()
    compiler, source = build.find_compiler(), build.SOURCE_FOLDER / "library.cpp"
    # the target's arguments too: without them zig would compile the C++ library first
    defines = ['-DJG_BUILD_STAMP=""', '-DJG_VARIANT=""', "-fsyntax-only", "-std=c++17"]
    defines += build._arguments(compiler, some_target())
    for flags, refused in (["-O2"], False), (["-ffast-math"], True), (["-ffinite-math-only"], True):
        result = subprocess.run(
            [*compiler.command, *defines, *flags, str(source)], capture_output=True, text=True, check=False
        )
        assert ("must not be compiled with -ffast-math" in result.stderr) is refused, flags


def test_every_release_target_is_listed():
    assert {"linux_x86_64_v3", "linux_x86_64_v4", "linux_aarch64_neon", "macos_aarch64_neon"} <= set(build.TARGETS)
    assert {"windows_x86_64_v3", "windows_x86_64_v4"} <= set(build.TARGETS)
    for target in build.TARGETS.values():
        assert ("-fPIC" in build._arguments(build.Compiler((), "", True), target)) is (target.suffix != ".dll")
        assert not any("fast" in flag and "contract" not in flag for flag in build.FLAGS)


# ---- loading --------------------------------------------------------------------------------------------------------


@pytest.fixture
def fresh(monkeypatch):
    """Forgets what was loaded, so that the choice is made anew."""
    monkeypatch.setattr(library, "_loaded", {})
    monkeypatch.delenv("JGHAND_BACKEND", raising=False)


native_only = pytest.mark.skipif(not library.runnable_variants(), reason="no native library runs here")


@native_only
def test_the_best_variant_is_chosen_and_says_its_name(fresh, capsys):
    loaded = library.load()
    assert loaded.variant == library.best_variant()
    assert loaded.call.jg_variant().decode() == loaded.variant
    assert capsys.readouterr().err == ""


@pytest.mark.skipif(os.environ.get("JGHAND_REQUIRE_NATIVE") != "1", reason="JGHAND_REQUIRE_NATIVE is not 1")
def test_where_native_kernels_are_required_they_run(fresh):
    """Elsewhere tests of the kernels are skipped where none runs; a broken build must not hide behind that."""
    assert library.runnable_variants()
    library.load()


@native_only
@pytest.mark.parametrize("variant", library.runnable_variants())
def test_the_environment_forces_a_variant(variant, fresh, monkeypatch):
    monkeypatch.setenv("JGHAND_BACKEND", variant)
    loaded = library.load()
    assert loaded.variant == variant


@pytest.mark.parametrize("name", ["v5", "torch"])
def test_a_misspelt_variant_is_an_error_that_names_it(name, fresh, monkeypatch):
    monkeypatch.setenv("JGHAND_BACKEND", name)
    with pytest.raises(InputError, match=f"JGHAND_BACKEND.*{name}"):
        library.load()
    with pytest.raises(InputError, match=name):
        library.load(name)


@native_only
def test_where_no_library_passes_its_self_test_the_last_says_so(fresh, monkeypatch, capsys):
    monkeypatch.setattr(selftest, "EXPECTED_PLANES", (0.0,) * 5)
    with pytest.raises(RetryError, match="self-test"):
        library.load()
    message = capsys.readouterr().err
    assert message.count("self-test") == message.count("\n") == len(library.runnable_variants()) - 1


@pytest.mark.skipif(len(library.runnable_variants()) < 2, reason="only one native variant runs here")
def test_a_variant_that_fails_steps_down_to_the_next(fresh, monkeypatch, capsys):
    best, second = library.runnable_variants()[:2]

    def check(loaded) -> None:
        if loaded.variant == best:
            raise RetryError("self-test of the best")

    monkeypatch.setattr(selftest, "check", check)
    loaded = library.load()
    assert loaded.variant == second
    assert capsys.readouterr().err == f"jghand: drawing with the slower kernel {second}: self-test of the best.\n"


@native_only
def test_a_library_with_another_abi_is_refused(fresh, monkeypatch):
    monkeypatch.setattr(binding, "ABI", 10_000)
    with pytest.raises(RetryError, match="ABI"):
        library.load()


@native_only
def test_a_stale_library_that_cannot_be_rebuilt_is_refused(fresh, monkeypatch):
    monkeypatch.setattr(build, "has_these_sources", lambda target, folder=None: target.variant == "detector")

    def no_compiler():
        raise RetryError("no compiler for the native library")

    monkeypatch.setattr(build, "find_compiler", no_compiler)
    with pytest.raises(RetryError, match="was built from other sources"):
        library.load()


@native_only
def test_something_that_is_no_library_is_refused(tmp_path):
    path = tmp_path / "library.so"
    path.write_bytes(b"not a library")
    with pytest.raises(RetryError, match="cannot be loaded"):
        binding.open_library(path, "v3")


def test_on_a_processor_too_old_for_every_variant_one_sentence_says_so(fresh, monkeypatch):
    monkeypatch.setattr(library, "best_variant", lambda: None)
    with pytest.raises(RetryError, match="this processor"):
        library.load()


@native_only
@pytest.mark.parametrize("name", ["jg_raster_forward", "jg_shade", "jg_skin", "jg_bone_transforms", "jg_mean_add"])
def test_the_self_test_notices_a_kernel_that_does_nothing(name, monkeypatch):
    loaded = library.load()
    selftest.check(loaded)
    monkeypatch.setattr(loaded.call, name, lambda *_arguments: 0)
    with pytest.raises(RetryError, match="self-test"):
        selftest.check(loaded)


@native_only
def test_the_self_test_knows_what_the_reference_draws():
    """Its stored sums come from the float64 reference."""
    import torch

    from jghand_engine.learn.gaussians import Gaussians
    from jghand_engine.learn.reference import rasterize_reference
    from jghand_engine.learn.shadow import darken
    from jghand_engine.render.camera import Camera
    from jghand_engine.render.shadow import ShadowStyle

    arrays, view = selftest.sample_gaussians(), selftest.sample_view()
    leaves = [
        torch.from_numpy(array).double().requires_grad_()
        for array in (arrays.position_m, arrays.sigma_m, arrays.opacity, arrays.rgb)
    ]
    camera = Camera(view.width, view.height, view.fx, view.fy, view.cx, view.cy, torch.eye(4, dtype=torch.float64))
    picture = rasterize_reference(Gaussians(*leaves), camera)
    planes = torch.cat([picture.rgb.permute(2, 0, 1), picture.alpha[None], picture.depth_sum[None]])
    planes.mean((1, 2)).sum().backward()
    means = planes.detach().mean((1, 2)).tolist()
    gradients = [0.0 if leaf.grad is None else float(leaf.grad.abs().mean()) for leaf in leaves]
    assert means == pytest.approx(selftest.EXPECTED_PLANES, abs=1e-6)
    assert gradients == pytest.approx(selftest.EXPECTED_GRADIENTS, abs=1e-6)
    style = ShadowStyle(samples=16, tint=(1.0, 1.0, 1.0))
    shaded = darken(planes.detach(), camera, style).mean((1, 2)).tolist()
    assert [*shaded, means[3]] == pytest.approx(selftest.EXPECTED_RGBA, abs=1e-6)
    assert picture.invalid_gaussians == 1


@native_only
def test_the_self_test_knows_what_the_reference_draws_of_ellipsoids():
    import torch

    from jghand_engine.learn.gaussians import Gaussians
    from jghand_engine.learn.reference import rasterize_reference
    from jghand_engine.render.camera import Camera

    arrays, view = selftest.sample_ellipsoids(), selftest.sample_view()
    names = ("position_m", "sigma_m", "opacity", "rgb", "covariance_m2")
    leaves = {name: torch.from_numpy(getattr(arrays, name)).double().requires_grad_() for name in names}
    camera = Camera(view.width, view.height, view.fx, view.fy, view.cx, view.cy, torch.eye(4, dtype=torch.float64))
    picture = rasterize_reference(Gaussians(**leaves), camera)
    planes = torch.cat([picture.rgb.permute(2, 0, 1), picture.alpha[None], picture.depth_sum[None]])
    planes.mean((1, 2)).sum().backward()
    gradients = [leaves[name].grad for name in ("position_m", "covariance_m2", "opacity", "rgb")]
    means = [0.0 if gradient is None else float(gradient.abs().mean()) for gradient in gradients]
    assert planes.detach().mean((1, 2)).tolist() == pytest.approx(selftest.EXPECTED_PLANES_OF_ELLIPSOIDS, abs=1e-6)
    assert means == pytest.approx(selftest.EXPECTED_GRADIENTS_OF_ELLIPSOIDS, abs=1e-6)
    assert picture.invalid_gaussians == 2
