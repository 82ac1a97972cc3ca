"""`jghand study effects`: what is skipped on a motion, what that costs in accuracy and saves in time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from jghand_engine.cli.console import progress, say, say_whole_table, write_json
from jghand_engine.cli.study_files import Places, study_folder, write_bytes
from jghand_engine.files import make_folder

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np

    from jghand_engine.avatar.avatar import HandAvatar
    from jghand_engine.cli.options import FormatOptions
    from jghand_engine.render.camera import Camera
    from jghand_engine.study.effects_study import EffectsStudy, GateRow, GateSample

PICTURE = "effects.png"
SIZE_PX = (512, 334)
# pictures of a capture that calibrate the gate, at most, evenly spread
CAPTURE_PICTURES = 200
# every how manieth frame of the motion does
MOTION_STEP = 3


@dataclass(frozen=True)
class EffectsRequest:
    """avatar: name or file · motion: file, None for named poses · format: of the file · capture: folder of pictures for
    the gate, None for named poses · places: where everything goes"""

    avatar: str
    motion: Path | None
    format: FormatOptions
    capture: Path | None
    places: Places


def run_effects(request: EffectsRequest) -> None:
    """Measures, prints, and writes effects.md, effects.json and effects.png; in a checkout also its part of docs/."""
    from jghand_engine.avatar.builtin import load_avatar_called
    from jghand_engine.study.effects_plot import draw_figure
    from jghand_engine.study.figures import check_matplotlib, png_of

    request.places.check()
    folder = study_folder(request.places.out)
    check_matplotlib()
    study = _measured(load_avatar_called(request.avatar), request)
    for table in study.tables():
        say_whole_table(table)
    picture = png_of(draw_figure(study))
    section = [
        f"![What ran on each frame, and what that saved]({PICTURE})",
        "",
        *(t.markdown() for t in study.tables()),
    ]
    make_folder(folder)
    write_bytes(folder / PICTURE, picture)
    write_bytes(folder / "effects.md", "\n".join(section).encode())
    content = {"command": "study effects", **study.as_dict()}
    for path in (folder / "effects.json", request.places.json):
        if path is not None:
            write_json(path, content)
    say(f"{folder / PICTURE} written; effects.md and effects.json are beside it")
    if request.places.checkout is not None:
        _renew_docs(request.places.checkout / "docs", picture, section)


def _renew_docs(docs: Path, picture: bytes, section: list[str]) -> None:
    """The picture, and the part of EFFECTS.md that was measured."""
    from jghand_engine.study.pages import Section

    part, page = Section("effects"), docs / "EFFECTS.md"
    text = part.renewed(page.read_text(encoding="utf-8"), part.filled("", *section), page.name)
    write_bytes(docs / PICTURE, picture)
    write_bytes(page, text.encode())
    say(f"{page} renewed")


def _measured(avatar: HandAvatar, request: EffectsRequest) -> EffectsStudy:
    from jghand_engine.cli.framing import framing_camera
    from jghand_engine.render.settings import preset
    from jghand_engine.study import effects_study as study

    poses, avatar, told = _poses(avatar, request)
    width, height = SIZE_PX
    camera = framing_camera(poses, avatar.handedness, "quarter", width=width, height=height)
    subject = study.Subject("motion", avatar, poses, [camera] * len(poses))
    settings = replace(preset("viewport"), antialias=True)
    with progress("Measuring", len(poses) + 5 * study.SOME) as bar:
        task = bar.task_ids[0]
        rows, strip = study.effects_of_motion(subject, settings, lambda: bar.advance(task))
        rows += study.maps_and_cameras(subject, settings, lambda: bar.advance(task))
    rows.append(study.hands_approaching(avatar, poses[0], camera, settings))
    title = f"{avatar.info.name}, {told}, {len(poses)} frames of {width} x {height}"
    gate = [*_gate_of_motion(avatar, poses, camera), *_gate(avatar, camera, request)]
    return study.EffectsStudy(title, rows, gate, strip)


def _poses(avatar: HandAvatar, request: EffectsRequest) -> tuple[np.ndarray, HandAvatar, str]:
    """Joints of the motion, the avatar of that hand, and what it is."""
    from jghand_engine.study.effects_study import named_motion

    if request.motion is None:
        return named_motion(avatar), avatar, "named poses with ways between them"
    from jghand_engine.cli.inputs import read_sequence

    sequence = read_sequence(request.motion, request.format).with_gaps_held().with_constant_bone_lengths()
    return sequence.joints_m, avatar.for_hand(sequence.handedness), request.motion.name


def _gate_of_motion(avatar: HandAvatar, poses: np.ndarray, camera: Camera) -> list[GateRow]:
    """Frames of the motion: there the gate is closed, too, which captures have hardly any pictures of."""
    chosen = range(0, len(poses), MOTION_STEP)
    return _gate_rows(avatar, [(f"motion/{index}", poses[index], camera) for index in chosen])


def _gate(avatar: HandAvatar, camera: Camera, request: EffectsRequest) -> list[GateRow]:
    """Each named pose, or pictures of the capture."""
    from jghand_engine.hand.anatomy import named_pose, pose_names

    if request.capture is None:
        canonical = avatar.canonical_joints_m.numpy()
        poses = {name: named_pose(name, canonical, handedness=avatar.handedness) for name in pose_names()}
        return _gate_rows(avatar, [(name, joints_m, camera) for name, joints_m in poses.items()])
    from jghand_engine.captures.capture_folder import open_capture

    capture = open_capture(request.capture)
    step = -(-len(capture.samples) // CAPTURE_PICTURES)
    return _gate_rows(avatar.for_hand(capture.handedness), capture.samples[::step])


def _gate_rows(avatar: HandAvatar, samples: Sequence[GateSample]) -> list[GateRow]:
    """What the gate says and what the shadow does, of each sample."""
    from jghand_engine.render.frame import HandRenderer
    from jghand_engine.render.settings import ShadowMode, preset
    from jghand_engine.study.effects_study import gate_row

    renderer = HandRenderer(avatar, replace(preset("viewport"), shadow=ShadowMode.OFF))
    return [gate_row(renderer, avatar, sample) for sample in samples]
