"""How the page of an effect shows it: a scene in which it matters, numbers, and the coordinate that belongs to it.

``docs/effects/settings.py`` holds the scenes by these names; ``make_figures.py`` beside it makes figure, sizes and costs from them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

NIGHT = "geostationary, a night"
MIRROR = "geostationary, a mirror's glint"
ECLIPSE = "geostationary, an eclipse"
YEAR = "geostationary, a year at one hour"
PASS = "low orbit, one pass"
SPIN = "low orbit, a turn a minute"
SLOW = "low orbit, a turn in eight minutes"
STAGE_TURNS = "a rocket body, three turns"
STAGE_WEEK = "a rocket body, three nights of a week"
LABORATORY = "a laboratory, one turn"
PANEL_GLINT = "glint_angle_deg[panel +Y/front]"
PASS_GLINT = "glint_angle_deg[panel/front]"
TIME = "time"
WHITE = {"panel.n": 30.0, "panel.r_spec": 0.1, "panel.r_diff": 0.7, "body.r_diff": 0.6}
"""Materials that send much light at one another."""


@dataclass(frozen=True)
class Shown:
    """The ``setting`` and the ``coordinate`` of a figure; ``values`` of the effect's numbers where they are not those at
    which a fit starts; the ``target`` of an effect that has one; ``materials`` where others than the scene's show it better.
    """

    setting: str = NIGHT
    coordinate: str = TIME
    values: Mapping[str, float] = field(default_factory=dict)
    target: str | None = None
    materials: Mapping[str, float] = field(default_factory=dict)
