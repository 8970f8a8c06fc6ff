"""Figures of results that are on disk already. A figure never ends a run: where it cannot be drawn, its place holds the
reason.
"""

from __future__ import annotations

import contextlib
import textwrap
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any

import matplotlib.style
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

from torchlc.figures.style import INK


@contextlib.contextmanager
def own_settings() -> Iterator[None]:
    """matplotlib as it comes, whatever a person's matplotlibrc says (text.usetex wants a LaTeX), and its warnings, which
    ``PYTHONWARNINGS=error`` makes errors, unheard."""
    with warnings.catch_warnings(), matplotlib.style.context("default", after_reset=True):
        warnings.simplefilter("ignore")
        yield


def drawn(draw: Callable[[], Figure], size: tuple[float, float] = (7.0, 2.0)) -> Figure:
    """What ``draw`` draws; else a figure of that size, inches, which says why not."""
    with own_settings():
        try:
            return draw()
        except MemoryError:
            raise
        except Exception as error:
            return _reason(error, size)


def save(figure: Figure, target: Path | IO[Any], **options: Any) -> None:
    """Render a figure in its own settings; what cannot be rendered is replaced by the reason."""
    with own_settings():
        begin = None if isinstance(target, Path) else target.tell()
        try:
            figure.savefig(target, **options)
        except (MemoryError, OSError):  # of the disk, not of the figure
            raise
        except Exception as error:
            if not isinstance(target, Path):
                target.seek(begin or 0)
                target.truncate()
            width, height = figure.get_size_inches()
            _reason(error, (width, height)).savefig(target, **options)


def extent(figure: Figure) -> Bbox | str:
    """What is drawn on a figure, inches, with a margin: the ``bbox_inches`` of every format that it is rendered in, measured
    once. "tight", which measures anew, where it cannot be: rendering then says why."""
    with own_settings():
        try:
            if figure.get_layout_engine() is not None:  # which moves axes as they are drawn
                figure.draw_without_rendering()
            return figure.get_tightbbox().padded(matplotlib.rcParams["savefig.pad_inches"])
        except MemoryError:
            raise
        except Exception:  # of any library below: a figure that cannot be drawn never ends a run, and `save` says what it was
            return "tight"


def _reason(error: Exception, size: tuple[float, float]) -> Figure:
    words = " ".join(f"This figure could not be drawn: {type(error).__name__}: {error}".split())
    figure = Figure(figsize=size)
    figure.text(
        0.02, 0.95, textwrap.fill(words[:600].replace("$", r"\$"), int(12 * size[0])), va="top", color=INK
    )
    return figure
