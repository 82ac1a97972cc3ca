"""The web page in a headless Chromium: its buttons, sliders and turning do what they are for, and what goes wrong is
said. Skipped without Chromium and playwright-core (scripts/check_splat_files.py --install)."""

from dataclasses import replace
from pathlib import Path

import check_splat_files
import check_web_page
import numpy as np
import pytest
import show_splat_file
from small_avatars import known_avatar, small_avatar

from jghand_engine.avatar.avatar import LearnedFrom
from jghand_engine.export.web.page import WebView, export_web
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import pose_sequence_of_names
from jghand_engine.hand.sequence import PoseSequence

VIEW = WebView((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), 2.2, (0.012,) * 21)
WINDOW = {"width": 900, "height": 600}


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> Path:
    """The page of a crooked hand, as estimates give them, far from the origin."""
    if show_splat_file.browser() is None or not check_splat_files.node_has("playwright-core")():
        pytest.skip("there is no Chromium, or no playwright-core (scripts/check_splat_files.py --install)")
    folder = tmp_path_factory.mktemp("page")
    avatar = small_avatar()
    joints_m = pose_sequence_of_names(["open", "fist"], avatar.canonical_joints_m, handedness=Handedness.RIGHT).joints_m
    joints_m = joints_m + np.random.default_rng(8).normal(0, 3e-3, (21, 3)) + [1.0, 2.0, -3.0]
    export_web(folder, avatar, PoseSequence(joints_m, 30.0, Handedness.RIGHT), VIEW)
    return folder


def test_sliders_poses_and_turning_do_what_they_are_for(page, tmp_path):
    steps = [
        ["seek", 16], ["slide", "#curl1", 0.9], ["slide", "#curl0", 0.6], ["slide", "#curl4", 0.4], ["drag", 160, 30],
        ["pose", "ok"], ["slide", "#curl2", 0.8], ["click", "#home"],
    ]  # fmt: skip
    shot = {"name": "watched", **WINDOW, "watch": True, "steps": steps}
    found = check_web_page.visited(page, [shot], tmp_path)
    figures = found["shots"]["watched"]
    # a frame is shown like a pose
    assert check_web_page.idle({**shot, "steps": [["pose"], *steps[1:]]}, figures) == []
    assert (found["complaints"], found["foreign"], figures["message"]) == ([], [], "")


def test_the_light_is_turned_and_given_back(page, tmp_path):
    avatar = known_avatar()
    sequence = pose_sequence_of_names(["open", "fist"], avatar.canonical_joints_m, handedness=Handedness.RIGHT)
    export_web(tmp_path / "page", avatar, sequence, VIEW)
    steps = [
        ["seek", 3],
        ["slide", "#around", 90],
        ["run", "jghand.light(-90, 0)"],
        ["click", "#own"],
        ["click", "#own"],
    ]
    found = check_web_page.visited(
        tmp_path / "page", [{"name": "lit", **WINDOW, "watch": True, "steps": steps}], tmp_path
    )
    _, own, right, left, back, again = (each["picture"] for each in found["shots"]["lit"]["shown"])
    assert (found["complaints"], found["shots"]["lit"]["message"]) == ([], "")
    assert len({own, right, left}) == 3
    # the sliders follow whoever drives the page
    assert (back, again) == (own, left)


def test_a_hand_of_coarse_pictures_is_shown_softer(page, tmp_path):
    shown, avatar = [], small_avatar()
    sequence = pose_sequence_of_names(["open"], avatar.canonical_joints_m, handedness=Handedness.RIGHT)
    for pixel_m in (0.0, 5e-3):
        info = replace(avatar.info, learned_from=LearnedFrom("it", "all", 1, "0", pixel_m))
        folder = tmp_path / str(pixel_m)
        export_web(folder, replace(avatar, info=info), sequence, VIEW)
        found = check_web_page.visited(folder, [{"name": "still", **WINDOW, "watch": True, "steps": []}], folder)
        shown.append(found["shots"]["still"]["shown"][0]["picture"])
    assert shown[0] != shown[1]


def test_what_cannot_be_drawn_is_said_at_the_beginning_and_later(page, tmp_path):
    breaks = "WebGL2RenderingContext.prototype.drawElementsInstanced = () => { throw new Error('broken on purpose'); };"
    shots = [
        {"name": "at once", **WINDOW, "before": breaks, "steps": []},
        {"name": "later", **WINDOW, "steps": [["run", breaks], ["drag", 160, 30], ["pose", "fist"], ["seek", 3]]},
    ]
    found = check_web_page.visited(page, shots, tmp_path)["shots"]
    for figures in found.values():
        assert figures["message"].startswith("The hand cannot be shown.")
        assert "broken on purpose" in figures["message"]


def test_a_page_that_loses_the_graphics_card_says_so_and_draws_again_when_it_is_back(page, tmp_path):
    script = """new Promise(async (done) => {
        const canvas = document.getElementById('canvas'), shown = [];
        const card = canvas.getContext('webgl2').getExtension('WEBGL_lose_context');
        const wait = (ms) => new Promise((next) => setTimeout(next, ms));
        const look = () => shown.push([document.getElementById('message').textContent, jghand.drawn]);
        card.loseContext(); await wait(300); look();
        jghand.seek(2); await wait(800); look();
        card.restoreContext(); await wait(300); await jghand.settled(); look();
        jghand.seek(10); await jghand.settled(); look();
        await wait(1000);  // the hand has faded in again
        done(shown);
    })"""
    shot = {"name": "lost", **WINDOW, "watch": True, "steps": [["seek", 12], ["run", script], ["seek", 12]]}
    found = check_web_page.visited(page, [shot], tmp_path)
    figures = found["shots"]["lost"]
    (lost, _), (still_lost, before), (back, after), (moved, more) = figures["run"]
    assert "The graphics card is busy elsewhere." in lost
    assert (still_lost, back, moved) == (lost, "", "")
    assert before < after < more
    # frames 10 and 12, both after the loss
    assert figures["shown"][2]["picture"] != figures["shown"][3]["picture"]
    assert not [said for said in found["complaints"] if "rror" in said]


def test_who_drives_the_page_is_told_what_a_pose_a_frame_and_a_light_is(page, tmp_path):
    script = """["pose('nonsense')", "pose([[1]])", "seek(NaN)", "light(90)", "light(90, 0)", "light()"].map((call) => {
        try { eval('jghand.' + call); return ''; } catch (error) { return error.message; }
    })"""
    shot = {"name": "asked", **WINDOW, "steps": [["run", script]]}
    said = check_web_page.visited(page, [shot], tmp_path)["shots"]["asked"]["run"]
    assert ["one of open, flat" in said[0], "5 fingers of 4 angles" in said[1], "A frame is" in said[2]] == [True] * 3
    assert said[3:] == [
        "A light is two angles in degrees, not 90 and undefined.",
        "This hand has no light that can be turned.",
        "",
    ]
