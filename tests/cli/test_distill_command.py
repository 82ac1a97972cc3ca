"""`jghand distill`: tiers with prices, measured against the network or on held-out pictures, in a file to be drawn."""

import json
from dataclasses import replace

import pytest
import torch
from command_line import run
from picture_sets import recorded, write_set
from small_avatars import small_avatar, trained_avatar

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.correctives import PoseNetShape
from jghand_engine.avatar.file import load_avatar, save_avatar, stored_form
from jghand_engine.avatar.storage import Storage
from jghand_engine.avatar.tiers import LinearCorrectives, Tier
from jghand_engine.cli import distill
from jghand_engine.cli.distill import Distill
from jghand_engine.learn import shadow_seen, tier_prices
from jghand_engine.learn.tier_prices import POSE_STEP, Offer, best_linear, exact_tier_measure, flat_poses
from jghand_engine.native.machine import processor
from jghand_engine.template.builtin import load_template


@pytest.fixture(autouse=True)
def few_rounds(monkeypatch):
    """Times are not what is tested, nor how a shadow looks from every side."""
    monkeypatch.setattr(shadow_seen, "SIDES", shadow_seen.SIDES[:1])
    monkeypatch.setattr(tier_prices, "FRAME_ROUNDS", 2)
    monkeypatch.setattr(tier_prices, "WARM_UP", 1)
    monkeypatch.setattr(distill, "DISTIL_POSES", 40)


@pytest.fixture(scope="module")
def trained() -> HandAvatar:
    avatar = trained_avatar(300, shape=PoseNetShape((3, 3, 2), angle_channels=4, angle_texels=5, hidden=16))
    avatar.learned.correctives.weights["angles.planes"] *= 0.15
    return replace(avatar, info=replace(avatar.info, template=load_template().identifier))


@pytest.fixture
def file(trained, tmp_path):
    save_avatar(tmp_path / "hand.jghand", trained)
    return tmp_path / "hand.jghand"


def test_tiers_are_priced_and_written(file, trained, tmp_path, capsys):
    out, told = tmp_path / "fast.jghand", tmp_path / "told.json"
    assert run("distill", file, "--out", out, "--basis", "1,4,9", "--json", told) == 0
    said = capsys.readouterr().out
    for name in ("exact", "linear-1", "linear-4", "linear-9", "frame ms", "lost dB", "made-up poses"):
        assert name in said
    tiers = {f"{t['tier']}-{t['basis']}": t for t in json.loads(told.read_text())["tiers"]}
    assert tiers["exact-0"]["lost_db"] == 0
    lost = [tiers[f"linear-{basis}"]["lost_db"] for basis in (1, 4, 9)]
    assert lost[0] > lost[1] > lost[2] > 0
    assert all(tier["frame_ms"] > 0 for tier in tiers.values())
    distilled = load_avatar(out)
    plain = stored_form(trained, Storage.COMPACT)
    assert (distilled.rgb == plain.rgb).all()
    kept = [price for price in distilled.learned.distilled.prices if price.tier is Tier.LINEAR]
    assert len(kept) == 1
    assert tiers[kept[0].name]["kept"]
    assert distilled.learned.distilled.linear.basis == kept[0].basis
    assert "against the exact tier" in distilled.learned.distilled.measured_on
    assert processor() in distilled.learned.distilled.measured_on
    # a fast avatar can be distilled again
    assert load_avatar(out).learned.shadow.seen == json.loads(told.read_text())["shadow_seen"]
    assert run("distill", out, "--out", out, "--basis", "2", "--overwrite") == 0
    assert load_avatar(out).learned.distilled.linear.basis == 2


def test_pictures_that_were_held_out_measure_best(file, tmp_path, capsys):
    folder = write_set(tmp_path / "set", recorded(frames=4, cameras=4))
    held_out = {"format": 1, "test_frames": {"ROM_JGHAND": [2006, 2018]}, "test_cameras": ["400262", "400265"]}
    (folder / "splits.json").write_text(json.dumps(held_out))
    words = (folder, "--limit", 1, "--basis", "4")
    assert run("distill", file, "--out", tmp_path / "fast.jghand", *words) == 0
    said = capsys.readouterr().out
    # the linear tier is fitted to learned poses: from a new view they would say little of it
    assert "1 of both novel" in said
    # this avatar says nothing of its pictures: whoever reads the prices has to know
    assert "Warning: The avatar does not say which pictures" in said
    assert "may have learned" in load_avatar(tmp_path / "fast.jghand").learned.distilled.measured_on
    assert "novel view" not in said
    prices = load_avatar(tmp_path / "fast.jghand").learned.distilled.prices
    assert [price.tier for price in prices] == [Tier.EXACT, Tier.LINEAR]
    assert 3 < prices[0].psnr_db < 60


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--basis", "0"), "--basis"),
        (("--basis", "4,many"), "--basis"),
        (("--basis", "65"), "1 to 14"),
        (("--basis", "15"), "1 to 14"),
        (("--basis", "4", "--limit", "-1"), "--limit"),
        (("--basis", "4", "--out", "fast.safetensors"), ".jghand"),
        (("nowhere", "--basis", "4"), "nowhere"),
        (("--basis", "4", "--sequences", "ROM"), "pictures of which folder"),
        (("--basis", "4", "--out", "."), ".jghand"),
    ],
)
def test_wrong_options_are_named(file, tmp_path, capsys, words, said):
    assert run("distill", file, "--out", tmp_path / "fast.jghand", *words) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "fast.jghand").exists()


def test_a_place_that_cannot_be_written_is_told_at_the_start(file, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(Distill, "_measure", lambda *_: pytest.fail("the work had begun"))
    (tmp_path / "in_the_way").write_text("a file")
    (tmp_path / "folder.jghand").mkdir()
    content = file.read_bytes()
    for out, said in (
        (file, "--overwrite"),
        (tmp_path / "folder.jghand", "a folder"),
        (tmp_path / "in_the_way" / "fast.jghand", "in the way"),
    ):
        assert run("distill", file, "--out", out, "--basis", "4") == 2
        assert said in capsys.readouterr().err
    assert file.read_bytes() == content
    assert not list(tmp_path.glob(".*"))


def test_a_painted_avatar_has_nothing_to_distill(tmp_path, capsys):
    save_avatar(tmp_path / "painted.jghand", small_avatar())
    assert run("distill", tmp_path / "painted.jghand", "--out", tmp_path / "fast.jghand") == 2
    assert "trained avatar" in capsys.readouterr().err


def test_the_smallest_basis_that_loses_little_is_kept(trained):
    def offer(basis: int, lost_db: float) -> Offer:
        price = tier_prices.Price(Tier.LINEAR, basis, 1.0, 1.0, 30.0, lost_db)
        return Offer(price, LinearCorrectives(*[None] * 6))

    offers = [Offer(tier_prices.Price(Tier.EXACT, 0, 9.0, 0.1, 30.0, 0.0))]
    assert best_linear(offers) is None
    offers += [offer(4, 0.3), offer(8, 0.09), offer(16, 0.01)]
    assert best_linear(offers).price.basis == 8
    assert best_linear(offers[:2]).price.basis == 4
    assert best_linear([offers[0], offer(4, 0.3), offer(8, 0.2)]).price.basis == 8


def test_made_up_poses_are_not_measured_where_the_tier_was_fitted(trained):
    by = exact_tier_measure(trained)
    measured = flat_poses(trained, by.subject.poses[::POSE_STEP])
    nearest = torch.cdist(measured, by.known_poses, p=float("inf")).amin(1)
    assert float(torch.rad2deg(nearest).median()) > 10.0  # observed 14


def test_an_independent_error_costs_what_the_sum_of_errors_says(trained):
    by = exact_tier_measure(trained)
    assert by.lost_db(100.0, 100.0) == 0
    assert by.lost_db(100.0, 33.4) == pytest.approx(3.0103, abs=1e-4)
    assert by.lost_db(100.0, 59.0) == pytest.approx(0.012, abs=1e-3)
    assert by.psnr_db(trained) == 100.0
