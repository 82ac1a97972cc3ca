"""Long takes: the Gaussians in files of some frames each, of which a reader opens those that it shows (value clips).

    hand.splats.usdc           refers to what does not move, and says which clip holds which frames
    hand.splats.static.usdc    what does not move, and the rest pose. A file of its own: values of the same layer stack
                               would hide the clips'
    hand.splats.manifest.usdc  which attributes the clips hold
    hand.splats.0000.usdc ...  the frames

USD interpolates between the last frame of a clip and the first of the next one as everywhere.
"""

from __future__ import annotations

from pathlib import Path

from pxr import Gf, Sdf, Usd, Vt

from jghand_engine.export.usd.half import HalfPrice
from jghand_engine.export.usd.layers import SPLAT_TYPE, TimeRange, announce_fallback, new_layer
from jghand_engine.export.usd.options import LayerNames
from jghand_engine.export.usd.splats import POINTS_PATH, SPLATS_PATH, Cloud, Look, Sample, SplatLayer, SplatPrims
from jghand_engine.limits import USD_CLIP_FRAMES, USD_SAVE_EVERY


class ClippedSplats:
    """Writes the Gaussians of a long take frame by frame, as SplatLayer does those of a short one; `finish` writes the
    layer that holds them together."""

    def __init__(
        self, folder: Path, names: LayerNames, cloud: Cloud, time: TimeRange, look: Look, rest: Sample
    ) -> None:
        self._folder, self._names, self._time, self._look = folder, names, time, look
        static = SplatLayer.new(folder / names.static, cloud, time, look, rest)
        static.finish()
        self._still = static.prims
        self._clips: list[str] = []
        self._open: tuple[Usd.Stage, SplatPrims] | None = None

    def put(self, frame: int, sample: Sample) -> None:
        """The time sample of a frame, counted from 0."""
        time = self._time.code(frame)
        if frame % USD_CLIP_FRAMES == 0:
            self._close()
            self._clips.append(self._names.clip(len(self._clips)))
            stage = new_layer(self._folder / self._clips[-1], self._time)
            prims = self._still.elsewhere(stage)
            prims.override()
            self._open = stage, prims
        if self._open is not None:
            stage, prims = self._open
            prims.put(sample, time)
            if frame % USD_SAVE_EVERY == USD_SAVE_EVERY - 1:
                stage.Save()

    def finish(self) -> HalfPrice | None:
        """Writes what is left, and the layer that people refer to; what half precision lost, where asked for."""
        self._write_manifest()
        self._close()
        stage = new_layer(self._folder / self._names.splats, self._time)
        announce_fallback(stage)
        splats = stage.DefinePrim(SPLATS_PATH, SPLAT_TYPE)
        stage.SetDefaultPrim(splats)
        prims = [splats] if self._look.half else [splats, stage.CreateClassPrim(POINTS_PATH)]
        for prim in prims:
            prim.GetReferences().AddReference(f"./{self._names.static}", prim.GetPath())
            self._tell_clips(Usd.ClipsAPI(prim), prim.GetPath())
        stage.Save()
        return self._still.price

    def _close(self) -> None:
        if self._open is not None:
            self._open[0].Save()
            self._open = None

    def _tell_clips(self, clips: Usd.ClipsAPI, path: Sdf.Path) -> None:
        first, last = (self._time.code(frame).GetValue() for frame in (0, self._time.frames - 1))
        starts = [self._time.code(USD_CLIP_FRAMES * number).GetValue() for number in range(len(self._clips))]
        clips.SetClipAssetPaths([Sdf.AssetPath(f"./{name}") for name in self._clips])
        clips.SetClipPrimPath(str(path))
        clips.SetClipActive(Vt.Vec2dArray([Gf.Vec2d(start, number) for number, start in enumerate(starts)]))
        clips.SetClipTimes(Vt.Vec2dArray([Gf.Vec2d(first, first), Gf.Vec2d(last, last)]))
        clips.SetClipManifestAssetPath(Sdf.AssetPath(f"./{self._names.manifest}"))

    def _write_manifest(self) -> None:
        """Names the attributes that the clips hold, and no others: those would lose their values."""
        manifest = new_layer(self._folder / self._names.manifest, self._time)
        if self._open is not None:
            for prim in self._open[0].GetPseudoRoot().GetAllChildren():
                there = manifest.OverridePrim(prim.GetPath())
                for attr in prim.GetAuthoredAttributes():
                    there.CreateAttribute(attr.GetName(), attr.GetTypeName(), False, attr.GetVariability())
        manifest.Save()
