"""A posterior as ArviZ's InferenceData, with names that netCDF takes."""

from __future__ import annotations

import unicodedata
import warnings
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING, Any

import numpy as np

from torchlc.files.libraries import arviz_library
from torchlc.inference.posterior_draws import Posterior
from torchlc.readers import Recording

if TYPE_CHECKING:
    import arviz


def inference_data(
    posterior: Posterior, recording: Recording, attributes: Mapping[str, Any]
) -> arviz.InferenceData:
    """The posterior by walker and draw, with the log density and the recording."""
    arviz = arviz_library()
    names = variable_names(posterior.names)
    draws = {name: posterior.theta[..., i].numpy() for i, name in enumerate(names)}
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "More chains", UserWarning)  # walkers, of a short chain
        data = arviz.from_dict(
            posterior=draws,
            sample_stats={"lp": posterior.log_prob.numpy()},
            observed_data={recording.kind: recording.observed},
            constant_data={"seconds": recording.seconds},
            coords={"row": np.arange(len(recording))},
            dims={recording.kind: ["row"], "seconds": ["row"]},
            attrs=dict(attributes),
        )
    for variable, name in names.items():
        data["posterior"][variable].attrs["parameter"] = name
    return data


def without_cluster() -> AbstractContextManager[Any]:
    """Work done here: xarray asks dask for its scheduler when it writes, and the client of a cluster may have gone."""
    try:
        import dask.config
    except ImportError:
        return nullcontext()
    return dask.config.set(scheduler="synchronous")


def variable_names(names: Sequence[str]) -> dict[str, str]:
    """Names of netCDF variables for parameters, all different also where signs are composed (Unicode's NFC, which
    netCDF applies), and the parameters' own."""
    variables: dict[str, str] = {}
    composed: set[str] = set()
    for name in names:
        variable, copy = name.replace("/", "|"), 2
        while unicodedata.normalize("NFC", variable) in composed:
            variable, copy = f"{name.replace('/', '|')} ({copy})", copy + 1
        composed.add(unicodedata.normalize("NFC", variable))
        variables[variable] = name
    return variables
