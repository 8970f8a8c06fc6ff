"""A fit read back from its folder: fit.json and posterior.nc, without the model."""

from __future__ import annotations

import html
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from torchlc.digits import against_freedom, number_of, stated
from torchlc.errors import InputError
from torchlc.files.hdf5 import check_hdf5
from torchlc.files.libraries import arviz_library
from torchlc.files.reading import readable_file
from torchlc.files.writing import FIT_SCHEMA
from torchlc.results.tables import parameter_table

if TYPE_CHECKING:
    import arviz
    import pandas
    from astropy.table import Table

MOST_BYTES = 1 << 28
"""Of fit.json: hundreds of parameters need some 100 kB."""


@dataclass(frozen=True)
class StoredFit:
    """What a fit wrote: ``content`` is that of fit.json; ``draws`` (walkers, draws of each) by parameter, empty where
    nothing was free."""

    directory: Path
    content: Mapping[str, Any]
    draws: Mapping[str, np.ndarray]

    @property
    def names(self) -> list[str]:
        """Full names of the parameters that were sampled."""
        return list(self.draws)

    @property
    def converged(self) -> bool:
        return bool(self.content["converged"])

    @property
    def reason(self) -> str:
        """Why the search and the chain are trusted, or not."""
        return str(self.content["reason"])

    @property
    def warnings(self) -> list[str]:
        return list(self.content["warnings"])

    def parameters(self) -> dict[str, dict[str, Any]]:
        """Everything known of each parameter, by name, as in fit.json."""
        return {name: dict(row) for name, row in self.content["parameters"].items()}

    def to_json(self) -> dict[str, Any]:
        """The content of fit.json."""
        return dict(self.content)

    def to_table(self) -> Table:
        """One row a parameter, as :meth:`FitResult.to_table` gives it."""
        return parameter_table(self.parameters())

    def to_pandas(self) -> pandas.DataFrame:
        """The same as a DataFrame of pandas."""
        return self.to_table().to_pandas()

    def to_arviz(self) -> arviz.InferenceData:
        """The content of posterior.nc."""
        if not self.draws:
            raise ValueError("nothing was free: there is no posterior")
        return arviz_library().from_netcdf(str(self.directory / "posterior.nc"), engine="h5netcdf")

    def __repr__(self) -> str:
        content = self.content
        state = "converged" if self.converged else "not converged"
        rows = [
            (name, stated(row) + ("" if row["informed"] else "  (prior)"))
            for name, row in self.parameters().items()
        ]
        width = max((len(name) for name, _ in rows), default=0)
        head = f"StoredFit: {self.directory}: {number_of(content['rows'], 'row')}, chi2 {against_freedom(content['chi2'], content['dof'])}, {state}"
        lines = [f"  {name:{width}}  {text}" for name, text in rows]
        return "\n".join([head, *lines, *(f"  ! {text}" for text in self.warnings)])

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(repr(self))}</pre>"


def load_fit(folder: str | Path) -> StoredFit:
    """Read the results of a fit from the folder that it wrote.

    Raises InputError where fit.json is not there or is none, or its posterior.nc is missing or of another fit.
    """
    folder = Path(folder)
    path = readable_file(folder / "fit.json", "the folder of a fit, which holds fit.json")
    if path.stat().st_size > MOST_BYTES:
        raise InputError(path, None, "more than 256 MiB", "a fit.json that torchlc wrote")
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(path, None, f"no JSON: {error}"[:200], "a fit.json that torchlc wrote") from None
    keys = {"parameters", "converged", "reason", "warnings", "rows", "chi2", "dof", "samples"}
    if not isinstance(content, dict) or content.get("schema") != FIT_SCHEMA or not keys <= set(content):
        found = repr(content.get("schema"))[:60] if isinstance(content, dict) else type(content).__name__
        raise InputError(path, "schema", found, f"{FIT_SCHEMA!r}, and its keys")
    draws = _draws(folder / "posterior.nc") if content["samples"] else {}
    stray = [name for name in draws if name not in content["parameters"]]
    if stray:
        raise InputError(
            folder / "posterior.nc", stray[0], "a parameter that fit.json lacks", "files of one fit"
        )
    return StoredFit(folder, content, draws)


def _draws(path: Path) -> dict[str, np.ndarray]:
    check_hdf5(readable_file(path, "the posterior that the fit wrote"), "a posterior.nc that torchlc wrote")
    arviz = arviz_library()
    try:
        data = arviz.from_netcdf(str(path), engine="h5netcdf")
        draws = {
            str(variable.attrs.get("parameter", name)): np.asarray(variable.values, dtype=float)
            for name, variable in data["posterior"].data_vars.items()
        }
    except Exception as error:  # h5netcdf and xarray raise anything where a file is damaged
        raise InputError(
            path, None, f"cannot be read: {error}"[:200], "a posterior.nc that torchlc wrote"
        ) from None
    if any(not math.prod(values.shape) for values in draws.values()):
        raise InputError(path, None, "no draws", "a posterior.nc that torchlc wrote")
    return draws
