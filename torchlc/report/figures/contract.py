"""The contract of a figure of a report: one class, which enters the pages by being defined."""

from __future__ import annotations

import html
import io
import re
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import matplotlib
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

from torchlc.figures import saving, style
from torchlc.naming import Registry

INKS = {
    style.INK: "--ink",
    style.GRID: "--grid",
    style.DATA: "--data",
    style.MODEL: "--model",
    style.BEFORE: "--before",
    style.SUN: "--sun",
    style.OBSERVER: "--observer",
}
"""Colours of the figures that follow the page's light or dark dress."""
PNG_DPI = 130
PAGES = ("fit", "diagnosis")
"""Whose result a figure may show."""
FIGURES: Registry[type[ReportFigure]] = Registry("figure")
"""Every figure by its page and name."""


class ReportFigure(ABC):
    """One figure of the page of a result. Subclasses set ``name``, the stem of its file, and ``page``, "fit" or
    "diagnosis", whose result their methods get; ``heading`` stands over it, and ``section`` is the section of the
    page that it closes ("" : a section of its own). ``order`` sorts figures of one section. Defining a name again
    replaces the figure, with a warning.
    """

    name: ClassVar[str]
    page: ClassVar[str] = "fit"
    heading: ClassVar[str] = ""
    section: ClassVar[str] = ""
    order: ClassVar[int] = 50
    square: ClassVar[bool] = False

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if "name" in cls.__dict__:
            if cls.page not in PAGES:
                raise TypeError(f"figure {cls.name!r}: page {cls.page!r}; expected one of {', '.join(PAGES)}")
            FIGURES.declared(cls, "name", f"{cls.page}/{cls.name}")

    def applies(self, result: Any) -> bool:
        """Whether there is anything to draw."""
        return True

    def on_page(self, result: Any) -> bool:
        """Whether it stands on the page, and not only in a file beside it."""
        return True

    @abstractmethod
    def size(self, result: Any) -> tuple[float, float]:
        """Inches."""

    @abstractmethod
    def draw(self, result: Any, figure: Figure) -> None:
        """Draw on a figure of that size."""

    @abstractmethod
    def alt(self, result: Any) -> str:
        """What it shows, for those who do not see it."""

    @abstractmethod
    def caption(self, result: Any) -> str:
        """What stands under it."""

    def drawn(self, result: Any) -> Figure:
        """The finished figure, or one that says why it could not be drawn."""
        size = self.size(result)

        def draw() -> Figure:
            with matplotlib.rc_context(style.style()):  # axes keep the colours that they are made with
                figure = Figure(figsize=size)
                self.draw(result, figure)
            return figure

        return saving.drawn(draw, size)


def registry(page: str) -> list[ReportFigure]:
    """The figures of a page in their order."""
    figures = [cls() for cls in FIGURES.values() if cls.page == page]
    return sorted(figures, key=lambda figure: (figure.order, figure.name))


class Drawn(NamedTuple):
    """A finished figure, and what of it is rendered."""

    kind: ReportFigure
    figure: Figure
    extent: Bbox | str


def draw_all(page: str, result: Any) -> list[Drawn]:
    """Every figure of a page that has something to show, drawn."""
    kinds = [kind for kind in registry(page) if kind.applies(result)]
    figures = [kind.drawn(result) for kind in kinds]
    return [Drawn(kind, figure, saving.extent(figure)) for kind, figure in zip(kinds, figures, strict=True)]


def by_section(
    result: Any, drawn: Sequence[Drawn], sections: Sequence[str]
) -> dict[str, list[dict[str, Any]]]:
    """What a template shows of the figures on the page, by section; under "own" those of none of ``sections``."""
    shown: dict[str, list[dict[str, Any]]] = {name: [] for name in (*sections, "own")}
    for each in drawn:
        kind = each.kind
        if kind.on_page(result):
            alt = kind.alt(result)
            row = {
                "name": kind.name,
                "heading": kind.heading,
                "svg": svg(each, alt),
                "alt": alt,
                "caption": kind.caption(result),
            }
            shown[kind.section if kind.section in sections else "own"].append(row)
    return shown


def png(drawn: Drawn) -> bytes:
    """A figure on white ground."""
    stream = io.BytesIO()
    saving.save(drawn.figure, stream, format="png", dpi=PNG_DPI, bbox_inches=drawn.extent, facecolor="white")
    return stream.getvalue()


def svg(drawn: Drawn, alt: str) -> Any:
    """A figure as an SVG element in the page's colours, for a reader and for a screen reader; markup that a template
    does not escape: it is ours, and matplotlib escapes the names in it."""
    from markupsafe import Markup

    stream = io.StringIO()
    saving.save(drawn.figure, stream, format="svg", bbox_inches=drawn.extent, transparent=True, dpi=PNG_DPI)
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.S)
    text = re.sub(r'<g id="[^"]*_\d+">', "<g>", text)
    text = re.sub(r' (width|height)="[\d.]+pt"', "", text, count=2)
    for colour, ink in INKS.items():
        text = text.replace(colour, f"var({ink})")
    label = f'<svg role="img" aria-label="{html.escape(alt, quote=True)}"' + (
        ' class="square"' if drawn.kind.square else ""
    )
    return Markup(text.replace("<svg", label, 1))
