"""JGHand: 21 joint positions go in, a photorealistic hand comes out.

The packages, in the order of imports: each imports only from those above it (docs/ARCHITECTURE.md).

    errors, files, lock, color, …   kinds of errors, atomic writing, color spaces
    native      the compiled kernels: build, choice of variant, threads
    hand        joints, orders, handedness, the skeleton transform, poses, pose sequences
    avatar      canonical Gaussians of one hand, posing, the .jghand file
    render      Gaussians to images: camera, settings, effects, shadow, blur, the renderer
    motion      motion files of JGHand and of other programs
    template    the canonical hand surface: mesh, UV, skin weights, weight field, sampling
    captures    pictures to learn from, and what a synthetic capture shows
    export      pictures, video, USD, splat files, web pages
    track       a motion out of a video
    learn       an avatar from pictures, and the float64 reference of the kernels (PyTorch)
    study       accuracy against time, stability, effects
    service     the renderer as a process for Blender
    cli         the command `jghand`

native, hand, avatar, render, motion, export and service import neither torch nor scipy nor trimesh.
Units are meters and radians, matrices act on column vectors, `a_from_b` maps b to a.
This module imports nothing of ours, so that Blender's Python can import `jghand_engine.service.protocol` without torch.
"""

import os

# Threads of torch that have nothing to do sleep instead of spinning. Spinning wins microseconds where nobody else wants
# the processors; where somebody does, it takes them from the very threads that are waited for: a training beside two
# busy programs then makes a sixth of the steps. OpenMP reads it once, when torch is loaded; who set it keeps it.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

__version__ = "0.1.0"
