"""What every rasterizer checks before it draws."""

from __future__ import annotations

import torch

from jghand_engine.avatar.gaussians import Gaussians
from jghand_engine.errors import InputError


def check_gaussians(gaussians: Gaussians) -> None:
    """InputError that names the tensor, unless shapes are (N, 3), (N,), (N,), (N, 3) and, where there are covariances,
    (N, 6), of one float dtype and device.

    Nothing is broadcast: a (N, 1) opacity would draw something, and not what was meant.
    Values are not checked: what cannot be drawn is left out and counted (RENDERING 3).
    """
    tensors = {name: getattr(gaussians, name) for name in ("position_m", "sigma_m", "opacity", "rgb")}
    if gaussians.covariance_m2 is not None:
        tensors["covariance_m2"] = gaussians.covariance_m2
    for name, tensor in tensors.items():
        if not isinstance(tensor, torch.Tensor):
            raise InputError(f"Gaussians, {name}", wanted="a torch tensor", came=type(tensor).__name__)
    position = gaussians.position_m
    n = position.shape[0] if position.ndim else 0
    shapes = {"position_m": (n, 3), "sigma_m": (n,), "opacity": (n,), "rgb": (n, 3), "covariance_m2": (n, 6)}
    for name, tensor in tensors.items():
        if tuple(tensor.shape) != shapes[name]:
            wanted = f"shape {shapes[name]}" if name != "position_m" else "shape (N, 3)"
            raise InputError(f"Gaussians, {name}", wanted=wanted, came=f"shape {tuple(tensor.shape)}")
        if tensor.dtype not in (torch.float32, torch.float64):
            raise InputError(f"Gaussians, {name}", wanted="dtype float32 or float64", came=str(tensor.dtype))
        if tensor.dtype != position.dtype or tensor.device != position.device:
            wanted = f"{position.dtype} on {position.device} like position_m"
            raise InputError(f"Gaussians, {name}", wanted=wanted, came=f"{tensor.dtype} on {tensor.device}")
