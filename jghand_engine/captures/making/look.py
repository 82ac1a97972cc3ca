"""What the pictures of a capture look like besides hand and camera: light, skin, sampling. DATA 4."""

from __future__ import annotations

from dataclasses import dataclass

# the environments that come with Blender (Poly Haven, CC0)
HDRI_NAMES = ("city", "courtyard", "forest", "interior", "night", "studio", "sunrise", "sunset")


@dataclass(frozen=True)
class AreaLight:
    """A square lamp at `place_m`, aimed at the middle of the hands; edge in meters, power in watts."""

    place_m: tuple[float, float, float]
    edge_m: float
    watts: float
    rgb: tuple[float, float, float] = (1.0, 1.0, 1.0)


@dataclass(frozen=True)
class Light:
    """hdri: a name of HDRI_NAMES or a picture file; hdri_turn_deg: its turn about the vertical (+y) axis. The default
    lamps are large and on all sides: a soft key on the palm, a softer one on the back, weak ones above and below."""

    hdri: str = "studio"
    hdri_strength: float = 0.55
    hdri_turn_deg: float = 0.0
    lamps: tuple[AreaLight, ...] = (
        AreaLight((0.45, 0.45, 0.65), 0.40, 5.0, (1.0, 0.97, 0.93)),
        AreaLight((-0.55, 0.30, -0.60), 0.50, 5.0, (1.0, 0.98, 0.96)),
        AreaLight((-0.25, 0.80, 0.10), 0.40, 1.2),
        AreaLight((0.25, -0.65, 0.30), 0.50, 2.0),
    )


@dataclass(frozen=True)
class SkinMaterial:
    """The surface under the texture: roughness and specular level of skin and of nails, share of light that scatters
    below the skin and how far red, green and blue do (meters)."""

    roughness: float = 0.55
    specular: float = 0.25
    nail_roughness: float = 0.28
    nail_specular: float = 0.5
    subsurface: float = 0.22
    radius_m: tuple[float, float, float] = (0.0048, 0.0018, 0.0010)


@dataclass(frozen=True)
class Sampling:
    """Rays per pixel, subdivisions of the mesh, bounces, and the noise at which a pixel is done."""

    samples: int = 16
    subdivisions: int = 1
    bounces: int = 4
    adaptive_threshold: float = 0.02
