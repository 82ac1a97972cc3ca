"""Tables of figures: ours in rows, the paper's beside them and never mixed with them, as text and as Markdown.

The paper's figures (arXiv 2501.19088, on InterHand2.6M and HanCo) stand here once, as METHOD 6.2 has them. They were
measured on real pictures that cannot be had without an account; ours are measured on other pictures. Every
table says so.
"""

from __future__ import annotations

from dataclasses import dataclass

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


@dataclass(frozen=True)
class Metric:
    """A figure of a picture: its name in the records, the head of its column, decimals."""

    name: str
    head: str
    decimals: int


# ---- the paper (METHOD 6.2) -----------------------------------------------------------------------------------------

PAPER_SETS = ("test/Capture0", "test/Capture1", "val/Capture0", "HanCo/0191")
# SSIM, PSNR in dB, LPIPS of each of PAPER_SETS; LiveHand's .786 looks like a misprint
PAPER_RENDERING: dict[str, tuple[tuple[float, float, float] | None, ...]] = {
    "HTML": ((0.859, 24.23, 0.181), (0.853, 23.11, 0.173), (0.851, 23.41, 0.186), None),
    "3D-PSHR": ((0.934, 30.93, 0.078), (0.913, 29.23, 0.089), (0.910, 29.40, 0.092), None),
    "HandAvatar": ((0.954, 30.93, 0.042), (0.947, 28.80, 0.052), (0.954, 30.28, 0.041), (0.953, 29.81, 0.039)),
    "LiveHand": ((0.960, 32.32, 0.032), (0.959, 31.47, 0.033), (0.786, 29.91, 0.043), (0.967, 31.08, 0.028)),
    "JGHand (paper)": ((0.966, 33.44, 0.032), (0.966, 32.44, 0.032), (0.969, 33.41, 0.031), (0.974, 33.89, 0.018)),
}
# SSIM, PSNR in dB, LPIPS on test/Capture0
PAPER_ABLATION = {
    "w/o trans": (0.923, 27.04, 0.097),
    "w/o shadow": (0.954, 30.92, 0.043),
    "w/o iso": (0.966, 33.56, 0.032),
    "full": (0.966, 33.44, 0.032),
}
# seconds per picture on an NVIDIA RTX 3090
PAPER_INFERENCE_S = {"HandAvatar": 4.317, "LiveHand": 0.087, "JGHand (paper)": 0.040}
# MPJPE and Chamfer-L1 on test/Capture0 and test/Capture1; the units are not given, metres fit the former
PAPER_TRANSFORM = {"HALO": ((0.0103, 5.14), (0.0120, 5.97)), "JGHand (paper)": ((0.0, 0.92), (0.0, 0.97))}
