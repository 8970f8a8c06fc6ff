"""Everything a fit leaves in its directory."""

from __future__ import annotations

from torchlc.output import OutputDirectory
from torchlc.results import FitResult


def write_fit(result: FitResult, directory: OutputDirectory, progress=None) -> None:
    directory.write_json("fit.json", result.to_json())
    if result.posterior is not None:
        data = result.to_arviz()
        directory.write("posterior.nc", lambda path: data.to_netcdf(str(path), engine="h5netcdf"))
