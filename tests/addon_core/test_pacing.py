"""When a view asks for a picture, how good a one, how long it waits, and what it shows, as lists of events."""

import math
from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import strategies as st

from blender_addon.core import pacing
from blender_addon.core.pacing import Activity, Ask, DrawMoment, Grade, Pace, ViewSettings, Want

FRAME_S = 1 / 24
PLAYING, SCRUBBING, POSING = Activity.PLAYING, Activity.SCRUBBING, Activity.POSING
A, B, C = (Want(name, "front", 500_000) for name in "ABC")
A_FROM_BEHIND = Want("A", "behind", 500_000)


@dataclass
class View:
    """A view and its engine's answers, with a clock of its own."""

    settings: ViewSettings = field(default_factory=ViewSettings)
    pace: Pace = field(default_factory=Pace)
    now_s: float = 100.0
    asked: list[Ask] = field(default_factory=list)
    waits: list[float] = field(default_factory=list)

    def moment(self, activity: Activity = POSING, **more) -> DrawMoment:
        return DrawMoment(self.now_s, activity, FRAME_S, **{"step_s": self.now_s, **more})

    def draw(self, want: Want, activity: Activity = POSING, **more) -> pacing.Decision:
        self.pace, decision = pacing.step(self.pace, want, self.moment(activity, **more), self.settings)
        if decision.ask:
            self.asked.append(decision.ask)
        self.waits.append(decision.wait_s)
        return decision

    def answer(self, which: int = -1, failure: str | None = None, took_s: float = 0.01) -> bool:
        self.pace, shown = pacing.answered(self.pace, self.asked[which].tag, failure, took_s, self.moment())
        return shown

    def pass_s(self, seconds: float) -> None:
        """Time without a redraw; the timer looks again when it is due."""
        end = self.now_s + seconds
        while (due := pacing.due_s(self.pace, self.settings)) <= end and self.pace.want is not None:
            self.now_s = max(self.now_s, due)
            before = len(self.asked)
            self.draw(self.pace.want)
            if len(self.asked) > before:
                self.answer()
            elif pacing.due_s(self.pace, self.settings) <= self.now_s:
                raise AssertionError("the timer would look again and again for nothing")
        self.now_s = end

    def shows(self, activity: Activity = POSING, **more) -> Want | None:
        return self.pace.shown.want if pacing.may_show(self.pace, self.moment(activity, **more)) else None

    @property
    def grades(self) -> list[Grade]:
        return [ask.grade for ask in self.asked]


def view_of(want: Want, **more) -> View:
    """A view that shows its picture, at its sharpest."""
    view = View(**more)
    view.draw(want)
    view.answer()
    view.pass_s(2.0)
    view.asked.clear()
    return view


def test_the_first_picture_has_the_viewports_settings_and_becomes_sharp_after_a_pause():
    view = View()
    view.draw(A)
    view.answer()
    view.pass_s(5.0)
    assert [(ask.grade, ask.quality.preset) for ask in view.asked] == [
        (Grade.STILL, "viewport"),
        (Grade.SHARP, "final"),
    ]


def test_a_pose_that_is_dragged_is_drawn_fast_then_better_then_sharp():
    view = view_of(A)
    for want in (B, C):
        view.draw(want)
        view.answer()
        view.now_s += 0.02
    assert [ask.quality.preset for ask in view.asked] == ["draft", "draft"]
    view.pass_s(pacing.SETTLE_S)
    assert view.grades[-1] is Grade.STILL
    view.pass_s(pacing.SHARPEN_S)
    assert view.grades[-1] is Grade.SHARP
    assert [ask.droppable for ask in view.asked] == [grade is Grade.SHARP for grade in view.grades]
    view.pass_s(60.0)
    assert len(view.asked) == 4


def test_a_view_that_does_not_sharpen_stays_at_the_viewports_settings():
    view = view_of(A, settings=ViewSettings(sharp_preset=None))
    view.draw(B)
    view.answer()
    view.pass_s(60.0)
    assert view.grades == [Grade.MOVING, Grade.STILL]


def test_a_late_picture_of_the_fast_settings_does_not_replace_the_better_one():
    view = view_of(A)
    view.draw(B)
    view.now_s += pacing.SETTLE_S * 1.01
    view.draw(B)
    assert view.answer(1)
    assert not view.answer(0)
    assert view.pace.shown is not None
    assert view.pace.shown.grade is Grade.STILL


def test_an_earlier_pose_is_shown_for_a_short_time_only_while_nothing_newer_comes():
    view = view_of(A)
    for want in (B, C, B):
        view.draw(want)
        view.now_s += pacing.STALE_S / 2
    assert view.shows() is None
    view.draw(C)
    assert view.answer(-2)
    assert view.shows() == B
    view.now_s += pacing.STALE_S * 1.1
    assert view.shows() is None
    view.draw(B)
    assert view.shows() == B


def test_hands_stay_in_the_view_while_the_avatar_of_another_one_is_loaded():
    view = view_of(A)
    view.draw(B)
    view.now_s += 10 * pacing.STALE_S
    assert view.shows(loading=True) == A
    assert view.shows() is None
    view.draw(A_FROM_BEHIND, loading=True)
    assert view.shows(loading=True) is None, "never from another side"
    view.answer(failure="bad_avatar")
    assert view.shows(loading=True) is None


def test_an_earlier_pose_is_not_shown_when_no_picture_is_coming():
    view = view_of(A)
    view.draw(B)
    assert view.shows(answering=False) is None
    view.answer(failure="bad_avatar")
    assert view.shows() is None


def test_an_orbited_view_waits_a_little_and_shows_nothing_from_another_side():
    view = view_of(A)
    decision = view.draw(A_FROM_BEHIND)
    assert decision.wait_s == pacing.ORBIT_WAIT_S
    assert decision.wait_for == view.asked[-1].tag
    assert view.shows() is None
    view.answer()
    assert view.shows() == A_FROM_BEHIND


def test_an_orbited_view_does_not_wait_for_an_engine_that_was_slow_until_it_is_fast_again():
    view = view_of(A)
    view.draw(A_FROM_BEHIND)
    view.pace = pacing.gave_up_waiting(view.pace)
    sides = [Want("A", str(side), 500_000) for side in range(3)]
    assert view.draw(sides[0]).wait_s == 0
    view.answer(took_s=0.2)
    assert view.draw(sides[1]).wait_s == 0
    view.answer(took_s=0.01)
    assert view.draw(sides[2]).wait_s == pacing.ORBIT_WAIT_S


def test_while_playing_a_view_waits_for_the_rest_of_its_frame_and_no_longer_than_40_ms():
    view = view_of(A)
    start = view.now_s
    view.now_s += 0.01
    assert math.isclose(view.draw(B, PLAYING, step_s=start).wait_s, pacing.PLAY_WAIT_S - 0.01)
    view.now_s = start + 1.0
    assert view.draw(C, PLAYING, step_s=start).wait_s == 0


def test_late_frames_are_counted_once_each_and_from_the_start_of_the_playback():
    view = view_of(A)
    for _ in range(2):
        for want in (B, C):
            view.draw(want, PLAYING)
            for _ in range(3):
                view.pace = pacing.missed(view.pace, view.moment(PLAYING))
                assert view.draw(want, PLAYING).wait_s == 0
            view.answer(took_s=0.1)
        assert view.pace.late == 2
        view.draw(A)
        view.answer()


def test_after_some_late_frames_nobody_waits_until_an_answer_was_fast_enough():
    view = view_of(A)
    frames = [Want(str(frame), "front", 500_000) for frame in range(20)]
    for want in frames[:10]:
        view.draw(want, PLAYING)
        view.pace = pacing.missed(view.pace, view.moment(PLAYING))
    assert [wait > 0 for wait in view.waits[-10:]] == [True] * pacing.LATE_PATIENCE + [False] * (
        10 - pacing.LATE_PATIENCE
    )
    view.answer(took_s=0.01)
    assert view.draw(frames[11], PLAYING).wait_s > 0


def test_scrubbing_never_waits_and_is_refined_when_it_ends():
    view = view_of(A)
    for want in (B, A_FROM_BEHIND, C):
        view.draw(want, SCRUBBING)
        view.now_s += 0.02
    assert view.grades == [Grade.MOVING] * 3
    assert not any(view.waits)
    view.answer()
    view.pass_s(5.0)
    assert view.grades[3:] == [Grade.STILL, Grade.SHARP]


def test_a_failure_is_remembered_and_not_asked_for_again():
    view = view_of(A)
    view.draw(B)
    view.answer(failure="bad_avatar")
    for _ in range(5):
        view.draw(B)
    assert len(view.asked) == 1
    assert view.pace.failure() == "bad_avatar"
    view.draw(A)
    assert view.pace.failure() is None


def test_a_sharp_picture_that_fails_leaves_the_viewports_one():
    view = View()
    view.draw(A)
    view.answer()
    view.now_s += 1.0
    view.draw(A)
    view.answer(failure="out_of_memory")
    assert view.shows() == A
    assert math.isinf(pacing.due_s(view.pace, view.settings))


def test_after_a_new_start_of_the_engine_everything_may_be_asked_again():
    view = view_of(A)
    view.draw(B)
    view.answer(failure="crashed")
    view.pace = pacing.forgotten(view.pace)
    view.draw(B)
    assert len(view.asked) == 2
    assert view.pace.failure() is None


def test_a_picture_that_somebody_gave_up_is_asked_for_at_the_next_draw_and_not_by_the_timer():
    view = View(settings=ViewSettings(sharp_preset=None))
    view.draw(A)
    view.answer(failure="stopped")
    assert view.pace.failure() is None
    view.pass_s(10.0)
    assert len(view.asked) == 1
    view.draw(A)
    assert len(view.asked) == 2


def test_a_budget_replaces_the_presets_while_moving_and_still():
    settings = ViewSettings(budget_ms=12.0)
    moving, still, sharp = (pacing.quality_of(grade, settings) for grade in Grade)
    assert moving.budget_ms == still.budget_ms == 12.0
    assert sharp.budget_ms is None


WANTS = [Want(content, camera, pixels) for content in "AB" for camera in "xy" for pixels in (1000, 500_000)]
EVENTS = st.lists(
    st.one_of(
        st.tuples(st.just("draw"), st.sampled_from(WANTS), st.sampled_from(list(Activity)), st.booleans()),
        st.tuples(st.just("answer"), st.integers(0, 50), st.sampled_from([None, None, "bad_input", "stopped"])),
        st.tuples(st.just("pass"), st.floats(0.001, 0.7)),
        st.tuples(st.just("forget")),
    ),
    max_size=60,
)


@given(EVENTS)
def test_whatever_happens(events):
    """Waits are short, nothing wrong is shown, nothing is asked for twice, and in the end there is rest."""
    view = View()
    for kind, *more in events:
        if kind == "draw":
            want, activity, answering = more
            before = [ask.tag for ask in view.pace.asks[-1:]]
            decision = view.draw(want, activity, answering=answering)
            assert 0 <= decision.wait_s <= pacing.PLAY_WAIT_S
            assert not (activity is SCRUBBING and decision.wait_s)
            assert decision.ask is None or decision.ask.tag not in before
            shown = view.shows(activity, answering=answering)
            assert shown is None or shown.camera == want.camera
            assert answering or shown in (None, want)
        elif kind == "answer" and view.asked:
            view.answer(more[0] % len(view.asked), more[1])
        elif kind == "pass":
            view.now_s += more[0]
        elif kind == "forget":
            view.pace = pacing.forgotten(view.pace)
    if view.pace.want is not None:
        last = view.pace.want
        view.pace = pacing.forgotten(view.pace)
        view.draw(last)
        if view.asked and view.asked[-1].want == last:
            view.answer()
        view.pass_s(10.0)
        assert view.shows() == last
        assert math.isinf(pacing.due_s(view.pace, view.settings))


# ---- several views ---------------------------------------------------------------------------------------------------


def test_the_views_of_one_turn_wait_no_longer_together_than_one_of_them():
    turn, now_s, waited_s = pacing.Turn(), 10.0, 0.0
    for view in "abcd":
        turn.draws(view)
        left_s = turn.left_s(now_s + pacing.ORBIT_WAIT_S, now_s)
        now_s, waited_s = now_s + left_s, waited_s + left_s
    assert waited_s == pytest.approx(pacing.ORBIT_WAIT_S)


def test_each_turn_has_its_own_wait():
    turn = pacing.Turn()
    turn.draws("a")
    assert turn.left_s(1.0, 0.0) == 1.0
    turn.draws("b")
    assert turn.left_s(2.5, 1.5) == 0.0
    turn.draws("a")  # the next turn
    assert turn.left_s(3.0, 2.5) == 0.5
    turn.end()
    turn.draws("b")
    assert turn.left_s(4.0, 3.5) == 0.5
