"""The figures of a page, one file each: every module of this folder is found, and so is a class defined elsewhere."""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules

from torchlc.report.figures.contract import Drawn, ReportFigure, by_section, draw_all, png, registry

for _module in iter_modules(__path__):
    import_module(f"{__name__}.{_module.name}")

__all__ = ["Drawn", "ReportFigure", "by_section", "draw_all", "png", "registry"]
