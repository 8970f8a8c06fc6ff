"""Parameters as a table."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from astropy.table import Table

COLUMNS = ("name", "map", "median", "sd", "q05", "q95", "rhat", "ess", "unit", "informed")


def parameter_table(parameters: Mapping[str, Mapping[str, Any]]) -> Table:
    """One row a parameter, as fit.json has it by name; not-a-number where a number does not exist."""
    rows = [{"name": name, **row} for name, row in parameters.items()]
    return Table({key: [math.nan if row[key] is None else row[key] for row in rows] for key in COLUMNS})
