"""A graphics card draws the last step of the native rasterizer; what it cannot do, the kernel does, and says so."""

import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from graphics_card import needs_gpu

from jghand_engine.avatar.builtin import load_builtin, load_painted
from jghand_engine.errors import InputError, RetryError
from jghand_engine.gpu import choice, device
from jghand_engine.gpu.rasterizer import GpuRasterizer
from jghand_engine.hand.joints import Handedness
from jghand_engine.native import library as native_library
from jghand_engine.native import selftest
from jghand_engine.native.rasterizer import GaussianArrays, NativeRasterizer, View
from jghand_engine.render.effect_plan import Effect
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import ShadowMode, preset
from jghand_engine.render.subject import moving_subject

# the worst of a frame is what a pixel hides behind the early stop, which kernel and card make at other places (6e-5)
SAME_FRAME = 1.1e-4
# and with a self-shadow, whose samples ask by depth what stands before them: half a step of a byte. Observed: 7e-4
SAME_SHADED = 2e-3


@pytest.fixture
def opened():
    """A device of its own, for tests that break it."""
    needs_gpu()
    device._open.clear()
    yield device.open_device()
    device._open.clear()


@pytest.fixture
def kernels():
    return native_library.load()


@pytest.fixture
def memory(monkeypatch, tmp_path):
    monkeypatch.setenv("JGHAND_CACHE_DIR", str(tmp_path))
    monkeypatch.delenv("JGHAND_BACKEND", raising=False)
    choice._say_once.cache_clear()
    return tmp_path / "gpu.json"


def sample(rasterizer: NativeRasterizer) -> np.ndarray:
    return rasterizer.forward(selftest.sample_gaussians(), selftest.sample_view()).copy()


def failing(error: Exception):
    def fail(*_, **__):
        raise error

    return fail


def subject_of(avatar, width=120, height=80):
    return moving_subject(avatar.info.name, avatar, width, height)


# ---- frames ---------------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("soft_fingers")
@pytest.mark.parametrize("load", [load_builtin, load_painted])
@pytest.mark.parametrize("name", ["viewport", "final"])
def test_a_hand_is_the_picture_of_the_kernel(name, load):
    """One with its detail and its light, one with its self-shadow, in several poses."""
    needs_gpu()
    avatar = load(handedness=Handedness.RIGHT)
    subject = subject_of(avatar)
    settings = replace(preset(name), normals=True, ids=True, reuse=False, shadow=ShadowMode.ALWAYS)
    by_card, by_kernel = (HandRenderer(avatar, replace(settings, backend=one)) for one in ("gpu", "auto"))
    for pose_m in subject.poses[:3]:
        got, want = by_card.render(pose_m, subject.camera), by_kernel.render(pose_m, subject.camera)
        assert got.rgba[..., 3].max() > 0.9
        assert got.report.plan is not None
        assert got.report.plan.runs(Effect.SHADOW) or load is load_builtin
        assert np.abs(got.rgba - want.rgba).max() <= (SAME_SHADED if load is load_painted else SAME_FRAME)
        assert np.array_equal(got.depth_m > 0, want.depth_m > 0)
        assert np.abs(got.depth_m - want.depth_m).max() <= SAME_FRAME
        assert np.array_equal(got.ids, want.ids)
        assert got.report.invalid_gaussians == want.report.invalid_gaussians
        assert got.report.visible_gaussians == want.report.visible_gaussians


def test_a_frame_says_what_it_was_drawn_on():
    needs_gpu()
    avatar = load_builtin(handedness=Handedness.RIGHT)
    subject = subject_of(avatar, 60, 40)
    report = (
        HandRenderer(avatar, replace(preset("draft"), backend="gpu")).render(subject.poses[0], subject.camera).report
    )
    assert report.backend == f"{native_library.load().variant}, {device.open_device().name}"
    assert report.stages["raster"] > 0
    assert not report.notes


def test_gaps_have_the_color_around_them_as_by_the_kernel(opened, kernels):
    gaussians = selftest.sample_gaussians()
    front = np.random.default_rng(0).choice(np.array([0, 0.3, 1], np.float32), len(gaussians))
    seen = replace(gaussians, rgb=gaussians.rgb * front[:, None], front=front)
    got, want = (
        one.forward(seen, selftest.sample_view())
        for one in (GpuRasterizer(kernels, 1, opened), NativeRasterizer(kernels, 1))
    )
    assert (
        np.abs(want - NativeRasterizer(kernels, 1).forward(replace(seen, front=None), selftest.sample_view())).max()
        > 0.1
    )
    assert np.abs(got - want).max() <= 1e-5


def test_lists_that_do_not_fit_are_made_again(opened, kernels):
    """A Gaussian over every tile, many times: far more pairs than the first lists have room for."""
    count = 300
    many = GaussianArrays(
        np.tile(np.array([0, 0, 1], np.float32), (count, 1)), np.full(count, 0.3, np.float32),
        np.full(count, 0.01, np.float32), np.full((count, 3), 0.5, np.float32),
    )  # fmt: skip
    view = View(256, 128, 200.0, 200.0, 128.0, 64.0, np.eye(3, 4))
    on_card, by_kernel = GpuRasterizer(kernels, 2, opened), NativeRasterizer(kernels, 2)
    got, want = on_card.forward(many, view), by_kernel.forward(many, view)
    assert on_card.pairs == by_kernel.pairs > count + 1024
    assert np.abs(got - want).max() < 1e-5
    assert not on_card.fell_back


def test_nothing_is_drawn_of_no_gaussians(opened, kernels):
    rasterizer = GpuRasterizer(kernels, 1, opened)
    sample(rasterizer)
    line = np.zeros(0, np.float32)
    none = GaussianArrays(np.zeros((0, 3), np.float32), line, line, np.zeros((0, 3), np.float32))
    assert not rasterizer.forward(none, selftest.sample_view()).any()


def test_every_picture_has_the_same_bits_whatever_was_drawn_before(opened, kernels):
    rasterizer = GpuRasterizer(kernels, 1, opened)
    first = sample(rasterizer)
    larger = View(90, 70, 300.0, 300.0, 45.0, 35.0, np.eye(3, 4))
    rasterizer.forward(selftest.sample_ellipsoids(), larger)
    assert np.array_equal(sample(rasterizer), first)
    assert np.array_equal(sample(GpuRasterizer(kernels, 2, opened)), first)


def test_there_is_no_backward_pass(opened, kernels):
    rasterizer = GpuRasterizer(kernels, 1, opened)
    planes = sample(rasterizer)
    with pytest.raises(InputError, match="backward pass"):
        rasterizer.backward(np.ones_like(planes))


# ---- falling back ---------------------------------------------------------------------------------------------------


def test_a_device_that_is_lost_leaves_the_drawing_to_the_kernel(opened, kernels):
    rasterizer = GpuRasterizer(kernels, 1, opened)
    sample(rasterizer)
    opened.handle.destroy()
    wanted = sample(NativeRasterizer(kernels, 1))
    for why in ("stopped drawing", "failed before"):
        assert np.array_equal(sample(rasterizer), wanted)
        assert why in rasterizer.fell_back
    assert device.open_device() is not opened
    again = sample(GpuRasterizer(kernels, 1, device.open_device()))
    assert np.abs(again - wanted).max() < 1e-4


def test_what_the_lost_device_drew_is_gone(opened, kernels):
    """Its picture had another part of the same memory filled."""
    right, left = (View(64, 32, 150.0, 150.0, center, 16.0, np.eye(3, 4)) for center in (48.0, 16.0))
    rasterizer = GpuRasterizer(kernels, 1, opened)
    rasterizer.forward(selftest.sample_gaussians(), right)
    opened.handle.destroy()
    got = rasterizer.forward(selftest.sample_gaussians(), left)
    assert np.array_equal(got, NativeRasterizer(kernels, 1).forward(selftest.sample_gaussians(), left))


def test_a_picture_too_large_for_the_device_is_drawn_by_the_kernel_and_the_next_on_the_device(opened, kernels):
    small = replace(opened, largest=20_000)  # bytes; the planes of 32 x 32 pixels are 20,480
    rasterizer = GpuRasterizer(kernels, 1, small)
    assert np.array_equal(sample(rasterizer), sample(NativeRasterizer(kernels, 1)))
    assert "planes" in rasterizer.fell_back
    assert "MiB" in rasterizer.fell_back
    tiny = View(16, 16, 70.0, 70.0, 8.0, 8.0, np.eye(3, 4))
    rasterizer.forward(selftest.sample_gaussians(), tiny)
    assert not rasterizer.fell_back


def test_what_the_bindings_raise_is_a_failure_of_the_device(opened, kernels, monkeypatch):
    """A map that fails is a RuntimeError; memory that cannot be read after it is one, too."""
    from wgpu.backends.wgpu_native import GPUBuffer

    wanted = sample(NativeRasterizer(kernels, 1))
    for name in ("map_sync", "read_mapped"):
        with monkeypatch.context() as broken:
            broken.setattr(GPUBuffer, name, failing(RuntimeError("Could not map buffer")))
            rasterizer = GpuRasterizer(kernels, 1, device.open_device())
            assert np.array_equal(sample(rasterizer), wanted)
            assert "stopped drawing: Could not map buffer" in rasterizer.fell_back


def test_a_picture_without_room_on_the_device_leaves_the_next_one_to_it(opened, kernels, monkeypatch):
    wgpu = pytest.importorskip("wgpu")
    rasterizer = GpuRasterizer(kernels, 1, opened)
    with monkeypatch.context() as full:
        full.setattr(type(opened.handle), "create_buffer", failing(wgpu.GPUOutOfMemoryError("no room")))
        assert np.array_equal(sample(rasterizer), sample(NativeRasterizer(kernels, 1)))
        assert "no room" in rasterizer.fell_back
    sample(rasterizer)
    assert not rasterizer.fell_back
    assert device.open_device() is opened


def test_the_kernel_draws_in_one_walk_after_the_device_failed(opened, kernels, monkeypatch):
    rasterizer = GpuRasterizer(kernels, 1, opened)
    opened.handle.destroy()
    sample(rasterizer)
    drawn = []
    monkeypatch.setattr(NativeRasterizer, "run", lambda self, thread=0, run=NativeRasterizer.run: (
        drawn.append(thread), run(self, thread)))  # fmt: skip
    sample(rasterizer)
    assert len(drawn) == 1


def test_a_frame_tells_that_the_processor_drew_it(opened):
    avatar = load_builtin(handedness=Handedness.RIGHT)
    subject = subject_of(avatar, 60, 40)
    renderer = HandRenderer(avatar, replace(preset("draft"), backend="gpu", reuse=False))
    opened.handle.destroy()
    frame = renderer.render(subject.poses[0], subject.camera)
    assert frame.rgba[..., 3].max() > 0.9
    assert any("drawn by the processor" in note for note in frame.report.notes)
    assert frame.report.backend == native_library.load().variant


def test_a_device_of_another_process_is_not_used(opened, kernels):
    rasterizer = GpuRasterizer(kernels, 1, replace(opened, process=-1))
    assert np.array_equal(sample(rasterizer), sample(NativeRasterizer(kernels, 1)))
    assert "another process" in rasterizer.fell_back


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are not forked here")
def test_a_forked_process_is_told_and_does_not_hang(opened):
    child = os.fork()
    if child == 0:
        signal.alarm(60)  # ends it where it hangs
        try:
            device.open_device()
        except RetryError as error:
            os._exit(7 if "fork" in str(error) else 1)
        os._exit(1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7


# ---- which one ------------------------------------------------------------------------------------------------------


def test_a_card_that_is_not_there_is_told_with_what_was_seen(monkeypatch):
    needs_gpu()
    monkeypatch.setenv(device.ADAPTER_VARIABLE, "no such card")
    with pytest.raises(InputError, match=r"no such card.* via .*JGHAND_GPU"):
        HandRenderer(load_builtin(handedness=Handedness.RIGHT), replace(preset("draft"), backend="gpu"))


def test_nothing_else_is_said_beside_it():
    """As by Mesa's drivers, of a window system that is not there."""
    needs_gpu()
    look = "from jghand_engine.gpu.device import open_device; open_device()"
    quiet = {name: value for name, value in os.environ.items() if name != "XDG_RUNTIME_DIR"}
    told = subprocess.run([sys.executable, "-c", look], env=quiet, capture_output=True, text=True, check=True)
    assert not told.stdout + told.stderr


def test_software_is_taken_only_when_it_is_asked_for(monkeypatch):
    wgpu = pytest.importorskip("wgpu")
    adapters = [
        SimpleNamespace(info={"backend_type": "Vulkan", "adapter_type": kind}, summary=f"a {kind} via Vulkan")
        for kind in ("CPU", "IntegratedGPU", "DiscreteGPU")
    ]
    for there, taken in ((adapters, "a DiscreteGPU"), (adapters[:2], "a IntegratedGPU")):
        monkeypatch.setattr(wgpu.gpu, "enumerate_adapters_sync", lambda there=there: list(there))
        assert device._choose("").summary == f"{taken} via Vulkan"
    monkeypatch.setattr(wgpu.gpu, "enumerate_adapters_sync", lambda: adapters[:1])
    assert device._choose(device.ANY).summary == "a CPU via Vulkan"
    with pytest.raises(InputError, match="got a CPU via Vulkan"):
        device._choose("")


def test_a_device_that_does_not_open_is_told(opened, memory, kernels, monkeypatch, capfd):
    choice.remember(opened, gpu_ms=1.0, processor_ms=2.0)
    monkeypatch.setattr(type(device._choose(device.ANY)), "request_device_sync", failing(RuntimeError("device lost")))
    device.forget(opened)
    with pytest.raises(RetryError, match="device lost"):
        device.open_device()
    assert choice.device_for("auto", kernels) is None
    assert "device lost" in capfd.readouterr().err


def test_the_largest_array_is_whole_blocks(monkeypatch):
    limits = dict.fromkeys(device._SIZE_LIMITS, 20_483)
    adapter = SimpleNamespace(limits=limits, summary="a card", request_device_sync=lambda **_: None)
    assert device._opened(adapter).largest == 20_480


def test_without_the_package_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "wgpu", None)
    monkeypatch.setattr(device, "_open", {})
    with pytest.raises(InputError, match=r"jghand\[gpu\]"):
        device.open_device()


def test_a_device_that_draws_something_else_is_refused(monkeypatch, opened, kernels):
    right = GpuRasterizer.forward
    monkeypatch.setattr(GpuRasterizer, "forward", lambda self, *given: right(self, *given) + 0.01)
    with pytest.raises(RetryError, match="self-test"):
        choice.working_device(kernels)


def test_a_device_that_was_opened_anew_is_tested_again(opened, kernels, monkeypatch):
    tested = []
    monkeypatch.setattr(choice, "_check", lambda _, device: tested.append(device))
    for _ in range(2):
        choice.working_device(kernels)
    assert tested == [opened]
    device.forget(opened)
    assert choice.working_device(kernels) is not opened
    assert len(tested) == 2


def test_auto_takes_the_card_only_after_it_was_measured_faster(memory, opened, kernels):
    assert choice.device_for("auto", kernels) is None
    assert not choice.remember(opened, gpu_ms=2.0, processor_ms=1.0)
    assert choice.device_for("auto", kernels) is None
    assert choice.remember(opened, gpu_ms=1.0, processor_ms=2.0)
    assert choice.device_for("auto", kernels) is opened
    assert choice.device_for(kernels.variant, kernels) is None


def test_what_was_measured_on_another_machine_does_not_count(memory, opened, kernels):
    choice.remember(opened, gpu_ms=1.0, processor_ms=2.0)
    facts = json.loads(memory.read_text())
    memory.write_text(json.dumps(facts | {"processor": "another"}))
    assert choice.device_for("auto", kernels) is None
    memory.write_text("{")
    assert choice.device_for("auto", kernels) is None


def test_auto_draws_with_the_processor_where_the_remembered_card_is_gone(memory, opened, kernels, monkeypatch, capfd):
    choice.remember(opened, gpu_ms=1.0, processor_ms=2.0)
    monkeypatch.setenv(device.ADAPTER_VARIABLE, "no such card")
    assert choice.device_for("auto", kernels) is None
    assert "drawing with the processor" in capfd.readouterr().err


def test_auto_opens_no_other_card_than_the_remembered_one_and_says_so_once(memory, opened, kernels, capfd, monkeypatch):
    choice.remember(replace(opened, name="another card"), gpu_ms=1.0, processor_ms=2.0)
    for _ in range(2):
        assert choice.device_for("auto", kernels) is None
    device.forget(opened)
    monkeypatch.setattr(type(device._choose(device.ANY)), "request_device_sync", None)
    assert choice.device_for("auto", kernels) is None
    assert capfd.readouterr().err.count("wanted another card") == 1


def test_the_variable_of_the_kernels_names_the_card_too(memory, opened, kernels, monkeypatch):
    monkeypatch.setenv("JGHAND_BACKEND", "gpu")
    assert choice.device_for("auto", kernels) is opened
    assert native_library.load("gpu").variant == kernels.variant
