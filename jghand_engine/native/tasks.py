"""What the calls for skin, shadow and similarity take: mirrors of the structures in native/skin.h, shadow.h and
ssim.cpp, and the memory around a depth that the shadow needs. Python that poses, shades and compares fills them, and so
does the self-test; what trained skin takes is in learned_tasks.py."""

from __future__ import annotations

import ctypes
import math

import numpy as np

from jghand_engine.native import contract
from jghand_engine.native.binding import aligned_zeros

# window and constants of SSIM, which every paper shares (Wang et al. 2004); 0..1 is the range of the images
SSIM_WINDOW_PX = 11

# elements of one vector of the kernels
LANES = 16
# rows and columns around the image: the farthest sample and its neighbor; columns in whole vectors
PAD_ROWS = math.ceil(contract.SHADOW_RADIUS_MAX_PX) + 1
PAD_COLUMNS = -(-PAD_ROWS // LANES) * LANES

_I32, _F32, _P = ctypes.c_int32, ctypes.c_float, ctypes.c_void_p


class SkinTask(ctypes.Structure):
    """SkinTask of native/skin.h, field by field."""

    _fields_ = (
        *((name, _P) for name in ("rest", "block_start", "bone", "weight", "axes", "linear_offset")),
        *((name, _P) for name in ("position", "sigma", "covariance")),
        ("shift", _F32 * 3),
        *((name, _F32) for name in ("scale", "inverse_scale", "stretch_min", "stretch_max")),
        ("blocks", _I32),
    )


class ShadeTask(ctypes.Structure):
    """ShadeTask of native/shadow.h, field by field."""

    _fields_ = (
        *((name, _I32) for name in ("width", "height", "samples", "stride", "pad_rows", "orthographic")),
        *((name, _F32) for name in ("fx", "fy", "cx", "cy", "origin")),
        *((name, _F32) for name in ("radius", "bias", "softness", "gain", "alpha_min")),
        *((name, _F32) for name in ("reach_min_px", "reach_max_px", "length_eps", "normal_reach", "height_min")),
        *((name, _F32) for name in ("agree", "agree_floor", "normal_min2")),
        ("darkness", _F32 * 3),
        *((name, _P) for name in ("disc_x", "disc_y", "picture", "depth", "row_valid")),
        *((name, _P) for name in ("visibility", "rgba", "depth_out", "surface")),
        ("surface_stride", _I32),
        *((name, _F32) for name in ("edge_step", "edge_steepness", "edge_part")),
    )


class SsimTask(ctypes.Structure):
    """SsimTask of native/ssim.cpp, field by field."""

    _fields_ = (
        *((name, _I32) for name in ("width", "height", "stride", "stripes")),
        *((name, _F32) for name in ("c1", "c2")),
        ("weights", _F32 * SSIM_WINDOW_PX),
        *((name, _P) for name in ("rgb", "truth", "maps", "scratch", "sums", "gradient")),
    )


class ShadeGradient(ctypes.Structure):
    """ShadeGradient of native/shadow_backward.cpp, field by field."""

    _fields_ = (
        *((name, _P) for name in ("visibility", "darkened", "stripes", "out")),
        ("pad_columns", _I32),
    )


def new_shade_task(width: int, height: int) -> ShadeTask:
    """The task for images of one size, with the constants of the contract; the caller gives memory and style."""
    return ShadeTask(
        width=width,
        height=height,
        stride=-(-width // LANES) * LANES + 2 * PAD_COLUMNS,
        pad_rows=PAD_ROWS,
        alpha_min=contract.DEPTH_ALPHA_MIN,
        reach_min_px=contract.SHADOW_RADIUS_MIN_PX,
        reach_max_px=contract.SHADOW_RADIUS_MAX_PX,
        length_eps=contract.SHADOW_LENGTH_EPS,
        normal_reach=contract.SHADOW_NORMAL_REACH_M,
        height_min=contract.SHADOW_HEIGHT_MIN_M,
        agree=contract.SHADOW_AGREE,
        agree_floor=contract.SHADOW_AGREE_FLOOR_M,
        normal_min2=contract.SHADOW_NORMAL_MIN2,
    )


def padded_depth(task: ShadeTask) -> np.ndarray:
    """The padded plane of depths of a task, empty; the task points to it. Whoever has the task must keep it."""
    depth = aligned_zeros((task.height + 2 * PAD_ROWS, task.stride))
    depth.fill(contract.SHADOW_FAR_M)
    task.depth = depth.ctypes.data + depth.itemsize * (PAD_ROWS * task.stride + PAD_COLUMNS)
    return depth
