"""Detail while it is learned: a surface where the Gaussians are, a texture that pictures teach, drawn as it will be."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from painted_samples import camera_at, discs, painted_samples, sample_of, write_rgba
from scipy import ndimage
from scipy.spatial.transform import Rotation
from small_avatars import on_template
from small_hands import INFO, joints_of
from small_trainings import SMALL, small_training

from jghand_engine.avatar.avatar import LearnedFrom, forearm_way
from jghand_engine.avatar.builtin import load_painted
from jghand_engine.avatar.detail import log_ratios
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.sequence import HandPose
from jghand_engine.hand.skeleton import Skeleton
from jghand_engine.learn import detail, step
from jghand_engine.learn.detail import Beside, DetailLearner, Surface, _grazes, fit_surface
from jghand_engine.learn.options import PAPER_FAITHFUL
from jghand_engine.learn.pictures import Pictures
from jghand_engine.native import library
from jghand_engine.render.camera import Camera
from jghand_engine.render.detail import DetailedHand, NativeDetail
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import RenderSettings
from jghand_engine.template.builtin import load_template, load_template_with_forearm
from jghand_engine.template.mesh import HandTemplate

EYES_M = ((0.5, 0.1, 0.1), (-0.5, 0.1, 0.1), (0.0, 0.1, 0.6), (0.0, 0.1, -0.6), (0.1, 0.7, 0.2), (0.3, 0.2, 0.5))
SIZE_PX, FOCAL_PX = (200, 200), 420.0
FRONT_M, GRAZING_M = (0.1, 0.1, 0.5), (0.1, -0.45, 0.12)
DEPTH_M = 1.2e-3
# pictures that are fine enough for detail
FINE = replace(INFO, learned_from=LearnedFrom("painted", "all", 9, "0" * 16, pixel_m=2e-4))


def surface_of(template: HandTemplate, handedness: Handedness = Handedness.RIGHT) -> Surface:
    return Surface(template, Skeleton(template.joints_m, handedness=handedness))


def beside_gaussians(truth: Surface, below_m: float) -> list[Beside]:
    """Pictures of Gaussians so far below a surface."""
    found, hits = [], truth.hits()
    for pose in ("relaxed", "flat"):
        hand = HandPose(joints_of(pose, truth.skeleton.handedness))
        for eye_m in EYES_M:
            eye_m = np.array(eye_m) + hand.joints_m.mean(0)
            camera = camera_at(eye_m, size=SIZE_PX, focal_px=FOCAL_PX)
            face, depth_m = hits(truth.bones(hand), camera)
            y, x = np.nonzero(face >= 0)
            posed_m, closed = truth.posed(hand), truth._closed
            shares = detail._shares(posed_m[closed[face[y, x]]], camera, y, x)
            outwards = np.einsum("nk,nki->ni", shares, truth.normals(posed_m)[closed[face[y, x]]])
            at_m = np.einsum("nk,nki->ni", shares, posed_m[closed[face[y, x]]])
            into = np.einsum("ni,ni->n", outwards, camera.eye_m - at_m) / np.linalg.norm(outwards, axis=1)
            # the plane below the skin is farther along the ray by that part of the way
            deeper = np.where(face >= 0, depth_m, 0.0)
            deeper[y, x] *= 1 + below_m / np.maximum(into, 0.05)
            found.append(Beside(hand, camera, face >= 0, face >= 0, deeper.astype(np.float32), 1.3e-3))
    return found


@pytest.mark.parametrize("handedness", list(Handedness))
def test_the_surface_is_found_where_the_gaussians_are_and_how_deep_they_lie(handedness):
    template = load_template()
    truth, ours = surface_of(template, handedness), surface_of(template, handedness)
    # a hand that is thicker on the palm and thinner on the back, by up to a millimeter
    truth.height_m[:] = 1e-3 * truth._normal[:, 2]
    depth_m = fit_surface(ours, beside_gaussians(truth, below_m=1.5e-3))
    skin = np.unique(template.faces[: template.skin_face_count])
    missed_m = (ours.height_m - truth.height_m)[skin]
    assert depth_m == pytest.approx(1.5e-3, abs=1e-4)
    assert np.sqrt((missed_m**2).mean()) < 2e-4 < np.sqrt((truth.height_m[skin] ** 2).mean()) / 2


def test_a_picture_is_trusted_within_its_mask_and_where_gaussians_hide_all_behind_them(tmp_path):
    avatar, joints_m = load_painted(handedness=Handedness.RIGHT), joints_of("open")
    camera = camera_at(size=SIZE_PX, focal_px=FOCAL_PX)
    everywhere, within = np.full(SIZE_PX, 255, np.uint8), discs(camera, joints_m, 12.0)
    trusted = []
    for name, mask in (("everywhere", everywhere), ("within", within)):
        picture = write_rgba(tmp_path / f"{name}.png", mask)
        (one,) = detail.beside(avatar, [sample_of(picture, camera, joints_m)], Pictures())
        alpha = HandRenderer(avatar, RenderSettings(antialias=False)).render(joints_m, one.camera).rgba[..., 3]
        # with two pixels around
        around = ndimage.binary_dilation(one.trusted, iterations=2)
        assert alpha[around].min() > detail.WHOLLY_DRAWN
        assert one.hand[around].all()
        trusted.append(one.trusted.sum())
    assert 500 < trusted[1] < 0.7 * trusted[0]


@pytest.fixture
def small_texture(monkeypatch) -> int:
    monkeypatch.setattr(detail, "TEXELS", 512)
    return 512


def learner_of(template: HandTemplate, handedness: Handedness) -> DetailLearner:
    """Found, with a smooth texture."""
    way = forearm_way(template.identifier)
    learner = DetailLearner(template, Skeleton(template.joints_m, handedness=handedness, forearm_way=way))
    learner.depth_m.fill_(DEPTH_M)
    rows, columns = torch.meshgrid(torch.arange(detail.TEXELS), torch.arange(detail.TEXELS), indexing="ij")
    with torch.no_grad():
        waves = [
            0.3 * torch.sin(2 * torch.pi * t / wave) for t, wave in ((rows, 32), (columns, 48), (rows + columns, 40))
        ]
        learner.texture.copy_(torch.stack(waves))
    return learner


@pytest.mark.parametrize(("template", "eye_m"), [
    (load_template(), FRONT_M), (load_template(), GRAZING_M), (load_template_with_forearm(), FRONT_M)
])  # fmt: skip
@pytest.mark.parametrize("handedness", list(Handedness))
def test_it_is_learned_as_the_renderer_draws_it(small_texture, handedness, template, eye_m):
    """Of Gaussians a little below the skin, which is farther along a ray that grazes it; of a turned forearm, too."""
    hand = HandPose(joints_of("relaxed", handedness), np.array([0.9, 0.3, -0.2, 0.25]))
    learner, joints_m = learner_of(template, handedness), hand.joints_m
    camera = camera_at(joints_m.mean(0) + np.array(eye_m), size=SIZE_PX, focal_px=2 * FOCAL_PX)
    if template.forearm_face_count:
        camera = Camera.looking_at(
            np.array(eye_m), joints_m[0], (1, 0, 0), width=SIZE_PX[0], height=SIZE_PX[1], focal_px=FOCAL_PX
        )
    bones = learner._surface.skeleton.bones(joints_m, forearm=hand.forearm)
    _, surface_m = learner._surface.hits()(bones, camera)
    alpha = np.where(np.isfinite(surface_m), 1.0, 0.0).astype(np.float32)
    places = learner._placed(hand, camera)
    below_m = np.zeros(alpha.size, np.float32)
    below_m[places.pixel.numpy()] = DEPTH_M * places.graze.numpy()
    seen_m = np.where(alpha > 0, surface_m, 0) + below_m.reshape(alpha.shape)
    planes = np.stack([*(3 * [alpha]), alpha, seen_m]).astype(np.float32)
    ours = learner.ratios(hand, [camera])(camera, *(torch.from_numpy(plane.copy()) for plane in planes[3:]))
    drawn = learner.detail()
    assert drawn is not None
    assert np.abs(log_ratios(drawn.texture) - learner.texture.detach().permute(1, 2, 0).numpy()).max() < 0.003
    avatar = replace(on_template(forearm=template.forearm_face_count > 0), detail=drawn, handedness=handedness)
    native = NativeDetail(library.load("auto"), [DetailedHand.of(avatar, 1.0)])
    native.pose([bones], [bones.root_m])
    native.prepare(planes, camera, [1.0])
    native.find_surface()
    native.run()
    inside = alpha > 0
    difference = np.abs(np.moveaxis(planes[:3], 0, -1) - ours.detach().numpy())[inside]
    assert np.abs(ours.detach().numpy()[inside] - 1).max() > 0.2
    # bytes of the texture, and at seams the means of the renderer, which are of the skin alone
    assert np.quantile(difference, 0.98) < 0.02
    assert np.median(difference) < 0.004


def test_pictures_teach_the_texture(monkeypatch, tmp_path, small_texture):
    training = trained_for(monkeypatch, tmp_path, steps=4)
    learned = training.avatar().detail
    assert learned is not None
    assert np.abs(log_ratios(learned.texture)).max() > 1e-3
    # what no picture shows stays as it began: the square is not full of skin
    assert (learned.texture == 128).all(-1).mean() > 0.3


def test_a_training_that_goes_back_finds_the_same_surface_again(monkeypatch, tmp_path, small_texture):
    training = trained_for(monkeypatch, tmp_path, steps=0)
    before = {name: tensor.clone() for name, tensor in training.tensors().items()}, training.scalars()
    found = []
    for _ in range(2):
        training.load_tensors(before[0])
        training.load_scalars(before[1])
        for number in range(3):
            training.step(number)
        found.append({name: tensor.clone() for name, tensor in training.tensors().items()})
    for name, tensor in found[0].items():
        assert torch.equal(tensor, found[1][name]), name


def test_only_fine_pictures_have_detail_and_the_paper_has_none(monkeypatch, tmp_path):
    samples = painted_samples(tmp_path)
    monkeypatch.setattr("small_trainings.INFO", replace(FINE, learned_from=replace(FINE.learned_from, pixel_m=5e-4)))
    assert small_training(monkeypatch, samples)._detail is None
    monkeypatch.setattr("small_trainings.INFO", FINE)
    paper = replace(SMALL, schedule=replace(SMALL.schedule, detail_from=PAPER_FAITHFUL.schedule.detail_from))
    assert small_training(monkeypatch, samples, paper)._detail is None


def trained_for(monkeypatch, folder, steps: int) -> step.HandTraining:
    """Steps of a training whose detail begins with its second."""
    monkeypatch.setattr("small_trainings.INFO", FINE)
    options = replace(SMALL, schedule=replace(SMALL.schedule, detail_from=0.2, texture_rate=1e-2))
    training = small_training(monkeypatch, painted_samples(folder), options)
    training.plan(4)
    for number in range(steps):
        training.step(number)
    return training


@pytest.mark.parametrize("axis", [0, 1])
def test_skin_that_is_seen_at_60_degrees_is_twice_as_long_as_it_looks(axis):
    turned = Rotation.from_rotvec(np.radians(60) * np.eye(3)[axis]).as_matrix()
    face_m = np.array([[[0.0, 0, 0], [0.01, 0, 0], [0, 0.01, 0]]]) @ turned.T + (0, 0, 0.5)
    camera = Camera(20, 10, 90.0, 70.0, 10.5, 5.5, np.eye(4))
    assert float(_grazes(face_m, camera, np.array([5]), np.array([10]))[0]) == pytest.approx(2)
