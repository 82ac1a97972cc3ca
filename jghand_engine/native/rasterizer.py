"""The native rasterizer on NumPy arrays: owns the memory of one RasterJob (native/raster.h) and makes its two calls.

Plain arrays in, planes out; `learn.rasterize` wraps this for torch. Gaussians are float32 in any frame near the hand;
`View` says how that frame lies in the camera, in float64, so that a hand far from the world's origin loses nothing.
"""

from __future__ import annotations

import ctypes
import math
from dataclasses import dataclass

import numpy as np

from jghand_engine.errors import InputError, MemoryLimitError
from jghand_engine.native import contract
from jghand_engine.native.binding import Library, address, aligned_zeros, new_team
from jghand_engine.native.threads import shared_pool

PLANES = 5  # premultiplied R G B, alpha, sum of weight times depth
_RECORD_FLOATS = 16
_LIST_TOO_SMALL, _TOO_MANY_PAIRS = 1, 2
# how a note begins that tells of an image which another backend was asked for
DRAWN_HERE = "drawn by the processor"
# items per thread of the steps over Gaussians: enough that a thread that starts late does not hold up the others
_PARTS_PER_THREAD = 4


# what arrays of Gaussians are called in the job
_JOB_NAMES = {
    "position_m": "position",
    "sigma_m": "sigma",
    "covariance_m2": "covariance",
    "opacity": "opacity",
    "rgb": "rgb",
}


def check_image_size(width: int, height: int) -> None:
    """InputError for an image that no kernel draws."""
    largest = contract.IMAGE_MAX_PX
    if not (1 <= width <= largest and 1 <= height <= largest):
        came = f"{width} x {height}"
        raise InputError("image size", wanted=f"1 to {largest} pixels along each side", came=came)


class _Job(ctypes.Structure):
    """Mirror of RasterJob in native/raster.h, field by field; the self-test compares the sizes."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("position", "sigma", "covariance", "opacity", "rgb", "front")),
        *((name, ctypes.c_void_p) for name in ("layer", "layer_planes", "surface")),
        *((name, ctypes.c_void_p) for name in ("records", "rects")),
        *((name, ctypes.c_void_p) for name in ("sort_a", "sort_b", "order", "summaries")),
        *((name, ctypes.c_void_p) for name in ("part_cursors", "tile_start", "tile_list", "tile_work", "planes")),
        *((name, ctypes.c_void_p) for name in ("plane_gradients", "record_gradients")),
        *((f"{name}_gradient", ctypes.c_void_p) for name in ("position", "sigma", "covariance", "opacity", "rgb")),
        ("team", ctypes.c_void_p),
        *((name, ctypes.c_int64) for name in ("list_capacity", "pairs")),
        ("camera_from_position", ctypes.c_double * 12),
        *((name, ctypes.c_float) for name in ("fx", "fy", "cx", "cy", "z_near", "low_pass_m2")),
        *((name, ctypes.c_float) for name in ("log2_alpha_min", "alpha_max", "t_stop")),
        *((name, ctypes.c_float) for name in ("own_before", "own_behind", "own_steepest", "others_part")),
        *((name, ctypes.c_int32) for name in ("count", "width", "height", "tiles_x", "tiles_y")),
        *((name, ctypes.c_int32) for name in ("parts", "visible", "invalid", "status", "orthographic")),
        *((name, ctypes.c_int32) for name in ("keeps_empty", "layers", "surface_stride")),
    )


def job_bytes() -> int:
    """Size of the mirrored structure, which the self-test compares with the library's."""
    return ctypes.sizeof(_Job)


@dataclass(frozen=True)
class GaussianArrays:
    """position_m (N, 3), sigma_m (N,), opacity (N,), rgb (N, 3): contiguous float32, meters, colors 0..1.

    covariance_m2: (N, 6) xx, xy, xz, yy, yz, zz in the frame of the positions; then sigma_m is not looked at.
    front:         (N,) 0..1 part of each that is seen from outside, below 0 where it is not drawn, see native/raster.h;
                   None: all of all. There is no backward pass with it
    pixel_m:       of the pictures that they were learned from: see `learn.gaussians.Gaussians`
    layers:        (L, N, 4) colors that are drawn beside rgb in the same way, where there is a `front`; None: none
    """

    position_m: np.ndarray
    sigma_m: np.ndarray
    opacity: np.ndarray
    rgb: np.ndarray
    covariance_m2: np.ndarray | None = None
    front: np.ndarray | None = None
    pixel_m: float = 0.0
    layers: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.position_m)


# pixels around an image of a surface: kernels read a block of 4 x 4 pixels that begins on the image and those beside
# it, and sixteen from a row's last pixel on, which end in the rows below
SURFACE_MARGIN_PX = 4


@dataclass(frozen=True)
class SeenSurface:
    """The skin that an image shows, see native/raster.h.

    near:  (H + 8, W + 8) float32, with SURFACE_MARGIN_PX of nothing around it
    scale: of the hands in the image, the largest
    part:  0..1 how much it counts that a Gaussian is not its own
    """

    near: np.ndarray
    scale: float
    part: float

    def first_pixel(self, width: int, height: int) -> tuple[int, int]:
        """Address of the first pixel of an image of that size, and floats from row to row.

        InputError for another size.
        """
        margin = SURFACE_MARGIN_PX
        address(self.near, np.float32, "near", (height + 2 * margin, width + 2 * margin))
        return self.near[margin:, margin:].ctypes.data, self.near.shape[1]


@dataclass(frozen=True)
class View:
    """A pinhole camera for the kernel, or one of parallel rays (`render.camera.Camera`): pixels, and
    camera_from_position (3, 4) float64, meters.

    The matrix maps the frame the positions are given in to the camera frame: world positions, positions relative to
    the hand's root (put the root into the last column), or camera-frame positions with `np.eye(3, 4)`.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    camera_from_position: np.ndarray
    orthographic: bool = False


@dataclass(frozen=True)
class Gradients:
    """Gradients with respect to the arrays of GaussianArrays, in the same shapes. Of sigma_m and covariance_m2 only
    what was drawn has one."""

    position_m: np.ndarray
    opacity: np.ndarray
    rgb: np.ndarray
    sigma_m: np.ndarray | None = None
    covariance_m2: np.ndarray | None = None


class NativeRasterizer:
    """One image at a time: `forward`, then optionally `backward`. Memory is kept from image to image.

    threads: how many draw, as `threads.thread_count` gives them; the pool of that size is shared by the process.
    After `forward`: `visible`, `invalid` (Gaussians) and `pairs` (entries of all tile lists).

    finishes_elsewhere: whether the planes are drawn by `finished`, not by `run`: see `gpu.rasterizer`
    layer_planes:       (L, 4, H, W) of the layers of the last Gaussians that had any
    fell_back:          why the last image was drawn by another backend than the one asked for; empty where it was not
    """

    finishes_elsewhere = False
    fell_back = ""

    def __init__(self, library: Library, threads: int) -> None:
        self.library, self.threads = library, threads
        self._job = _Job()
        self._team = new_team()
        self._job.team = self._team.ctypes.data
        self._job.z_near, self._job.alpha_max = contract.Z_NEAR_M, contract.ALPHA_MAX
        self._arrays: dict[str, np.ndarray] = {}
        # Gaussians, tiles along x and y that there is room for
        self._reserved: tuple[int, int, int] | None = None
        self._prepared: GaussianArrays | None = None  # what is being drawn
        self._inputs: GaussianArrays | None = None  # what was drawn: the kernel reads them again in backward
        self._planes: np.ndarray | None = None
        self._surface: SeenSurface | None = None
        self.layer_planes = np.zeros((0, 4, 0, 0), np.float32)
        # whether the last image was drawn into this object's own memory, which is empty when it is new
        self._own_planes = self._drew_own = True

    @property
    def visible(self) -> int:
        return self._job.visible

    @property
    def invalid(self) -> int:
        return self._job.invalid

    @property
    def pairs(self) -> int:
        return self._job.pairs

    def forward(
        self,
        gaussians: GaussianArrays,
        view: View,
        *,
        alpha_min: float = contract.ALPHA_MIN,
        t_stop: float = contract.T_STOP,
        planes: np.ndarray | None = None,
    ) -> np.ndarray:
        """Draws and returns planes (5, H, W) float32: premultiplied R G B, alpha, sum of weight times depth.

        planes: where to draw; without it, this object's own memory, returned as read-only: the next image overwrites
                it, except tiles that stay empty.
        InputError names a wrong array; MemoryLimitError when Gaussians cover more tiles than the lists can index.
        """
        drawn = self.prepare(gaussians, view, alpha_min=alpha_min, t_stop=t_stop, planes=planes)
        while True:
            shared_pool(self.threads).run(self.run)
            if self.finished():
                break
        if planes is None:
            drawn = drawn.view()
            drawn.flags.writeable = False
        return drawn

    def prepare(
        self,
        gaussians: GaussianArrays,
        view: View,
        *,
        alpha_min: float = contract.ALPHA_MIN,
        t_stop: float = contract.T_STOP,
        planes: np.ndarray | None = None,
    ) -> np.ndarray:
        """The first half of `forward`, for who shares one call of a pool with other work: then every thread calls
        `run`, and `finished` says whether the planes (returned here) are drawn or all has to be done again. Who writes
        into them leaves zeros where nothing is drawn: tiles that stay empty are not cleared."""
        self._inputs = None  # no backward pass of an image that fails half way
        self._set_inputs(gaussians)
        self._set_view(view)
        self._job.log2_alpha_min, self._job.t_stop = self._cut(alpha_min), t_stop
        shape = (PLANES, view.height, view.width)
        # tiles that were empty in this object's own memory need not be cleared again
        self._own_planes, self._job.keeps_empty = planes is None, planes is None and self._drew_own
        self._prepare_layers(gaussians, view)
        self._job.surface = self._surface = None
        self._drew_own = False
        self._planes = self._array("planes", shape, np.float32) if planes is None else planes
        self._job.planes = address(self._planes, np.float32, "planes", shape, writable=True)
        self._reserve_scratch()
        self._team.fill(0)
        return self._planes

    def _prepare_layers(self, gaussians: GaussianArrays, view: View) -> None:
        job, had, layers = self._job, self._job.layers, gaussians.layers
        job.layers = 0 if layers is None else len(layers)
        if layers is None:
            return
        if gaussians.front is None:
            raise InputError("layers of Gaussians", wanted="Gaussians with `front`", came="none")
        job.layer = address(layers, np.float32, "layers", (job.layers, len(gaussians), 4))
        self.layer_planes = self._array("layer_planes", (job.layers, 4, view.height, view.width), np.float32)
        job.layer_planes = self.layer_planes.ctypes.data
        # what was drawn there is older than the last image
        job.keeps_empty &= had == job.layers

    def set_surface(self, surface: SeenSurface) -> None:
        """Of the image that was prepared; it need not be there before `run`. Without it all Gaussians count alike."""
        job, self._surface = self._job, surface
        job.surface, job.surface_stride = surface.first_pixel(job.width, job.height)
        job.own_before, job.own_behind = surface.scale * contract.OWN_BEFORE_M, surface.scale * contract.OWN_BEHIND_M
        job.own_steepest, job.others_part = contract.OWN_STEEPEST, 1 - surface.part * (1 - contract.OTHERS_PART)

    def run(self, _thread: int = 0) -> None:
        """Draws what was prepared, together with the other threads of a pool."""
        self.library.call.jg_raster_forward(ctypes.addressof(self._job))

    def finished(self) -> bool:
        """After `run`: whether the image is drawn. If not, there is more room now, and `run` must be called again."""
        self._team.fill(0)
        if self._job.status == _LIST_TOO_SMALL:
            self._reserve_list(self._job.pairs)
            return False
        if self._job.status == _TOO_MANY_PAIRS:
            raise MemoryLimitError(
                "Gaussians cover too many tiles",
                wanted=f"at most {contract.MAX_PAIRS} pairs of Gaussian and tile",
                remedy="Use a smaller image, fewer or smaller Gaussians.",
            )
        self._inputs, self._drew_own = self._prepared, self._own_planes
        return True

    def backward(self, plane_gradients: np.ndarray) -> Gradients:
        """Gradients of the Gaussians of the last `forward`, from dL/d(planes) (5, H, W) float32. Culled ones get 0."""
        if self._inputs is None or self._planes is None:
            raise InputError("backward pass", wanted="a forward pass before it", came="none")
        if self._inputs.front is not None:
            raise InputError(
                "backward pass", wanted="Gaussians without `front`", came="a picture whose gaps are filled"
            )
        n = len(self._inputs)
        self._job.plane_gradients = address(plane_gradients, np.float32, "plane_gradients", self._planes.shape)
        records = self._array("record_gradients", (contract.GRADIENT_STRIPES, n, _RECORD_FLOATS), np.float32)
        self._job.record_gradients = records.ctypes.data
        shapes = {"position_m": (n, 3), "opacity": (n,), "rgb": (n, 3)}
        shapes |= {"sigma_m": (n,)} if self._inputs.covariance_m2 is None else {"covariance_m2": (n, 6)}
        results = {name: np.empty(shape, np.float32) for name, shape in shapes.items()}
        for name, result in results.items():
            setattr(self._job, f"{_JOB_NAMES[name]}_gradient", result.ctypes.data)
        self._team.fill(0)
        pointer = ctypes.addressof(self._job)
        # looked up every time: after a fork the child has a pool of its own
        shared_pool(self.threads).run(lambda _thread: self.library.call.jg_raster_backward(pointer))
        return Gradients(**results)

    # ---- the job ----------------------------------------------------------------------------------------------------

    def _set_inputs(self, gaussians: GaussianArrays) -> None:
        n = len(gaussians)
        job = self._job
        job.count = n
        job.position = address(gaussians.position_m, np.float32, "position_m", (n, 3))
        job.sigma = address(gaussians.sigma_m, np.float32, "sigma_m", (n,))
        job.opacity = address(gaussians.opacity, np.float32, "opacity", (n,))
        job.rgb = address(gaussians.rgb, np.float32, "rgb", (n, 3))
        covariance, front = gaussians.covariance_m2, gaussians.front
        job.front = None if front is None else address(front, np.float32, "front", (n,))
        job.low_pass_m2 = contract.BLUR_PX2 * gaussians.pixel_m**2
        job.covariance = None if covariance is None else address(covariance, np.float32, "covariance_m2", (n, 6))
        self._prepared = gaussians

    def _set_view(self, view: View) -> None:
        check_image_size(view.width, view.height)
        job = self._job
        job.width, job.height = view.width, view.height
        job.tiles_x, job.tiles_y = -(-view.width // contract.TILE_PX), -(-view.height // contract.TILE_PX)
        job.fx, job.fy, job.cx, job.cy = view.fx, view.fy, view.cx, view.cy
        job.orthographic = view.orthographic
        job.camera_from_position[:] = np.asarray(view.camera_from_position, np.float64).ravel().tolist()

    @staticmethod
    def _cut(alpha_min: float) -> float:
        """log2 of the cut-off; below the limit the kernel's exponential has no meaning."""
        if not contract.NATIVE_ALPHA_MIN <= alpha_min < 1:
            wanted = f"{contract.NATIVE_ALPHA_MIN:g} to below 1"
            raise InputError("alpha_min", wanted=wanted, came=f"{alpha_min:g}")
        return math.log2(alpha_min)

    def _reserve_scratch(self) -> None:
        job = self._job
        if self._reserved == (job.count, job.tiles_x, job.tiles_y):
            return
        self._reserved = None
        n, tiles = job.count, job.tiles_x * job.tiles_y
        job.parts = _PARTS_PER_THREAD * self.threads
        shapes = {
            "records": ((n, _RECORD_FLOATS), np.float32),
            "rects": ((n, 4), np.int16),
            "sort_a": ((n,), np.uint64),
            "sort_b": ((n,), np.uint64),
            "order": ((n,), np.int32),
            "summaries": ((job.parts, 4), np.int32),
            "part_cursors": ((job.parts, job.tiles_y + 1, job.tiles_x + 1), np.int32),
            "tile_start": ((tiles + 1,), np.int32),
            "tile_work": ((tiles,), np.int32),
        }
        for name, (shape, dtype) in shapes.items():
            setattr(job, name, self._array(name, shape, dtype).ctypes.data)
        if not job.list_capacity:
            self._reserve_list(n)
        self._reserved = job.count, job.tiles_x, job.tiles_y

    def _reserve_list(self, pairs: int) -> None:
        """Room for `pairs` entries and a quarter more, so that a moving hand does not ask again every frame."""
        self._job.list_capacity, self._reserved = 0, None  # should there be no memory: the old list is gone
        capacity = min(pairs + pairs // 4 + 1024, contract.MAX_PAIRS)
        self._job.tile_list = self._array("tile_list", (capacity,), np.int32).ctypes.data
        self._job.list_capacity = capacity

    def _array(self, name: str, shape: tuple[int, ...], dtype: type) -> np.ndarray:
        """This object's memory of that name, made anew when the shape changes."""
        array = self._arrays.get(name)
        if array is None or array.shape != shape:
            self._arrays.pop(name, None)  # the old one first: both together may not fit
            try:
                array = self._arrays[name] = aligned_zeros(shape, dtype)
            except MemoryError as error:
                size = math.prod(shape) * np.dtype(dtype).itemsize / 2**20
                remedy = "Use a smaller image or fewer Gaussians."
                raise MemoryLimitError(
                    f"no memory for {name} of the rasterizer, {size:.0f} MiB", remedy=remedy
                ) from error
        return array
