"""InterHand2.6M, and our own captures, which are stored the same way. Layout: DATA 5.

    images/{train,val,test}/Capture{N}/{sequence}/cam{serial}/image{frame}.jpg
    annotations/{split}/InterHand2.6M_{split}_{data,camera,joint_3d}.json      (older: annotations/{all,…}/)
    masks_removeblack/{split}/…png                                             masks that others made, where there are

Its millimeters become meters, its tip-first joints level order, and x_camera = R (X - campos) our camera_from_world.
The hand that an image does not show is filled with ones there; only `joint_valid` tells. A principal point is taken
as measured from the image's corner, as in our own captures; the data set does not say whether it counts from there
or from the middle of the first pixel, which would be half a pixel.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from jghand_engine.captures.captures import Capture, CaptureChoice, Layout, sorted_samples
from jghand_engine.captures.image_files import probe_sized
from jghand_engine.captures.interhand_files import (
    INTERACTING,
    UNIT,
    CaptureTables,
    InterHandFiles,
    InterHandImage,
    find_files,
    read_annotations,
)
from jghand_engine.captures.masks import template_note
from jghand_engine.captures.reading import Report, Sieve
from jghand_engine.captures.sample import MaskSource, Sample
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import JointOrder

# why a protocol leaves an image out; None: it stays
DropRule = Callable[[Sample, InterHandImage], str | None]


def read_interhand(
    folder: Path | str,
    choice: CaptureChoice | None = None,
    *,
    drop_rule: DropRule | None = None,
    report: Report | None = None,
) -> Capture:
    """The images of one hand in a folder of the InterHand2.6M layout.

    The head of every image is read: InputError names the first that is missing, cut off or of another size than
    annotated. InputError too for damaged annotations, when the choice leaves more than one person or hand, and for
    joints that are no hand. Images without all 21 joints are left out.

    drop_rule: leaves more out, beside what has no MANO fit or no mask where the set has those of others
    report:    is told of broken images and implausible joints instead of the error, and the reading goes on
    """
    choice = choice or CaptureChoice()
    files = find_files(Path(folder), choice.split)
    return _Reader(files, choice, drop_rule, Sieve(report)).capture()


class _Reader:
    """One reading of one split."""

    def __init__(self, files: InterHandFiles, choice: CaptureChoice, drop_rule: DropRule | None, sieve: Sieve) -> None:
        self.files, self.choice, self.drop_rule, self.sieve = files, choice, drop_rule, sieve

    def capture(self) -> Capture:
        images = self._chosen(list(read_annotations(self.files)))
        handedness = self._handedness(images)
        tables = CaptureTables(self.files, images[0].capture)
        made = (self._sample(image, handedness, tables) for image in images)
        samples = sorted_samples(sample for sample in made if sample is not None)
        capture = Capture(
            name=f"{self.files.root.name} {self.files.split}/Capture{images[0].capture}",
            folder=self.files.root,
            layout=Layout.INTERHAND,
            samples=samples,
            handedness=handedness,
            dropped=self.sieve.dropped,
            notes=template_note(sum(sample.mask_source is MaskSource.TEMPLATE for sample in samples), len(samples)),
        )
        self.sieve.check_joints(capture.joints_m(), JointOrder.INTERHAND, UNIT, str(self.files.joint_3d))
        return capture

    def _chosen(self, images: list[InterHandImage]) -> list[InterHandImage]:
        """The images of the wanted person and sequences. InputError when there are none, or several persons."""
        images = self._on_disk(images)
        captures = sorted({image.capture for image in images})
        wanted = (self.choice.capture or self.files.capture or "").removeprefix("Capture")
        if not wanted and len(captures) > 1:
            raise InputError(
                f"data set {self.files.images}",
                wanted="the images of one person",
                came=f"{len(captures)} captures: {', '.join(f'Capture{name}' for name in captures)}",
                remedy="Name the folder of one person, such as images/test/Capture0, or a protocol.",
            )
        of_person = [image for image in images if wanted in ("", image.capture)]
        if not of_person:
            raise _unknown("capture", f"Capture{wanted}", [f"Capture{name}" for name in captures], self.files.data)
        present = sorted({image.sequence for image in of_person})
        sequences = self.choice.sequences or ((self.files.sequence,) if self.files.sequence else tuple(present))
        for name in sequences:
            if name not in present and not (self.choice.some and set(sequences) & set(present)):
                raise _unknown("sequence", name, present, self.files.data)
        return [image for image in of_person if image.sequence in sequences]

    def _on_disk(self, images: list[InterHandImage]) -> list[InterHandImage]:
        """Those of sequences that were downloaded: nobody has all of InterHand2.6M. InputError when there are none."""
        folders = {(image.capture, image.sequence): Path(image.file_name).parents[1] for image in images}
        there = {key for key, folder in folders.items() if (self.files.images / folder).is_dir()}
        kept = [image for image in images if (image.capture, image.sequence) in there]
        if not kept:
            raise InputError(
                f"images in {self.files.images}",
                wanted=f"folders such as {next(iter(folders.values()))}",
                came=f"none of the {len(folders)} sequences in {self.files.data.name}",
                remedy="Unpack the images as images/<split>/Capture<N>/<sequence>/cam<name>/.",
            )
        self.sieve.drop("sequence not downloaded", len(images) - len(kept))
        return kept

    def _handedness(self, images: Sequence[InterHandImage]) -> Handedness:
        if self.choice.handedness is not None:
            return self.choice.handedness
        hands = sorted({image.hand_type for image in images} - {INTERACTING})
        if len(hands) == 1:
            return Handedness(hands[0])
        raise InputError(
            f"hand of {self.files.images}",
            wanted="one hand",
            came=f"images of {' and '.join(hands)} hands" if hands else "only images with both hands",
            remedy="Say which hand, or choose sequences of one hand.",
        )

    def _sample(self, image: InterHandImage, handedness: Handedness, tables: CaptureTables) -> Sample | None:
        """The image as a sample, or None when it is left out (and counted)."""
        try:
            sample, reason = self._checked(image, handedness, tables)
        except InputError as error:
            self.sieve.broken(error)
            return None
        if reason is not None:
            self.sieve.drop(reason)
        return sample if reason is None else None

    def _checked(
        self, image: InterHandImage, handedness: Handedness, tables: CaptureTables
    ) -> tuple[Sample | None, str | None]:
        """(sample, None), or (anything, why it is left out)."""
        if image.hand_type != handedness:
            return None, "both hands" if image.hand_type == INTERACTING else f"{image.hand_type} hand"
        if not image.hand_type_valid:
            return None, "not sure which hand it is"
        joints_m = tables.joints(image, handedness)
        if joints_m is None:
            return None, "not all 21 joints known"
        if self.drop_rule and tables.has_fit(image, handedness) is False:
            return None, "no MANO fit"
        file = self.files.images / image.file_name
        facts = probe_sized(file, (image.width, image.height), self.files.data.name)
        mask = self._mask_file(image)
        # of a person without any the template's silhouette is taken
        masks = self.files.masks
        if self.drop_rule and mask is None and masks and (masks / Path(image.file_name).parts[0]).is_dir():
            return None, "no mask"
        # alpha would hold both hands
        drawn = MaskSource.ALPHA if facts.has_alpha else MaskSource.TEMPLATE
        sample = Sample(
            image=file,
            camera=tables.camera(image),
            joints_m=joints_m,
            handedness=handedness,
            capture=f"{self.files.split}/Capture{image.capture}",
            sequence=image.sequence,
            frame=image.frame,
            camera_name=image.camera,
            mask_source=drawn if mask is None else MaskSource.FILE,
            mask=mask,
        )
        return sample, self.drop_rule(sample, image) if self.drop_rule else None

    def _mask_file(self, image: InterHandImage) -> Path | None:
        if self.files.masks is None:
            return None
        named = self.files.masks / image.file_name
        return next((file for file in (named.with_suffix(".png"), named) if file.is_file()), None)


def _unknown(kind: str, name: str, present: list[str], file: Path) -> InputError:
    listed = ", ".join(present[:20]) + (" …" if len(present) > 20 else "")
    return InputError(f"{kind} '{name}'", wanted=f"one of those in {file}: {listed}", came=f"'{name}'")
