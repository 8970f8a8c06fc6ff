"""Simulated curves: computed from a model, shown, and written as the table curve.ecsv, which is a recording
again.
"""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from astropy.table import MaskedColumn, Table
from torch import Tensor

from torchlc.digits import number_of
from torchlc.files.writing import without_nan, write_whole
from torchlc.geometry.orbit.sunlight import sunlit_fraction
from torchlc.inference.identifiability import bare_view, limits
from torchlc.lightcurve.model import LightCurve
from torchlc.noise.draw import draw
from torchlc.noise.error_law import MAG_PER_LN
from torchlc.readers import Recording, iso_times, left_out
from torchlc.readers.exchange import carried, told
from torchlc.scene import Scene

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes

DEFAULT_AIR_KM = 20.0
"""Opaque air over the Earth for the column eclipse_fraction of a model without earth_shadow."""
UNITS = {
    "mag": "mag", "mag_err": "mag", "range_km": "km", "phase_angle_deg": "deg", "elevation_deg": "deg",
}  # fmt: skip
DIGITS = ".12g"


@dataclass(frozen=True)
class SimulatedCurve:
    """A simulated light curve: the columns (T,) of curve.ecsv, None where unknown, and shares (T,) by
    component.

    ``mag`` is +inf and shares are not-a-number where no light comes; both are blank in the table.
    """

    name: str
    recording: Recording
    columns: Mapping[str, np.ndarray | None]
    shares: Mapping[str, np.ndarray]
    warnings: Sequence[str] = ()
    seed: int = 0

    @property
    def mag(self) -> np.ndarray:
        """Apparent magnitudes (T,)."""
        return self._known("mag")

    @property
    def flux(self) -> np.ndarray:
        """Irradiance over that of the Sun at 1 au, (T,)."""
        return self._known("flux")

    def _known(self, name: str) -> np.ndarray:
        column = self.columns[name]
        assert column is not None  # only geometry can be unknown
        return column

    def to_table(self) -> Table:
        """Time, station, the columns, a ``share <component>`` each, then what the recording brought."""
        recording, rows = self.recording, len(self.recording)
        columns: dict[str, Any] = {
            "time": iso_times(recording),
            "station": np.array(recording.station_ids, dtype=str)[recording.station],
        }
        columns |= {name: masked(values, rows, name) for name, values in self.columns.items()}
        columns |= {f"share {name}": masked(values, rows, "") for name, values in self.shares.items()}
        return Table(columns | carried(recording), meta={"object": self.name, **told(recording)})

    def to_pandas(self) -> pandas.DataFrame:
        """The same as a DataFrame of pandas; what is unknown is missing."""
        return self.to_table().to_pandas()

    def write(self, path: str | Path) -> Path:
        """Write as ECSV, whole or not at all."""
        table = self.to_table()
        return write_whole(
            Path(path), lambda partial: table.write(partial, format="ascii.ecsv", overwrite=True)
        )

    def plot(self, axes: Axes | None = None) -> Axes:
        """Magnitude along time, a line a station."""
        from torchlc.figures.magnitudes import SIZE, draw_magnitudes

        if axes is None:
            import matplotlib.pyplot as plt

            axes = plt.figure(figsize=SIZE).subplots()
        return draw_magnitudes(self.recording, self.mag, axes)

    def to_json(self) -> dict[str, Any]:
        """A summary: rows, range of magnitude, the brightest row, mean shares; the same of recorded magnitudes."""
        mag = self.mag
        seen = np.isfinite(mag)
        any_light = bool(seen.any())
        peak = int(np.argmin(np.where(seen, mag, math.inf)))
        brightest = {"time": iso_times(self.recording)[peak], "mag": mag[peak]}
        recorded = self._recorded()
        return without_nan(
            {
                "name": self.name,
                "rows": len(mag),
                "rows_without_light": int((~seen).sum()),
                "brightest": brightest if any_light else None,
                "faintest_mag": mag[seen].max() if any_light else None,
                "components": {
                    name: {"mean_share": np.nanmean(share) if any_light else None}
                    for name, share in self.shares.items()
                },
                **({} if recorded is None or not any_light else {"recorded": recorded}),
                "warnings": list(self.warnings),
            }
        )

    def _recorded(self) -> dict[str, Any] | None:
        """Range of the magnitudes at whose rows it was simulated, and by how much they are fainter at the median;
        None without any."""
        seen = self.recording.observed
        if self.recording.kind != "mag" or not np.isfinite(seen).all():
            return None
        peak, lit = int(np.argmin(seen)), np.isfinite(self.mag)
        return {
            "brightest": {"time": iso_times(self.recording)[peak], "mag": seen[peak]},
            "faintest_mag": seen.max(),
            "fainter_mag": np.median((seen - self.mag)[lit]) if lit.any() else None,
        }

    def headline(self) -> str:
        """The curve in one line, beside the magnitudes at whose rows it was simulated."""
        said = self.to_json()
        if said["brightest"] is None:
            return f"{self.name}: {number_of(said['rows'], 'row')}, no light in any"
        text = f"{self.name}: {number_of(said['rows'], 'row')}, {self._range(said)}"
        if "recorded" in said:
            fainter = said["recorded"]["fainter_mag"]
            text += (
                f"; recorded {self._range(said['recorded'])}, at the median {abs(fainter):.2f} mag "
                f"{'fainter' if fainter > 0 else 'brighter'}"
            )
        return text

    def _range(self, said: Mapping[str, Any]) -> str:
        when, brightest = said["brightest"]["time"][:19], said["brightest"]["mag"]
        scale = self.recording.time.scale.upper()
        return f"{brightest:.2f} mag at {when} {scale} down to {said['faintest_mag']:.2f} mag"

    def __repr__(self) -> str:
        return "\n".join([f"SimulatedCurve: {self.headline()}", *(f"  ! {text}" for text in self.warnings)])

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(repr(self))}</pre>"


def simulated_curve(
    scene: Scene, recording: Recording, noise: float | None = None, seed: int = 0
) -> SimulatedCurve:
    """The curve of a model at its starting values; with normal errors of ``noise`` mag if given, which are
    quoted, widened by what the model's noise effects say, which is not.
    """
    quoted = replace(recording, error=np.full(len(recording), 1.0 if noise is None else noise))
    model = LightCurve(scene, quoted)
    theta = model.parameter_set.start()
    with torch.no_grad():
        # a batch of one, whose pairs are worked off in pieces; no axis for it where nothing free sheds light
        batch = model.brightness(theta[None], shares=True)
        assert batch.shares is not None  # asked for
        shape = (-1, len(recording))
        brightness = replace(batch, flux=batch.flux.reshape(-1), shares=batch.shares.reshape(shape))
        mag = model.magnitude(brightness, theta).numpy()
    flux, shares = brightness.flux.numpy(), batch.shares.reshape(shape).numpy()
    columns: dict[str, np.ndarray | None] = {"mag": mag, "flux": flux}
    if noise is not None:
        delta = _errors(model, theta, noise, seed)
        flux = flux * np.exp(-delta / MAG_PER_LN)
        flux_err = np.where(flux > 0, flux * noise / MAG_PER_LN, np.nan)
        columns = {
            "mag": mag + delta,
            "mag_err": np.full(len(mag), noise),
            "flux": flux,
            "flux_err": flux_err,
        }
    shares = np.where(shares.sum(0) == 0, np.nan, shares)
    geometry = _geometry(model, theta)
    return SimulatedCurve(
        name=scene.name,
        recording=recording if noise is None else quoted,
        columns=columns | geometry,
        shares=dict(zip(brightness.components, shares, strict=True)),
        warnings=[
            *left_out(recording),
            *_below_horizon(geometry["elevation_deg"], flux > 0),
            *model.assembly.warnings,
            *limits(model, theta),
        ],
        seed=seed,
    )


def _below_horizon(elevation: np.ndarray | None, lit: np.ndarray) -> list[str]:
    """What to say of rows (T,) that are lit and stand below the horizon of their station."""
    if elevation is None or not (below := int(np.count_nonzero((elevation < 0) & lit))):
        return []
    return [
        f"{below:,} of {len(lit):,} rows are below the horizon (elevation_deg), where nobody sees the object; torchlc predict finds its passes"
    ]


def masked(values: np.ndarray | None, rows: int, name: str) -> MaskedColumn:
    """A column (T,) whose unknown (None) or non-finite cells are masked."""
    data = np.full(rows, np.nan) if values is None else np.asarray(values, dtype=float)
    hidden = ~np.isfinite(data)
    column: Any = MaskedColumn(np.where(hidden, 0.0, data), mask=hidden, unit=UNITS.get(name), format=DIGITS)
    return column


def _geometry(model: LightCurve, theta: Tensor) -> dict[str, np.ndarray | None]:
    """Range, phase angle, elevation, airmass and the share of the Sun that the Earth hides, (T,) each; None
    where unknown."""
    track = model.assembly.track
    with torch.no_grad():
        state = bare_view(model, theta).state
        eclipse = None
        if track.supports("position") and state.position is not None:
            air = theta.new_tensor([DEFAULT_AIR_KM])
            for effect in model.effects:
                if effect.opaque_air:
                    air = model.assembly.own(effect, model.values(theta))[effect.opaque_air]
            eclipse = 1.0 - sunlit_fraction(state.position[0], state.sun[0], air)
        columns = {
            "range_km": track.range_km,
            "phase_angle_deg": track.phase_angle_deg,
            "elevation_deg": track.elevation_deg,
            "airmass": track.airmass,
            "eclipse_fraction": eclipse,
        }
    return {name: None if values is None else values.numpy() for name, values in columns.items()}


def _errors(model: LightCurve, theta: Tensor, sigma: float, seed: int) -> np.ndarray:
    """Random errors (T,), mag: of rows that quote ``sigma``, with what the model's noise effects add."""
    context = model.assembly.context
    with torch.no_grad():
        quoted = torch.full((model.assembly.T,), sigma, dtype=theta.dtype, device=theta.device)
        return draw(model.noise(theta), quoted, context.curve, np.random.default_rng(seed)).numpy()
