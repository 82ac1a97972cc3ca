"""What the panels say, from what the engine says."""

import pytest

from blender_addon.core import panel_text
from blender_addon.core.bone_maps import JointSource
from blender_addon.core.joints import NAMES
from blender_addon.errors import ADVICE, JGHandFailure
from blender_addon.renderer.link import Status

HANDSHAKE = {"engine_version": "0.1.0", "pid": 42}
RECEIPT = {
    "total_ms": 7.24,
    "backend": "avx2",
    "threads": 2,
    "gaussians": 60000,
    "visible_gaussians": 51000,
    "invalid_gaussians": 0,
    "notes": [],
    "stages": [
        {"name": "skin", "ran": True, "milliseconds": 1.81, "reason": "correctives exact"},
        {"name": "raster", "ran": True, "milliseconds": 3.62, "reason": ""},
    ],
}


@pytest.mark.parametrize(
    ("status", "text", "good", "buttons"),
    [
        (Status("stopped", 0.0), "Renderer off: starts when needed", True, []),
        (Status("starting", 12.4), "Starting…  12 s", True, []),
        (Status("ready", 200.0, None, HANDSHAKE), "Ready · CPU · 7.2 ms", True, []),
        (Status("slow", 90.0, None, HANDSHAKE), "The renderer is not answering", False, ["jghand.restart_engine"]),
        (Status("stopping", 1.0), "Stopping…  1 s", True, []),
    ],
)
def test_every_state_has_a_line_and_the_buttons_that_fit(status, text, good, buttons):
    said = panel_text.status_text(status, RECEIPT)
    assert (said.text, said.good) == (text, good)
    assert [operator for operator, _ in said.buttons] == buttons


@pytest.mark.parametrize("kind", ADVICE)
def test_every_failure_says_what_happened_when_and_what_to_do(kind):
    said = panel_text.status_text(Status("failed", 130.0, JGHandFailure(kind, "line 7")))
    assert not said.good
    assert said.text == ADVICE[kind].sentence
    assert said.remedy == ADVICE[kind].remedy
    assert (said.since, said.detail) == ("2 min ago", "line 7")
    assert len(said.buttons) == 2


def test_before_the_first_picture_a_busy_engine_says_what_it_is_at():
    assert panel_text.status_text(Status("ready", 3.0, None, HANDSHAKE, busy=True)).text == "First frame…"
    assert panel_text.status_text(Status("ready", 3.0, None, HANDSHAKE)).text == "Ready"


def test_a_ready_engine_says_what_drew_the_last_picture():
    """Not what was asked to: a card that fails leaves the drawing to the processor."""
    on_card = RECEIPT | {"backend": "v4, Some Card (DiscreteGPU) via Vulkan"}
    assert panel_text.status_text(Status("ready", 3.0, None, HANDSHAKE), on_card).text == "Ready · GPU · 7.2 ms"


def test_an_engine_that_loads_is_not_called_ready():
    status = Status("ready", 3.0, None, HANDSHAKE, busy=True, doing="Loading the avatar")
    assert panel_text.status_text(status, RECEIPT).text == "Loading the avatar…"


def test_a_ready_engine_says_since_when_in_the_small_print():
    assert "2 h" in panel_text.status_text(Status("ready", 7300.0, None, HANDSHAKE)).detail


def test_a_receipt_becomes_bars_of_the_stages_that_ran():
    total, skin, raster = panel_text.receipt_lines(RECEIPT)
    assert (total.text, total.value, total.part, total.good) == ("Last Frame", "7.2 ms", 1.0, True)
    assert total.tip == "51,000 of 60,000 splats, drawn by avx2 on 2 threads"
    assert (skin.text, skin.value, skin.part, skin.tip) == ("Skin", "1.8 ms", 0.25, "correctives exact")
    assert (raster.text, raster.part, raster.tip) == ("Drawing", 0.5, "")


def test_a_picture_over_its_budget_is_told():
    assert panel_text.receipt_lines(RECEIPT, budget_ms=8.0)[0].good
    over = panel_text.receipt_lines(RECEIPT, budget_ms=5.0)[0]
    assert (over.text, over.good) == ("Over Budget", False)
    assert "budget is 5.0 ms" in over.tip


def test_a_joint_out_of_its_trained_range_is_named_before_everything_else():
    notes = ["The palm is nearly a line.", "index1 flexion 105°: 12° outside the 0° to 93° that was trained"]
    first, second = panel_text.warnings({**RECEIPT, "notes": notes})
    assert first.text == "index1: flexion 12° outside trained range"
    assert first.tip.startswith(notes[1])
    assert not first.tip.endswith(".")
    assert second.text == "The palm is nearly a line"


def test_a_warning_names_its_hand_where_there_are_several():
    notes = ["hand 2: index1 flexion 105°: 12° outside the 0° to 93° that was trained", "hand 1: a bone has no length"]
    report = {**RECEIPT, "notes": notes, panel_text.HANDS: ("Left Hand", "Right Hand")}
    first, second = panel_text.warnings(report)
    assert first.text == "Right Hand: index1: flexion 12° outside trained range"
    assert second.text == "Left Hand: a bone has no length"


def test_the_engines_own_sentence_about_a_joint_is_understood():
    pose_range = pytest.importorskip("jghand_engine.avatar.pose_range", reason="the engine is not installed")
    for angle in (1.9, -0.6):
        one = pose_range.OutOfRange("thumb2 abduction", 0, angle, -0.2, 0.6, abs(angle) - 0.2)
        (said,) = panel_text.warnings({"notes": [one.sentence()]})
        assert said.text.startswith("thumb2: abduction ")


def test_many_warnings_are_a_few_lines_and_one_for_the_others():
    lines = panel_text.warnings({"notes": [f"Note {number}." for number in range(9)]})
    first, second, others = panel_text.folded(lines, 2)
    assert (first.text, second.text, others.text) == ("Note 0", "Note 1", "7 more warnings")
    assert others.tip.splitlines()[0] == "Note 2"
    assert panel_text.folded(lines[:3], 2) == lines[:3]


def test_damaged_splats_are_told():
    (said,) = panel_text.warnings({**RECEIPT, "invalid_gaussians": 3})
    assert said.text.startswith("3 splats")


def whole_map() -> list[JointSource | None]:
    return [JointSource(f"bone {name}") for name in NAMES]


def test_a_bone_map_says_what_it_misses():
    sources = whole_map()
    bones = [source.bone for source in sources]
    (said,) = panel_text.map_lines(sources, bones)
    assert said.good
    sources[3] = None
    sources[5] = JointSource("renamed")
    sources[9] = sources[10]
    lines = panel_text.map_lines(sources, bones)
    assert [line.good for line in lines] == [False, False, False]
    assert "1 of 21 joints have no bone: thumb3" in lines[0].text
    assert "index1 (renamed)" in lines[1].text
    assert "middle1 = middle2" in lines[2].text


def test_a_list_shows_the_end_of_names_that_tells_bones_apart():
    names = ["mixamorig:RightHand", "mixamorig:RightHandIndex1", ""]
    assert panel_text.shortened(names[1], names) == "…Index1"
    assert panel_text.shortened(names[0], names) == names[0]
    assert panel_text.shortened("other", names) == "other"
    assert panel_text.shortened("hand.R", ["hand.R", "f_index.01.R"]) == "hand.R"


def test_sentences_of_the_engine_name_controls_and_no_options():
    told = panel_text.in_blenders_words
    assert told("a.training: wanted no training. Resume it with --resume, or name another folder with --work.") == (
        'a.training: wanted no training. Resume it with "Resume".'
    )
    assert told("The checkpoint is of other options. Continue with --resume or --fresh.") == (
        'The checkpoint is of other options. Continue with "Resume" or "Restart…".'
    )
    assert told("No hands in it: run it with --hand, or with another.") == "No hands in it."
    assert told("No hands in it; run it with --hand.") == "No hands in it."
    assert told("The training is safe: --resume --work a with another --out writes it.") == "The training is safe."


@pytest.mark.parametrize("path", ["/a/b.jghand", "/shots/hand--final.jghand", "/shots/hand--size/x", "/--size/x"])
def test_a_path_with_hyphens_is_said_as_it_is(path):
    for text in (path, f"{path}: not there.", f'Not there: "{path}".'):
        assert panel_text.in_blenders_words(text) == text


def test_durations_and_paragraphs_are_short():
    assert [panel_text.duration(s) for s in (-1, 59, 59.6, 61, 7200)] == ["0 s", "59 s", "1 min", "1 min", "2 h 00 min"]
    assert panel_text.duration(3900) == "1 h 05 min"
    assert panel_text.wrapped("one two three four", 12) == ["one two", "three four"]
    assert panel_text.wrapped("one threeteen two", 6) == ["one", "threeteen", "two"]
    assert panel_text.wrapped("a b", 10, lambda text: 8 * len(text)) == ["a", "b"]
    assert panel_text.wrapped("", 40) == [""]
