"""JGHand: 21 joint positions go in, a photorealistic hand comes out.

The rooms, in the order in which data walks through them; a room imports only from rooms above it:

    limits, errors, files   constants, error kinds, atomic writing
    lock                    one process per piece of work
    color                  sRGB and linear light
    native                  the compiled kernels: build, choice of variant, threads
    hand                    joints, orders, handedness, frames, the joint transform, poses, pose sequences
    template                the canonical hand surface: mesh, UV, skin weights, weight field, sampling
    avatar                  canonical Gaussians of one hand, skinning, the .jghand file
    splat                   Gaussians to pictures: camera, rasterizer, shadow, the frame
    datasets                files of other people to our data: motions, pictures of hands
    capture                 what a synthetic capture shows: identity, poses, cameras, light
    exporters               pictures, video, USD
    tracking                a motion out of a video
    training                an avatar from pictures: losses, trainer, checkpoints, evaluation, ablations
    studies                 what accuracy costs in time
    service                 the engine as a process for Blender
    cli                     the command `jghand`

Units are meters and radians, matrices act on column vectors, `a_from_b` maps b to a.
This module imports nothing, so that Blender's Python can import `jghand_engine.service.protocol` without torch.
"""

__version__ = "0.1.0"
