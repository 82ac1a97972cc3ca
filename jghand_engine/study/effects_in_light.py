"""What skipping effects saves and costs in the light of a scene: the second table of `jghand study effects`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from jghand_engine.avatar.scene_light import Lamp, SceneLight, World
from jghand_engine.export.light_file import ENV_FROM_WORLD
from jghand_engine.learn.tables import Table, number
from jghand_engine.native.scene_light_task import LampKind
from jghand_engine.render.effect_plan import OF_SCENE, Choice, Decision, Effect
from jghand_engine.render.renderer import SceneRenderer
from jghand_engine.render.settings import RenderSettings
from jghand_engine.render.subject import Subject

# frames of each light
FRAMES = 12
# radiance of a sky and of the ground below it, W/(m2 sr): skin is shown without clipping
SKY, GROUND = (0.35, 0.4, 0.5), (0.12, 0.1, 0.08)
# a sun, a lamp and an area around a hand, and a lamp of 0.1 % of their light
KEY = Lamp(LampKind.SUN, (1.2, 1.1, 1.0), (0.5, 0.7, 0.8), angle_rad=0.01)
LAMPS = (
    KEY,
    Lamp(LampKind.POINT, (0.1, 0.08, 0.05), (-0.3, 0.25, 0.3), radius_m=0.03),
    Lamp(LampKind.AREA, (3, 3, 3), (0.1, 0.5, -0.4), (-0.1, -0.6, 0.7), size_m=(0.25, 0.25)),
)
WEAK = Lamp(LampKind.SUN, (0.004, 0.004, 0.004), (-0.8, 0.3, 0.5))
# how far a dragged lamp turns around the hand from frame to frame, radians
DRAG_RAD = 0.05


@dataclass
class LightRow:
    """One light.

    errors:  worst difference of a channel, 0..1, of each frame as it is displayed from the same with all effects
    ms:      of the frames
    all_ms:  of the same with all effects
    skipped: what the last frame left out, and why
    """

    name: str
    errors: list[float] = field(default_factory=list)
    ms: list[float] = field(default_factory=list)
    all_ms: list[float] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)


def world_and_lamps() -> SceneLight:
    """A sky above a ground, and LAMPS."""
    up = np.where(np.arange(16)[:, None, None] < 8, SKY, GROUND)
    return SceneLight(World(np.broadcast_to(up, (16, 32, 3)), ENV_FROM_WORLD), LAMPS)


def measure_lights(subject: Subject, settings: RenderSettings) -> list[LightRow]:
    """Frames of a motion in the light that the hand has where no scene lights it, and in several of scenes, drawn in
    turn, so that a busy machine hits all alike; in the last a lamp moves around a hand at rest. None for a hand that no
    scene can light."""
    learned = subject.avatar.learned
    if learned is None or learned.cast is None:
        return []
    whole = world_and_lamps()
    world = whole.world
    picked = np.linspace(0, len(subject.poses) - 1, FRAMES).astype(int)
    moving, resting = subject.poses[picked], np.repeat(subject.poses[:1], FRAMES, 0)
    always: dict[str, SceneLight | None] = {
        "the hand's own": None,
        "a world": SceneLight(world),
        "a world and 3 lamps": whole,
        "and a weak lamp": SceneLight(world, (*LAMPS, WEAK)),
    }
    dragged = [SceneLight(world, (_turned(KEY, DRAG_RAD * frame), *LAMPS[1:])) for frame in range(FRAMES)]
    lights = {name: (moving, [light] * FRAMES) for name, light in always.items()}
    lights["a lamp is dragged"] = (resting, list(dragged))
    both = settings, replace(settings, effects=Choice.parse("all"))
    renderers = {
        name: [SceneRenderer([subject.avatar], each, own[0]) for each in both] for name, (_, own) in lights.items()
    }
    for renderer in (one for pair in renderers.values() for one in pair):
        renderer.render([subject.poses[0]], subject.camera)
    rows = {name: LightRow(name) for name in lights}
    for index in range(FRAMES):
        for name, (poses, own) in lights.items():
            for renderer in renderers[name]:
                renderer.light = own[index]
            frame, other = (one.render([poses[index]], subject.camera) for one in renderers[name])
            rows[name].errors.append(float(np.abs(frame.displayed() - other.displayed()).max()))
            rows[name].ms.append(frame.report.total_ms)
            rows[name].all_ms.append(other.report.total_ms)
            decisions = () if frame.report.plan is None else frame.report.plan.decisions
            rows[name].skipped = [f"{one.effect}: {one.reason}" for one in decisions if _leaves_out(one)]
    return list(rows.values())


def light_table(rows: Sequence[LightRow]) -> Table:
    cells = [
        (
            row.name, f"{255 * max(row.errors):.2g}", number(float(np.median(row.ms)), 2),
            number(float(np.median(row.all_ms)), 2), "; ".join(row.skipped),
        )
        for row in rows
    ]  # fmt: skip
    columns = ("Light", "Worst error, 8-bit steps", "ms a frame", "ms with all effects", "Left out of the light")
    notes = (
        f"{FRAMES} frames of each light, after a first one, in turn. Worst error: the largest difference of any "
        "channel of any pixel, displayed without exposure, from the same frames with all effects forced; ms: medians.",
    )
    return Table("In the light of a scene", columns, tuple(cells), notes)


def _leaves_out(decision: Decision) -> bool:
    """Whether some of the light is missing: of lamps that run the figure is what the others would give. Sharp edges
    move some, and a preset asks for them or not."""
    faint = decision.effect in (Effect.LAMPS, Effect.LAMP_SHADOW) and any(decision.figures)
    return decision.effect in OF_SCENE - {Effect.SHARP_SHADOW} and (faint or not decision.runs)


def _turned(lamp: Lamp, angle_rad: float) -> Lamp:
    """Around the axis that points up."""
    x, y, z = lamp.place_m
    cosine, sine = float(np.cos(angle_rad)), float(np.sin(angle_rad))
    return replace(lamp, place_m=(cosine * x + sine * z, y, cosine * z - sine * x))
