"""What a prediction gives back: passes, brightest first, as tables, a calendar, JSON and pictures.

Letters: R rows of a pass, Q quantiles of :data:`~torchlc.prediction.brightness.LEVELS`.
"""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from astropy.table import Table

from torchlc.digits import number_of
from torchlc.files.writing import OutputDirectory, without_nan, write_whole
from torchlc.geometry.orbit import airmass
from torchlc.geometry.orbit.sunlight import sunlit_fraction
from torchlc.prediction.calendar import Event, calendar
from torchlc.prediction.ecsv import masked_column, write_table
from torchlc.prediction.glints import Glint
from torchlc.prediction.passes import AIR_KM, Pass, along_track_sd_s
from torchlc.prediction.predicted import PredictedPass, PredictedPasses

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from torchlc.figures.passes import Panel

SCHEMA = "torchlc-prediction/1"
QUANTILES = ("mag_q025", "mag_q16", "mag", "mag_q84", "mag_q975")
"""Columns of the 95 % interval, the 68 % interval and the median; small magnitudes are bright."""
MOST_PANELS = 12
"""Of the figure: six rows of two fill a page."""
PREDICTION_FILES = ("prediction.json", "prediction.ecsv", "passes.ecsv", "passes.ics", "passes.png")


@dataclass(frozen=True)
class Prediction(PredictedPasses):
    """Passes of objects over stations, brightest first; see docs/formats/results.md for the files."""

    # ------------------------------------------------------------------ tables

    def to_table(self) -> Table:
        """A row of passes at a time: where, how bright, in quantiles; the content of prediction.ecsv."""
        paths = [one.path for one in self.passes]
        lengths = [len(path.index) for path in paths]

        def joined(pieces: Sequence[np.ndarray]) -> np.ndarray:
            return np.concatenate(pieces) if pieces else np.zeros(0)

        index = joined([path.index for path in paths]).astype(int)
        columns: dict[str, Any] = {
            "time": np.asarray(self.iso(self.span.seconds[index]), dtype=str)
            if len(index)
            else np.array([], dtype=str),
            "pass": np.repeat(np.arange(1, len(paths) + 1), lengths),
            "object": np.repeat(np.array([self._name(one) for one in self.passes], dtype=str), lengths),
            "station": np.repeat(np.array([self._station(one) for one in self.passes], dtype=str), lengths),
        }
        elevation = joined([path.elevation for path in paths])
        geometry = {
            "elevation_deg": elevation,
            "azimuth_deg": joined([path.azimuth for path in paths]),
            "range_km": joined([path.range_km for path in paths]),
            "phase_angle_deg": joined([path.phase_angle for path in paths]),
            "eclipse_fraction": self._eclipse(paths, index),
        }
        mag = np.concatenate([one.mag for one in self.passes], axis=1) if paths else np.zeros((5, 0))
        light: dict[str, np.ndarray] = dict(zip(QUANTILES, mag, strict=True))
        air = airmass(torch.from_numpy(elevation)).numpy()
        light["extinction_mag"] = self.extinction * air
        light["apparent_mag"] = mag[2] + self.extinction * air
        units = {"elevation_deg": "deg", "azimuth_deg": "deg", "range_km": "km", "phase_angle_deg": "deg"}
        columns |= {key: masked_column(values, units.get(key)) for key, values in geometry.items()}
        columns |= {key: masked_column(values, "mag") for key, values in light.items()}
        return Table(columns, meta={**self._told(), "time_scale": "utc"})

    def _eclipse(self, paths: Sequence[Pass], index: np.ndarray) -> np.ndarray:
        """Share of the Sun that the Earth hides, (R,)."""
        if not len(index):
            return np.zeros(0)
        position = np.concatenate([path.position for path in paths])
        sun = torch.from_numpy(self.span.sun[index] - position)
        seen = sunlit_fraction(torch.from_numpy(position), sun, sun.new_tensor(AIR_KM))
        return 1.0 - seen.numpy()

    def passes_table(self) -> Table:
        """A row a pass, brightest first; the content of passes.ecsv."""
        told = [self._told_pass(one, number) for number, one in enumerate(self.passes, 1)]
        texts = ("object", "number", "station", "begin", "begins", "top", "end", "ends", "brightest")
        angles = ("begin_azimuth_deg", "top_elevation_deg", "top_azimuth_deg", "end_azimuth_deg")
        units = dict.fromkeys(angles, "deg") | {"time_sd_s": "s"}
        units |= dict.fromkeys((*QUANTILES, "apparent_mag"), "mag")
        columns: dict[str, Any] = {"pass": np.array([one["pass"] for one in told], dtype=int)}
        columns |= {key: np.array([one[key] or "" for one in told], dtype=str) for key in texts}
        for key, unit in units.items():
            values = np.array([math.nan if one[key] is None else one[key] for one in told], dtype=float)
            columns[key] = masked_column(values, unit)
        for word in ("events", "glints"):
            columns[word] = np.array([self._sentence(one, word) for one in self.passes], dtype=str)
        return Table(columns, meta=self._told())

    def _sentence(self, one: PredictedPass, word: str) -> str:
        """Events or glints of a pass in one cell."""
        if word == "events":
            return "; ".join(f"{text} {str(self.iso(at))[11:19]}" for at, text in one.path.events)
        return "; ".join(self._glint_words(glint) for glint in one.glints)

    def _glint_words(self, glint: Glint) -> str:
        edge = f", closest when {glint.edge}" if glint.edge else ""
        return (
            f"{glint.component}/{glint.face} {str(self.iso(glint.seconds))[11:19]} ± {glint.time_sd_s:.0f} s{edge}, "
            f"{glint.degrees:.1f} deg from the mirror direction, probability {glint.probability:.0%}"
        )

    # ------------------------------------------------------------------ JSON

    def to_json(self) -> dict[str, Any]:
        """The content of prediction.json; numbers that do not exist are None."""
        objects: dict[int, dict[str, Any]] = {}
        for number, one in enumerate(self.passes, 1):
            orbiter = self.orbiters[one.path.orbiter]
            entry = objects.setdefault(
                one.path.orbiter,
                {
                    "name": orbiter.name,
                    "number": orbiter.number,
                    "elements_age_days": orbiter.age_days,
                    "time_sd_s": along_track_sd_s(orbiter),
                    "mag": float(one.brightest[2]),
                    "passes": [],
                },
            )
            entry["passes"].append(number)
        return without_nan(
            {
                "schema": SCHEMA,
                **self._told(),
                "stations": [
                    {"id": s.id, "latitude": s.latitude, "longitude": s.longitude, "height": s.height}
                    for s in self.span.stations
                ],
                "objects": list(objects.values()),
                "passes": [self._told_pass(one, number) for number, one in enumerate(self.passes, 1)],
                "warnings": list(self.warnings),
                "provenance": dict(self.provenance),
            }
        )

    def _told(self) -> dict[str, Any]:
        return {
            "name": self.name,
            "start": str(self.iso(0.0)),
            "end": str(self.iso(self.span.seconds[-1])),
            "cadence_s": self.span.cadence_s,
            "uncertainty": self.uncertainty,
            "draws": self.draws,
            "scatter_mag": self.scatter_mag,
            "extinction_mag_per_airmass": self.extinction,
            "least_elevation_deg": self.elevation_deg,
            "sun_below_deg": self.sun_deg,
            "faintest_mag": self.faintest_mag,
            "objects_searched": len(self.orbiters),
        }

    def _told_pass(self, one: PredictedPass, number: int) -> dict[str, Any]:
        path, orbiter = one.path, self.orbiters[one.path.orbiter]
        row = one.row
        apparent = None
        if row is not None:
            air = float(airmass(torch.tensor(path.elevation[row], dtype=torch.float64)))
            apparent = float(one.brightest[2]) + self.extinction * air
        begin, top, end = self.iso(np.array([path.begin, path.top, path.end]))
        return {
            "pass": number,
            "object": orbiter.name,
            "number": orbiter.number,
            "station": self._station(one),
            "begin": str(begin),
            "begins": path.begins,
            "begin_azimuth_deg": float(path.azimuth[0]),
            "top": str(top),
            "top_elevation_deg": path.top_elevation,
            "top_azimuth_deg": path.top_azimuth,
            "end": str(end),
            "ends": path.ends,
            "end_azimuth_deg": float(path.azimuth[-1]),
            "time_sd_s": along_track_sd_s(orbiter),
            "visible": one.visible,
            "brightest": None if row is None else str(self.iso(self.span.seconds[path.index[row]])),
            **{
                key: float(value) if math.isfinite(value) else None
                for key, value in zip(QUANTILES, one.brightest, strict=True)
            },
            "apparent_mag": apparent,
            "elevation_deg": None if row is None else float(path.elevation[row]),
            "azimuth_deg": None if row is None else float(path.azimuth[row]),
            "range_km": None if row is None else float(path.range_km[row]),
            "phase_angle_deg": None if row is None else float(path.phase_angle[row]),
            "events": [{"time": str(self.iso(at)), "event": text} for at, text in path.events],
            "glints": [
                {
                    "component": glint.component,
                    "face": glint.face,
                    "time": str(self.iso(glint.seconds)),
                    "time_sd_s": glint.time_sd_s,
                    "degrees": glint.degrees,
                    "lobe_width_deg": glint.width_deg,
                    "duration_s": glint.duration_s,
                    "probability": glint.probability,
                    "closest_when": glint.edge or None,
                }
                for glint in one.glints
            ],
        }

    # ------------------------------------------------------------------ calendar

    def to_ics(self) -> str:
        """The passes that can be seen as a calendar (RFC 5545), an event each."""
        return calendar(self._event(one) for one in self.passes if one.visible)

    def _event(self, one: PredictedPass) -> Event:
        path = one.path
        name, station = self._name(one), self._station(one)
        bright, faint = one.brightest[0], one.brightest[-1]
        told = [
            f"Brightest {one.brightest[2]:.1f} mag ({_mag(bright)} to {_mag(faint)} at 95 %)",
            f"Highest {path.top_elevation:.0f} deg at {str(self.iso(path.top))[11:19]} UTC",
            f"From azimuth {path.azimuth[0]:.0f} to {path.azimuth[-1]:.0f} deg",
            *(f"{text} {str(self.iso(at))[11:19]} UTC" for at, text in path.events),
            *(f"Glint: {self._glint_words(glint)}" for glint in one.glints),
            f"Times are within {max(1, math.ceil(2 * along_track_sd_s(self.orbiters[path.orbiter])))} s with 95 %",
        ]
        return Event(
            name=name,
            number=self.orbiters[path.orbiter].number,
            place=station,
            made=str(self.iso(0.0)),
            begin=str(self.iso(path.begin)),
            end=str(self.iso(path.end)),
            summary=f"{self._called(one)}, {one.brightest[2]:.1f} mag",
            lines=told,
        )

    # ------------------------------------------------------------------ pictures and files

    def panels(self, most: int = MOST_PANELS) -> list[Panel]:
        """The brightest passes as the figure shows them."""
        from torchlc.figures.passes import Panel

        found = []
        for one in [one for one in self.passes if one.visible][:most]:
            seconds = self.span.seconds[one.path.index]
            found.append(
                Panel(
                    title=f"{self._called(one)} over {self._station(one)}",
                    start=f"{str(self.iso(seconds[0]))[:19].replace('T', ' ')} UTC",
                    minutes=(seconds - seconds[0]) / 60,
                    mag=np.where(np.isfinite(one.mag), one.mag, np.nan),
                    elevation=one.path.elevation,
                    glints=[(glint.seconds - seconds[0]) / 60 for glint in one.glints],
                )
            )
        return found

    def plot(self, most: int = MOST_PANELS) -> Figure:
        """The brightest passes: magnitudes with their 68 and 95 % intervals, a panel each."""
        import matplotlib.pyplot as plt

        from torchlc.figures.passes import draw_passes, passes_size

        panels = self.panels(most)
        return draw_passes(panels, plt.figure(figsize=passes_size(len(panels))))

    def write_into(self, directory: OutputDirectory) -> None:
        """Every file of a prediction, the figure last; no figure where nothing is to be seen."""
        directory.clear(PREDICTION_FILES)
        directory.write_json("prediction.json", self.to_json())
        directory.write("prediction.ecsv", lambda path: write_table(self.to_table(), path))
        directory.write("passes.ecsv", lambda path: write_table(self.passes_table(), path))
        directory.write_bytes("passes.ics", self.to_ics().encode())
        panels = self.panels()
        if panels:
            from torchlc.figures.passes import save_passes

            directory.write("passes.png", lambda path: save_passes(panels, path))

    def write_ics(self, path: str | Path) -> Path:
        return write_whole(Path(path), lambda partial: partial.write_bytes(self.to_ics().encode()))

    # ------------------------------------------------------------------ in words

    def _who(self) -> str:
        """The object of the scene, or those that are taken for one like it."""
        if len(self.orbiters) > 1:
            return f"{len(self.orbiters)} objects like {self.name}"
        (one,) = self.orbiters
        return self.name if one.name == self.name else f"{one.name}, like {self.name}"

    def headline(self) -> str:
        visible = [one for one in self.passes if one.visible]
        several, count = len(self.orbiters) > 1, len({one.path.orbiter for one in visible})
        whose = f", by {count} of them" if several else ""
        told = f"{self._who()}: {number_of(len(visible), 'pass')} to be seen{whose}"
        if not visible:
            return f"{told}, {str(self.iso(0.0))[:16]} to {str(self.iso(self.span.seconds[-1]))[:16]} UTC"
        best = visible[0]
        row = best.row or 0
        when = str(self.iso(self.span.seconds[best.path.index[row]]))[:19]
        named = f"{self._called(best)}, " if several else ""
        return f"{told}; brightest {named}{best.brightest[2]:.1f} mag at {when} UTC"

    def lines(self, most: int = 20) -> list[str]:
        """The brightest passes, ready to print."""
        head = f"{'begin (UTC)':19}  {'end':8}  {'object':24}  {'station':12}  {'top':>4}  {'mag':>5}  95 %"
        found = [head] if self.passes else []
        for one in self.passes[:most]:
            path = one.path
            begin, end = (str(self.iso(at)) for at in (path.begin, path.end))
            light = "in the Earth's shadow"
            if one.visible:
                light = f"{one.brightest[2]:5.1f}  {_mag(one.brightest[0])} to {_mag(one.brightest[-1])}"
                light += f"  {number_of(len(one.glints), 'glint')}" if one.glints else ""
            found.append(
                f"{begin[:19]}  {end[11:19]}  {self._called(one, 24):24}  {self._station(one)[:12]:12}  "
                f"{path.top_elevation:3.0f}°  {light}"
            )
        if len(self.passes) > most:
            dark = sum(not one.visible for one in self.passes[most:])
            shadow = f", {dark} of them in the Earth's shadow all the time" if dark else ""
            found.append(f"and {number_of(len(self.passes) - most, 'more pass')}{shadow}")
        return found

    def __repr__(self) -> str:
        told = [f"Prediction: {self.headline()}", *(f"  {line}" for line in self.lines())]
        return "\n".join([*told, *(f"  ! {text}" for text in self.warnings)])

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(repr(self))}</pre>"


def _mag(value: float) -> str:
    return f"{value:.1f}" if math.isfinite(value) else "invisible"
