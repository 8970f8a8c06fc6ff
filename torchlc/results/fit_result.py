"""What a fit gives back: it prints its conclusion, plots itself and turns into tables, ArviZ data and JSON."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from torchlc.digits import against_freedom, number_of, stated
from torchlc.files.writing import FIT_SCHEMA, OutputDirectory, without_nan
from torchlc.inference.identifiability import Insight, bare_view, judge
from torchlc.inference.likelihood import Likelihood
from torchlc.inference.optimiser import Fit, Mode
from torchlc.inference.posterior_draws import Posterior
from torchlc.lightcurve.model import LightCurve
from torchlc.materials.known import match
from torchlc.readers import Recording, left_out
from torchlc.results.inference_data import inference_data, without_cluster
from torchlc.results.parameter_values import noise_levels, parameter_values, thinned
from torchlc.results.residual_rms import rms_mag, rms_relative
from torchlc.results.tables import parameter_table
from torchlc.scene import Scene
from torchlc.scene.timestamps import utc_text
from torchlc.stages.light import View

if TYPE_CHECKING:
    import arviz
    import pandas
    from astropy.table import Table
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from torchlc.figures.curves import Comparison
    from torchlc.figures.draws import Draws

MOST_CORNER = 10
"""Parameters of a corner plot: more panels than 10 x 10 cannot be read on a page."""
BAND_DRAWS = 200
"""Of the curve: the ends of its 68 % band are right to a tenth of a standard deviation."""


@dataclass(frozen=True)
class FitResult:
    """A fitted recording: the maximum a posteriori, the posterior (None where nothing is free) and what
    they mean.

    ``seconds`` by stage; ``warnings`` in words; ``provenance`` says from what, with what and how it was
    made.
    """

    fit: Fit
    posterior: Posterior | None
    seconds: Mapping[str, float]
    warnings: Sequence[str]
    seed: int = 0
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def model(self) -> LightCurve:
        return self.fit.model

    @property
    def likelihood(self) -> Likelihood:
        return self.fit.likelihood

    @property
    def recording(self) -> Recording:
        return self.model.recording

    @property
    def fitted_scene(self) -> Scene:
        """The scene with the effects that were in the model, and the epoch of its spin written out."""
        scene = self.model.scene
        entries = [effect.entry for effect in self.model.effects]
        scene = scene.model_copy(
            update={"model": scene.model.model_copy(update={"effects": list(dict.fromkeys(entries))})}
        )
        scene.model.model_fields_set.add("effects")
        first: Any = self.recording.first_time
        # a prediction reads the epoch as UTC; where none can be made only recordings do, in their own scale
        return scene.with_spin_epoch(utc_text(first) if scene.orbit.known else str(first.isot))

    @property
    def names(self) -> list[str]:
        """Full names of the free parameters."""
        return self.model.names

    @property
    def converged(self) -> bool:
        return self.fit.converged and (self.posterior is None or self.posterior.converged)

    @property
    def reason(self) -> str:
        """Why the search and the chain are trusted, or not."""
        return self.fit.reason if self.posterior is None else f"{self.fit.reason}; {self.posterior.reason}"

    @cached_property
    def view(self) -> View:
        """Geometry of every row at the maximum a posteriori."""
        return bare_view(self.model, self.fit.theta)

    @cached_property
    def insight(self) -> Insight:
        """What the data say about each parameter."""
        if self.posterior is None:
            return Insight({}, [])
        return judge(self.likelihood, self.fit.theta, self.posterior.flat, self.view, self.seed)

    @cached_property
    def delta(self) -> np.ndarray:
        """Residuals at the maximum a posteriori, observed minus model, (T,), mag or relative flux."""
        return self.recording.observed - self.prediction

    @cached_property
    def prediction(self) -> np.ndarray:
        """The model at the maximum a posteriori in the recording's unit, (T,), gains applied."""
        with torch.no_grad():
            return self.likelihood.residuals(self.fit.theta).prediction.numpy()

    @cached_property
    def shares(self) -> np.ndarray:
        """Share of each component in each row's light, (C, T); 0 in rows without light."""
        with torch.no_grad():
            shares = self.model.brightness(self.fit.theta, shares=True).shares
        assert shares is not None  # asked for
        return shares.numpy()

    @cached_property
    def band(self) -> np.ndarray | None:
        """5, 50 and 95 % of the model's prediction over the posterior, (3, T); None where nothing is free."""
        if self.posterior is None:
            return None
        with torch.no_grad():
            many = self.likelihood.residuals(thinned(self.posterior.flat, BAND_DRAWS)).prediction.numpy()
        return np.quantile(many, [0.05, 0.5, 0.95], axis=0)

    @cached_property
    def error(self) -> np.ndarray:
        """Standard deviation of each row, (T,): as recorded, or as fitted."""
        with torch.no_grad():
            residuals = self.likelihood.residuals(self.fit.theta)
            if self.likelihood.fitted_errors:
                return self.likelihood.fitted_levels(residuals.delta)[self.likelihood.curve].numpy()
            sigma = self.model.noise(self.fit.theta).sigma(residuals.sigma, residuals.scale)
            return sigma.expand(residuals.delta.shape).numpy()

    @property
    def comparison(self) -> Comparison:
        """Recording and model as the light curve's figure shows them."""
        from torchlc.figures.curves import Comparison

        band = None if self.band is None else self.band[[0, 2]]
        return Comparison(self.recording, self.prediction, self.error, band)

    def foremost(self, most: int = MOST_CORNER) -> list[str]:
        """At most that many parameters, those that the data inform first, in the order of theta."""
        informed = self.insight.informed
        first = sorted(self.names, key=lambda name: not informed.get(name, False))[:most]
        return [name for name in self.names if name in first]

    def draws(self, names: Sequence[str]) -> list[Draws]:
        """The posterior's draws of some parameters, by walker and step. ValueError where nothing was free."""
        from torchlc.figures.draws import Draws

        if self.posterior is None:
            raise ValueError("nothing was free: there is no posterior")
        places = [self.posterior.names.index(name) for name in names]
        free = self.model.parameter_set.free
        return [
            Draws(free[k].name, free[k].unit, self.posterior.theta[..., k].numpy(), free[k].prior.logarithmic)
            for k in places
        ]

    @property
    def chain_steps(self) -> np.ndarray:
        """Steps of the chain, (draws of a walker,), at which the posterior's draws were taken."""
        if self.posterior is None:
            raise ValueError("nothing was free: there is no posterior")
        return self.posterior.burn + self.posterior.thin * np.arange(self.posterior.theta.shape[1])

    # ------------------------------------------------------------------ numbers

    def parameters(self) -> dict[str, dict[str, Any]]:
        """Everything known of each free parameter, by name, as in fit.json; noise levels where they were
        fitted.
        """
        values = {} if self.posterior is None else parameter_values(self.fit, self.posterior, self.insight)
        return values | noise_levels(self.fit, self.posterior, self.seed)

    def gains(self) -> dict[str, float]:
        """Scale of each curve of relative flux at the maximum a posteriori."""
        with torch.no_grad():
            gain = self.likelihood.residuals(self.fit.theta).gain
        return {} if gain is None else dict(zip(self.recording.curve_ids, gain.tolist(), strict=True))

    @property
    def rms_mag(self) -> float:
        """Root mean square residual, mag, over measured rows in which both fluxes are positive."""
        return rms_mag(self.recording, self.prediction)

    @property
    def rms_relative(self) -> float:
        """Root mean square residual of flux over the model (magnitudes), or over the mean of its curve
        (relative flux).
        """
        return rms_relative(self.recording, self.prediction)

    def mean_shares(self) -> dict[str, dict[str, float]]:
        """Mean share of each component over the rows with light."""
        lit = self.shares.sum(0) > 0
        mean = self.shares[:, lit].mean(1) if lit.any() else np.zeros(len(self.shares))
        return {
            name: {"mean_share": float(share)}
            for name, share in zip(self.model.assembly.components, mean, strict=True)
        }

    def materials(self) -> dict[str, list[dict[str, Any]]]:
        """For each material with free parameters, the known materials, most probable first."""
        if self.posterior is None:
            return {}
        draws: dict[str, dict[str, np.ndarray]] = {}
        for free, column in zip(self.model.parameter_set.free, self.posterior.flat.numpy().T, strict=True):
            if free.origin.role == "materials":
                draws.setdefault(free.origin.owner, {})[free.origin.quantity] = column
        matches = {}
        for name, material in self.model.scene.materials.items():
            samples = draws.get(name)
            if samples:
                matches[name] = [vars(candidate) for candidate in match(samples, model=material.model)]
        return matches

    def modes(self) -> list[dict[str, Any]]:
        """Distinct minima: chi-square (with the priors' rows) and parameters of each, best first."""

        def told(mode: Mode) -> dict[str, Any]:
            return {
                "chi2": mode.objective,
                "parameters": dict(zip(self.names, mode.theta.tolist(), strict=True)),
            }

        return [told(mode) for mode in self.fit.modes]

    @cached_property
    def all_warnings(self) -> list[str]:
        """Everything a reader should know, each once."""
        return list(dict.fromkeys([*left_out(self.recording), *self.warnings, *self.insight.warnings]))

    def to_json(self) -> dict[str, Any]:
        """The content of fit.json; numbers that do not exist are None."""
        posterior = self.posterior
        content = {
            "schema": FIT_SCHEMA,
            "converged": self.converged,
            "reason": self.reason,
            "error_source": self.recording.error_source,
            "dropped": dict(self.recording.dropped),
            "rows": len(self.recording),
            "effects": list(dict.fromkeys(effect.name for effect in self.model.effects)),
            "parameters": self.parameters(),
            "gains": self.gains(),
            "modes": self.modes(),
            "chi2": self.fit.chi2,
            "dof": self.fit.dof,
            "p_value": self.fit.p_value,
            "rms_mag": self.rms_mag,
            "rms_relative": self.rms_relative,
            "acceptance": None if posterior is None else posterior.acceptance,
            "autocorrelation_time": None if posterior is None else float(posterior.tau.max()),
            "samples": 0 if posterior is None else len(posterior.flat),
            "seconds": dict(self.seconds),
            "components": self.mean_shares(),
            "materials": self.materials(),
            "warnings": self.all_warnings,
            "provenance": dict(self.provenance),
        }
        return without_nan(content)

    # ------------------------------------------------------------------ other people's objects

    def to_table(self) -> Table:
        """One row a parameter: name, map, median, sd, q05, q95, rhat, ess, unit, informed."""
        return parameter_table(self.parameters())

    def to_pandas(self) -> pandas.DataFrame:
        """The same as a DataFrame of pandas."""
        return self.to_table().to_pandas()

    def to_arviz(self) -> arviz.InferenceData:
        """Posterior by walker and draw, with the log density and the recording; "/" in names becomes "|",
        which netCDF needs, and the attribute ``parameter`` of each variable holds the name itself.
        """
        if self.posterior is None:
            raise ValueError("nothing was free: there is no posterior")
        return inference_data(
            self.posterior,
            self.recording,
            attributes={
                "torchlc": str(self.provenance.get("versions", {}).get("torchlc", "")),
                "seed": self.seed,
                "scene": self.fitted_scene.to_toml(),
            },
        )

    def write_into(self, directory: OutputDirectory) -> None:
        """fit.json and posterior.nc: the numbers, for which nothing has to be drawn."""
        directory.write_json("fit.json", self.to_json())
        if self.posterior is not None:
            data = self.to_arviz()
            with without_cluster():
                directory.write("posterior.nc", lambda path: data.to_netcdf(str(path), engine="h5netcdf"))

    # ------------------------------------------------------------------ pictures

    def plot_curve(self, axes: Sequence[Axes] | None = None) -> Sequence[Axes]:
        """Recording, model with its 90 % band, and residuals below: a pair of axes for each night, or curve
        of relative flux.
        """
        from torchlc.figures.curves import curve_size, draw_curves, draw_on

        if axes is not None:
            draw_on(self.comparison, axes)
            return axes
        import matplotlib.pyplot as plt

        return draw_curves(self.comparison, plt.figure(figsize=curve_size(self.recording)))

    def plot_shares(self, axes: Axes | None = None) -> Axes:
        """Light of each component along the recording."""
        from torchlc.figures.shares import SIZE, draw_shares

        axes = _notebook_figure(SIZE).subplots() if axes is None else axes
        return draw_shares(self.recording, self.model.assembly.components, self.shares, axes)

    def plot_corner(self) -> Figure:
        """Posterior of every pair of the :meth:`foremost` parameters."""
        from torchlc.figures.draws import corner_size, draw_corner

        chosen = self.foremost()
        return draw_corner(self.draws(chosen), _notebook_figure(corner_size(len(chosen))))

    def plot_traces(self) -> Figure:
        """Every walker's way after burn-in."""
        from torchlc.figures.draws import draw_traces, traces_size

        figure = _notebook_figure(traces_size(len(self.names)))
        return draw_traces(self.draws(self.names), self.chain_steps, figure)

    def plot_object(self, row: int | None = None, axes: Axes | None = None) -> Axes:
        """The object with the directions of Sun and observer at ``row``, by default the brightest."""
        from torchlc.figures.object_drawing import brightest, draw_object

        if axes is None:
            import matplotlib.pyplot as plt

            axes = plt.subplots(figsize=(5.6, 5.0))[1]
        row = brightest(self.recording, self.prediction) if row is None else row
        return draw_object(self.model, self.view, row, axes)

    def lines(self) -> list[tuple[str, str]]:
        """(name, value with its uncertainty) of every parameter, ready to print."""
        return [
            (name, stated(row) + ("" if row["informed"] else "  (prior)"))
            for name, row in self.parameters().items()
        ]

    def headline(self) -> str:
        """The fit in one sentence."""
        state = "converged" if self.converged else "not converged"
        spread = "upper limits alone" if self.recording.upper_limit.all() else f"rms {self.rms_mag:.3f} mag"
        return (
            f"{self.model.scene.name}: {number_of(len(self.recording), 'row')}, "
            f"chi2 {against_freedom(self.fit.chi2, self.fit.dof)}, {spread}, {state}"
        )

    def __repr__(self) -> str:
        rows = self.lines()
        width = max((len(name) for name, _ in rows), default=0)
        warned = [f"  ! {text}" for text in self.all_warnings]
        return "\n".join(
            [f"FitResult: {self.headline()}", *(f"  {name:{width}}  {text}" for name, text in rows), *warned]
        )

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><td>{html.escape(n)}</td><td>{html.escape(v)}</td></tr>" for n, v in self.lines()
        )
        warned = "".join(f"<li>{html.escape(text)}</li>" for text in self.all_warnings)
        return f"<p>{html.escape(self.headline())}</p><table>{rows}</table><ul>{warned}</ul>"


def _notebook_figure(size: tuple[float, float]) -> Figure:
    """A figure that a notebook shows."""
    import matplotlib.pyplot as plt

    return plt.figure(figsize=size)
