"""Tables of figures: ours in rows, the paper's beside them and never mixed with them, as text and as Markdown.

The paper's figures (arXiv 2501.19088, on InterHand2.6M and HanCo) stand here once, as PAPER 3 has them. They were
measured on real pictures that cannot be had without an account; ours are measured on other pictures. Every
table says so.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from jghand_engine.learn.crops import (
    COARSER_MM_PX,
    CROP_MM,
    CROP_MM_PX,
    CROP_PX,
    EDGES,
    INSIDE,
    OCTAVES_PX,
    crop_means,
    detail_key,
)
from jghand_engine.learn.evaluate import Evaluation, PictureScore, means
from jghand_engine.learn.metrics import BOX_RULE

CAVEAT = (
    "The paper's rows were measured by its authors on InterHand2.6M and HanCo, ours on what is named above: "
    "the data differ, so compare orders of magnitude and orderings, not digits."
)
NONE = "-"


@dataclass(frozen=True)
class Table:
    """columns: the first is text, the others figures · rows: as long as columns · notes: sentences below it."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()

    def markdown(self) -> str:
        """The table as GitHub reads it, with its title as a heading of level 3."""
        head = "| " + " | ".join(self.columns) + " |"
        rule = "| --- |" + " ---: |" * (len(self.columns) - 1)
        body = ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in self.rows]
        notes = [f"* {note}" for note in self.notes]
        return "\n".join([f"### {self.title}", "", head, rule, *body, *([""] if notes else []), *notes]) + "\n"


def number(value: float | None, decimals: int) -> str:
    """`value` with so many decimals, or a dash where there is none."""
    return NONE if value is None else f"{value:.{decimals}f}"


# ---- the paper (PAPER 3) -----------------------------------------------------------------------------------------

PAPER_SETS = ("test/Capture0", "test/Capture1", "val/Capture0", "HanCo/0191")
# SSIM, PSNR in dB, LPIPS of each of PAPER_SETS; LiveHand's .786 looks like a misprint
PAPER_RENDERING: dict[str, tuple[tuple[float, float, float] | None, ...]] = {
    "HTML": ((0.859, 24.23, 0.181), (0.853, 23.11, 0.173), (0.851, 23.41, 0.186), None),
    "3D-PSHR": ((0.934, 30.93, 0.078), (0.913, 29.23, 0.089), (0.910, 29.40, 0.092), None),
    "HandAvatar": ((0.954, 30.93, 0.042), (0.947, 28.80, 0.052), (0.954, 30.28, 0.041), (0.953, 29.81, 0.039)),
    "LiveHand": ((0.960, 32.32, 0.032), (0.959, 31.47, 0.033), (0.786, 29.91, 0.043), (0.967, 31.08, 0.028)),
    "JGHand (paper)": ((0.966, 33.44, 0.032), (0.966, 32.44, 0.032), (0.969, 33.41, 0.031), (0.974, 33.89, 0.018)),
}
# SSIM, PSNR in dB, LPIPS on test/Capture0; None for a row of ours alone
PAPER_FULL = (0.966, 33.44, 0.032)
PAPER_ABLATION: dict[str, tuple[float, float, float] | None] = {
    "w/o trans": (0.923, 27.04, 0.097),
    "w/o screen shadow": (0.954, 30.92, 0.043),
    "w/o cast shadow": None,
    "w/o joint errors": None,
    "w/o iso": (0.966, 33.56, 0.032),
    "full": PAPER_FULL,
}


# ---- ours beside it -------------------------------------------------------------------------------------------------

_LPIPS, _ST_LPIPS = "lpips", "st_lpips"
REGION_TITLES = {"full": "full picture", "box": "mask's box"}
# metrics of a region in the order of their columns: name in the records, head, decimals
_METRICS = (
    ("psnr", "PSNR dB", 2),
    ("ssim", "SSIM", 4),
    ("ms_ssim", "MS-SSIM", 4),
    ("flip", "FLIP", 4),
    (_ST_LPIPS, "ST-LPIPS", 4),
    (_LPIPS, "LPIPS", 4),
)
_DETAIL = tuple((detail_key(octave), f"detail {octave[0]}-{octave[1]} px", 2) for octave in OCTAVES_PX)
_NO_CROPS = {INSIDE: "that is nothing but hand", EDGES: "that the outline halves"}


def rendering_table(evaluations: Sequence[Evaluation]) -> Table:
    """The paper's table of rendering: SSIM / PSNR / LPIPS on the full picture, its figures above ours."""
    captures = list(dict.fromkeys(one.capture for one in evaluations))
    columns = ("SSIM / PSNR / LPIPS", *PAPER_SETS, *captures)
    rows = [
        (method, *(_triple(figures) for figures in sets), *[NONE] * len(captures))
        for method, sets in PAPER_RENDERING.items()
    ]
    for one in evaluations:
        for category, pictures in one.groups().items():
            values = means(pictures)
            cell = _triple((values["ssim_full"], values["psnr_full"], values.get(f"{_LPIPS}_full")))
            cells = [cell if capture == one.capture else NONE for capture in captures]
            rows.append((f"{one.name}: {category}", *[NONE] * len(PAPER_SETS), *cells))
    notes = ("Full picture on black, as in the paper.", f"Pictures of ours: {_origins(evaluations)}.",
             *_mask_notes(evaluations), CAVEAT)  # fmt: skip
    return Table("Rendering, in the paper's form", columns, tuple(rows), notes)


def figures_table(evaluation: Evaluation, region: str) -> Table:
    """Every metric of ours on one region, by category. region: 'full', or 'box' with the PSNR of the mask."""
    return _grouped(
        evaluation, evaluation.groups(), region, f"{evaluation.name} on {evaluation.capture}: {REGION_TITLES[region]}"
    )


def flexion_table(evaluation: Evaluation) -> Table:
    """Figures of the mask's box by how far the fingers are bent, over all categories."""
    return _grouped(evaluation, evaluation.regions(), "box", "By mean flexion of the fingers' joints, mask's box")


def crops_table(evaluation: Evaluation) -> Table:
    """Figures of crops, by category, kind and scale, the ceiling's among them; no rows where there are none."""
    groups, title = evaluation.crops(), f"{evaluation.name} on {evaluation.capture}: close up"
    metrics = [(name, head, decimals) for name, head, decimals in (*_METRICS, *_DETAIL)
               if any(name in crop_means(crops) for crops in groups.values())]  # fmt: skip
    rows = []
    for name, crops in groups.items():
        values = crop_means(crops)
        cells = [number(values.get(key), decimals) for key, _, decimals in metrics]
        rows.append((name, str(len(crops)), *cells))
    notes = [f"A crop is {CROP_MM:.0f} mm of hand; 1080p is {CROP_MM_PX:g} mm per pixel, crops of {CROP_PX} pixels."]
    crops = [crop for group in groups.values() for crop in group]
    coarse = [crop.side_px for crop in crops if crop.mm_px > COARSER_MM_PX]
    if coarse:
        sides = " to ".join(map(str, dict.fromkeys((min(coarse), max(coarse)))))
        notes.append(f"{len(coarse)} are of coarser pictures, at their own scale, and have {sides} pixels.")
    notes += [f"No picture holds a crop {text}." for kind, text in _NO_CROPS.items()
              if not any(crop.kind == kind for crop in crops)]  # fmt: skip
    if not crops:
        return Table(title, ("Crops", "count"), (), tuple(notes))
    notes.append("Detail: median of its power over the truth's, by wavelength; blur has less than 1, grain more.")
    if evaluation.ceiling:
        notes.append("Ceiling: the truth against the truth with other noise.")
    else:
        notes.append("Ceiling: not measured. Make the capture again with more --samples (a --shard of it will do) and "
                     "give its folder as --beside.")  # fmt: skip
    return Table(title, ("Crops", "count", *(head for _, head, _ in metrics)), tuple(rows), tuple(notes))


def _grouped(evaluation: Evaluation, groups: Mapping[str, Sequence[PictureScore]], region: str, title: str) -> Table:
    present = means(evaluation.pictures)
    metrics = [(f"{name}_{region}", head, decimals) for name, head, decimals in _METRICS]
    if region == "box":
        metrics.insert(1, ("psnr_mask", "mask PSNR dB", 2))
    metrics = [metric for metric in metrics if metric[0] in present]
    rows = []
    for name, pictures in groups.items():
        values = means(pictures)
        cells = [number(values.get(key), decimals) for key, _, decimals in metrics]
        rows.append((name, str(len(pictures)), *cells))
    columns = ("Pictures", "count", *(head for _, head, _ in metrics))
    notes = [f"Split: {evaluation.origin}. Means over pictures.", *_mask_notes([evaluation])]
    if region == "box":
        notes.append(f"Box: {BOX_RULE}. Mask: the pixels of mask >= 0.5 alone.")
    if any(key.startswith(_ST_LPIPS) for key, _, _ in metrics):
        notes.append("ST-LPIPS is a metric of its own: not comparable with LPIPS.")
    return Table(title, columns, tuple(rows), tuple(notes))


def ablation_table(results: Mapping[str, Evaluation]) -> Table:
    """The paper's ablation: each variant on all held-out pictures, and what it loses against `full`."""
    full = means(results["full"].pictures) if "full" in results else None
    rows = []
    for name, paper in PAPER_ABLATION.items():
        if paper is None and name not in results:
            continue
        cells = [NONE] * 4
        if name in results:
            values = means(results[name].pictures)
            lost = values["psnr_full"] - full["psnr_full"] if full and name != "full" else None
            cells = [number(values["ssim_full"], 4), number(values["psnr_full"], 2),
                     NONE if lost is None else f"{lost:+.2f}", number(values["psnr_box"], 2)]  # fmt: skip
        beside = (NONE,) * 3
        if paper is not None:
            beside = (f"{paper[0]:.3f}", f"{paper[1]:.2f}", f"{paper[1] - PAPER_FULL[1]:+.2f}")
        rows.append((name, *cells, *beside))
    columns = ("Variant", "SSIM", "PSNR dB", "against full", "box PSNR dB",
               "paper SSIM", "paper PSNR dB", "paper against full")  # fmt: skip
    notes = (f"Ours: all held-out pictures of {_origins(list(results.values()))}, full picture on black.",
             "w/o trans: HALO-like transform, to a canonical skeleton of the posed bone lengths (PAPER 3).",
             "w/o screen shadow: the paper's row w.o. shadow. w/o cast shadow and w/o joint errors: ours alone.",
             CAVEAT)  # fmt: skip
    return Table("Ablation", columns, tuple(rows), notes)


def light_table(results: Mapping[str, Evaluation]) -> Table:
    """The ablation of known light: PSNR / SSIM of each variant on each kind of pictures."""
    columns = list(dict.fromkeys(picture.category for one in results.values() for picture in one.pictures))
    rows = []
    for name, one in results.items():
        values = [means(pictures) for pictures in (one.groups()[column] for column in columns)]
        rows.append((name, *(f"{number(v['psnr_box'], 1)} / {number(v['ssim_box'], 3)}" for v in values)))
    notes = (f"PSNR dB / SSIM after exposure: {_origins(list(results.values()))}. Box: {BOX_RULE}.",
             "one light: learned as if all pictures had the same, shown in the white balance that fits each best.",
             "estimated: that hand in the light of each picture.",
             "w/o shadows: nor what fingers throw back. w/o lamps: they are pixels of the world.",
             "w/o shadows and lamps: harmonics of the world are left.")  # fmt: skip
    return Table("Known light", ("PSNR / SSIM", *columns), tuple(rows), notes)


def _mask_notes(evaluations: Sequence[Evaluation]) -> list[str]:
    """A silhouette of our own hand flatters our own avatar (DATA 5)."""
    projected = any(picture.sample.mask_source.is_projected for one in evaluations for picture in one.pictures)
    return ["Masks: a template, projected; not the masks of the papers' protocol."] if projected else []


def _triple(figures: Sequence[float | None] | None) -> str:
    if figures is None:
        return NONE
    ssim, psnr, lpips = figures
    return f"{number(ssim, 3)} / {number(psnr, 2)} / {number(lpips, 3)}"


def _origins(evaluations: Sequence[Evaluation]) -> str:
    return "; ".join(dict.fromkeys(f"{one.capture} ({one.origin})" for one in evaluations))
