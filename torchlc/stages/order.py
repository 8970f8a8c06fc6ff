"""The stages of a light curve in their order, and which of them belong together.

A light curve is computed in stages, in this order; an effect changes what passes through its own stage and
nothing else:

=============  ===========================================================================================
stage          what passes through
=============  ===========================================================================================
``clock``      :class:`Nodes`: the instants at which a row is evaluated, and their weights
``orbit``      :class:`Request`: where object and observer are taken
``spin``       the values of the attitude
``attitude``   rotation (Q, T, 3, 3), body to inertial
``pointing``   poses of the parts that track the Sun
``light``      :class:`Light` sources
``surface``    :class:`Patch` surfaces: area, visible fraction
``shade``      share of the Sun that the object sees, by row
``scatter``    further sunlight that needs the whole geometry, added per component
``material``   lobe and diffuse light of a patch as functions of its material; ``law`` may tabulate more for them
``detector``   :class:`Brightness`: total flux and component shares
``noise``      :class:`Noise`: variance, law and correlation of the residuals
=============  ===========================================================================================
"""

from __future__ import annotations

STAGES = (
    "clock", "orbit", "spin", "attitude", "pointing", "light", "surface", "shade",
    "scatter", "material", "detector", "noise",
)  # fmt: skip
GEOMETRY_STAGES = frozenset(STAGES[: STAGES.index("shade")])
"""Before the shade: an effect here moves or turns what is lit."""
SCALING_STAGES = frozenset(("light", "surface", "shade", "scatter", "detector"))
"""Where more of an effect changes the light in proportion; elsewhere glints are moved or widened, which soon does not."""
