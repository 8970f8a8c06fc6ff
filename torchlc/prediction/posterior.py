"""The posterior of a fit, and the scene that it belongs to, from a result or from the directory of one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from torchlc.effects import names as effect_names
from torchlc.errors import InputError
from torchlc.files.hdf5 import check_hdf5
from torchlc.files.reading import readable_file
from torchlc.prediction.brightness import Posterior
from torchlc.results.fit_result import FitResult
from torchlc.results.stored_fit import StoredFit
from torchlc.scene import Scene

POSTERIOR_FILE = "posterior.nc"
EXPECTED = "the directory of a finished fit"
MOST_BYTES = 2_000_000_000
"""Of a posterior.nc: what is larger was not written here."""


def read_fit(
    given: str | Path | Scene | FitResult | StoredFit, load: Callable[[str | Path | Scene], Scene]
) -> tuple[Scene, Posterior | None, list[Path]]:
    """The scene, the posterior if ``given`` is a fit, as made, as stored or as its directory, and the files that were read; other scenes by
    ``load``."""
    if isinstance(given, FitResult):
        posterior = given.posterior
        if posterior is None:
            return given.fitted_scene, None, []
        return given.fitted_scene, Posterior(tuple(posterior.names), posterior.flat.numpy()), []
    if isinstance(given, StoredFit):
        given = given.directory
    if isinstance(given, str | Path) and Path(given).is_dir():
        path = Path(given) / POSTERIOR_FILE
        scene, posterior = read_posterior(path)
        return scene, posterior, [path]
    return load(given), None, []


def read_posterior(path: Path) -> tuple[Scene, Posterior]:
    """Scene and draws of a posterior.nc that a fit wrote. Files that the scene names are looked for beside it."""
    hint = "A fit in which nothing is free leaves no posterior: give its scene."
    if not path.exists():
        raise InputError(path, None, "no such file", EXPECTED, hint)
    readable_file(path, EXPECTED)
    if path.stat().st_size > MOST_BYTES:
        raise InputError(path, None, "more than 2 GB", EXPECTED)
    check_hdf5(path, EXPECTED)
    try:
        with h5py.File(path, "r") as file:
            group: Any = file["posterior"]
            text = file.attrs.get("scene", group.attrs.get("scene"))
            columns = {
                _text(variable.attrs["parameter"]): np.asarray(variable, dtype=float).reshape(-1)
                for variable in group.values()
                if "parameter" in variable.attrs
            }
            draws = np.stack(list(columns.values()), axis=-1)
    except (OSError, KeyError, ValueError, TypeError, AttributeError) as error:
        raise InputError(
            path, None, f"not readable as a posterior ({type(error).__name__})", EXPECTED
        ) from None
    if text is None:
        raise InputError(
            path, None, "no scene in it: an earlier version of torchlc wrote it", EXPECTED, "Repeat the fit."
        )
    if not len(draws) or not np.isfinite(draws).all():
        raise InputError(path, None, "no draws, or some that are no numbers", EXPECTED)
    scene = Scene.from_toml(_text(text), path.parent, path, known_effects=effect_names())
    return scene, Posterior(tuple(columns), draws)


def _text(value: object) -> str:
    return value.decode() if isinstance(value, bytes) else str(value)
