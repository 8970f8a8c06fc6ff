"""A cylinder."""

from __future__ import annotations

from torchlc.files.numbers import Direction, Size
from torchlc.shapes.component import Component
from torchlc.shapes.cone import Cone
from torchlc.shapes.smooth import Around


class CylinderKeys(Component):
    """Closed by two caps; ``axis`` points to cap+, ``facets`` is the least number of side facets."""

    radius: Size
    length: Size
    axis: Direction = (0.0, 0.0, 1.0)
    facets: Around | None = None


class Cylinder(Cone):
    """Closed by two caps: "side" (u = axis), "cap+", "cap-"; in the way of others as `Cone`."""

    kind = "cylinder"
    keys = CylinderKeys
    top_key = "radius"
