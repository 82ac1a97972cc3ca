"""`jghand capture`: pictures of a hand to learn from, made with Blender's Cycles."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from jghand_engine.cli.console import progress, say, write_figures
from jghand_engine.cli.options import FiguresFile, File, FormatOptions, parse_shard, pixels
from jghand_engine.errors import InputError, RetryError

if TYPE_CHECKING:
    from jghand_engine.captures.making.plan import CapturePlan
    from jghand_engine.captures.making.worker import Finished
    from jghand_engine.captures.skin.person import Person

DESCRIPTION = """Make a training set: pictures of a rigged hand of another shape, path traced from all sides.

The layout is that of InterHand2.6M. Needs Blender as a Python module (bpy) in an environment of its own. A
capture that was stopped goes on where it was with the same command; pictures that are missing or broken are made
again.

Examples:
  jghand capture --identity 3 --cameras 16 --poses 25 --out captures/id3
  jghand capture --identity child --person 7 --out captures/child
  jghand capture --identity adult_woman --motion dance.npz --out captures/dance
  jghand capture --identity 3 --lights varied --out captures/id3_lit
  jghand capture --identity 3 --out captures/id3 --shard 1/2     and on another machine --shard 2/2"""

# seconds between two lines of progress where no terminal shows a bar
_LINE_EVERY_S = 60.0
_OneNumber = tyro.conf.arg(metavar="NUMBER")


@dataclass(frozen=True)
class LookOptions:
    """Light and skin."""

    person: Annotated[
        str | None, tyro.conf.arg(metavar="NUMBER|PERSON.json", help_behavior_hint="(default: usual numbers)")
    ] = None
    """Whose skin: the seed of anybody's, or a file with some numbers of a person (docs/SKIN.md). Left out: a person of
    usual numbers, the same for every --seed."""
    lights: Annotated[str, tyro.conf.arg(metavar="NAME|FILE|varied")] = "studio"
    """Soft lamps, and all around city, courtyard, forest, interior, night, studio, sunrise, sunset, or an .exr or .hdr
    file, which is copied into the capture; varied: another world and two other lamps in every picture, what each gives
    in a file of its own (picture.npz), for a hand that learns to stand in any light."""


@dataclass(frozen=True)
class Capture:
    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
    """Where the capture is written."""
    identity: Annotated[str, tyro.conf.arg(metavar="NUMBER|NAME")]
    """Whose hand: 0 slim_woman, 1 big_man, 2 old_person, 3 adult_man, 4 adult_woman, 5 child, 6 long_fingers."""
    cameras: Annotated[int, _OneNumber] = 16
    """How many see a pose, close-ups included."""
    close_ups: Annotated[int | None, tyro.conf.arg(metavar="NUMBER", help_behavior_hint="(default: one of four)")] = (
        None
    )
    """How many of these see a part of the hand: palm, knuckles, tips and nails by turns, in every pose from another
    side. Always 384x384 pixels of 0.18 mm, with 32 rays or more."""
    poses: Annotated[int, _OneNumber] = 25
    """How many."""
    size: Annotated[str, tyro.conf.arg(metavar="WIDTHxHEIGHT")] = "501x768"
    """Pixels of the pictures of the whole hand."""
    samples: Annotated[int, _OneNumber] = 6
    """Rays per pixel of these; the rest of the noise is filtered away. Close-ups have twice as many, at least 32."""
    subdivisions: Annotated[int, _OneNumber] = 3
    """How often the mesh is made finer for rendering; 3, edges of 0.6 mm, lets folds, veins and tendons shape it."""
    look: LookOptions = field(default_factory=LookOptions)
    motion: File = None
    """Poses from this motion instead of the generator; `jghand motion` makes one of any file that it reads."""
    seed: Annotated[int, _OneNumber] = 0
    """Of poses, cameras and turns."""
    shard: Annotated[str, tyro.conf.arg(metavar="NUMBER/COUNT")] = "1/1"
    """Make only this part of the pictures; other machines make the others."""
    finished_only: bool = False
    """Make no picture, and annotate only poses whose pictures are all there: to use a capture before its end."""
    blender_python: File = None
    """The Python that can import bpy. Left out: that of .envs/blender, else the running one."""
    threads: Annotated[int, _OneNumber] = 0
    """Threads of Cycles; 0 takes one for each processor that this process may use."""
    json: FiguresFile = None

    def run(self) -> None:
        from jghand_engine.captures.making.plan import annotate, open_or_make, shard_locked
        from jghand_engine.captures.making.worker import find_blender_python

        shard = parse_shard(self.shard)
        if self.threads < 0:
            raise InputError("--threads", wanted="0 or more", came=str(self.threads))
        options = self._options()
        if self.finished_only:
            self._annotate_finished(options)
            return
        python = find_blender_python(self.blender_python)
        plan = open_or_make(self.out, options)
        # --finished-only may have left poses out
        annotate(self.out, plan)
        with shard_locked(self.out, shard):
            self._make(plan, shard, python)
        # ... also meanwhile
        if all(job.file.exists() for job in plan.jobs(self.out)):
            annotate(self.out, plan)

    def _make(self, plan: CapturePlan, shard: tuple[int, int], python: Path) -> None:
        """Makes what is missing or broken of a shard, and says so."""
        from jghand_engine.captures.making.worker import fault_of

        jobs = plan.jobs(self.out, shard)
        faults = [fault_of(job) for job in jobs]
        todo = [job for job, fault in zip(jobs, faults, strict=True) if fault]
        spoilt = sum(bool(fault) and fault != "missing" for fault in faults)
        cameras = len(plan.cameras_of(0))
        say(f"{len(plan.pose_names)} poses x {cameras} cameras; shard {self.shard} has {len(jobs)} pictures.")
        if len(todo) < len(jobs) or spoilt:
            say(f"{len(jobs) - len(todo)} are there already, {spoilt} are broken or of another plan and made again.")
        finished = self._render(todo, python)
        broken = {job.file: fault for job in todo if (fault := fault_of(job))}
        if broken:
            file, fault = next(iter(broken.items()))
            raise RetryError(f"{len(broken)} pictures are not whole, the first {file}: {fault}", remedy="Start again.")
        each = sum(done.seconds for done in finished) / len(finished) if finished else 0.0
        say(f"Wrote {self.out}: {len(todo)} pictures, {each:.1f} s each.")
        by_size = _costs(finished)
        for size, cost in by_size.items():
            say(f"{size}: {cost['cpu_seconds_each']:.1f} CPU seconds, {1e-6 * cost['bytes_each']:.2f} MB each.")
        write_figures(self.json, {
            "command": "capture", "pictures": len(jobs), "rendered": len(todo), "remade": spoilt,
            "seconds_each": each, "by_size": by_size, "poses": list(plan.pose_names), "cameras": cameras,
        })  # fmt: skip

    def _annotate_finished(self, options) -> None:
        from jghand_engine.captures.making.plan import annotate, open_begun
        from jghand_engine.captures.making.worker import fault_of

        plan = open_begun(self.out, options)
        unfinished = {job.pose for job in plan.jobs(self.out) if fault_of(job)}
        finished = set(range(len(plan.pose_names))) - unfinished
        if not finished:
            raise InputError(f"the capture in {self.out}", wanted="at least one pose with all pictures", came="none")
        annotate(self.out, plan, finished)
        say(f"Annotated {len(finished)} of {len(plan.pose_names)} poses; without --finished-only it is all of them.")

    def _render(self, todo: list, python: Path) -> list[Finished]:
        from jghand_engine.captures.making.worker import render
        from jghand_engine.learn.progress import duration
        from jghand_engine.native.threads import processors

        finished: list[Finished] = []
        started = shown = time.monotonic()
        with progress("pictures", len(todo)) as bar:
            for done in render(self.out, todo, python, self.threads or processors()):
                finished.append(done)
                bar.advance()
                now = time.monotonic()
                if bar.unseen and now - shown > _LINE_EVERY_S:
                    left_s = (now - started) / len(finished) * (len(todo) - len(finished))
                    say(f"{len(finished)} of {len(todo)} pictures, {duration(left_s)} left")
                    shown = now
        return finished

    def _options(self):
        from jghand_engine.captures.making.lights import VariedLight
        from jghand_engine.captures.making.options import CaptureOptions, Light, Sampling
        from jghand_engine.cli.inputs import read_sequence

        # bones may be of any length: the poses are those of the identity's own
        motion = None if self.motion is None else read_sequence(self.motion, FormatOptions(any_proportions=True))
        width, height = pixels(self.size)
        return CaptureOptions(
            identity=self.identity, cameras=self.cameras,
            close_ups=self.cameras // 4 if self.close_ups is None else self.close_ups,
            poses=self.poses, width=width, height=height, skin=self._person(), motion=motion,
            seed=self.seed,
            light=VariedLight() if self.look.lights == "varied" else Light(self.look.lights),
            sampling=Sampling(samples=self.samples, subdivisions=self.subdivisions),
        )  # fmt: skip

    def _person(self) -> Person:
        from jghand_engine.captures.skin.person import Person

        given = self.look.person
        if given is None:
            # whatever the capture's seed: pictures of other poses and lights shall show the same skin
            return Person()
        return Person.drawn(int(given)) if given.isdecimal() else Person.of_file(Path(given))


def _costs(finished: list[Finished]) -> dict[str, dict[str, float]]:
    """What a picture took of processors and of the disk, by its size in pixels."""
    from jghand_engine.captures.known_light import groups_file

    sizes = dict.fromkeys(done.job.size_px for done in finished)
    costs = {}
    for size in sizes:
        alike = [done for done in finished if done.job.size_px == size]
        files = [file for done in alike for file in (done.job.file, groups_file(done.job.file)) if file.exists()]
        costs["{}x{}".format(*size)] = {
            "cpu_seconds_each": sum(done.cpu_seconds for done in alike) / len(alike),
            "bytes_each": sum(file.stat().st_size for file in files) / len(alike),
        }
    return costs
