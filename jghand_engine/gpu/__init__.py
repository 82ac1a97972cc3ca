"""Drawing on a graphics card by WebGPU compute shaders (docs/GPU.md); wants the extra `gpu` and no CUDA.

device      which adapter, and opening it
blend       blend.wgsl and its memory on the device: records and lists of tiles to planes
rasterizer  the native rasterizer with that last step; falls back to the kernel's
choice      whether a picture is drawn on a GPU, and what `jghand bench` measured and remembered
"""
