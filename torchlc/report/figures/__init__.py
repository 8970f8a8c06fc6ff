"""The figures of a page, one file each: every module of this folder is found, and so is a class defined elsewhere."""

from __future__ import annotations

from torchlc.naming import import_modules
from torchlc.report.figures.contract import Drawn, ReportFigure, by_section, draw_all, png, registry

import_modules(__name__, __path__)

__all__ = ["Drawn", "ReportFigure", "by_section", "draw_all", "png", "registry"]
