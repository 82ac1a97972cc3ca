"""An animated hand as an OpenUSD stage (docs/EXPORT.md), by any `pxr` from 25.02 on: usd-core, or Blender's own."""

from jghand_engine.errors import InputError, install_extra

try:
    import pxr  # noqa: F401
except ImportError as error:
    raise InputError("USD files", wanted="the package usd-core", came="none", remedy=install_extra("usd")) from error
