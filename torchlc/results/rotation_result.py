"""Rotation states as a result: a table, JSON, a scene for each, figures."""

from __future__ import annotations

import html
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from torchlc.digits import rounded
from torchlc.files.writing import PER_PASS_FILE, OutputDirectory, without_nan
from torchlc.geometry.orbit.earth import icrs_from_ecliptic
from torchlc.geometry.rotation.attitude import epochs_seconds, since_nearest
from torchlc.inference.rotation.modes import RotationMode, RotationSearch
from torchlc.inference.rotation.passes import Rows, rows_of
from torchlc.inference.rotation.pole_grid import frame_of
from torchlc.inference.rotation.trials import Count
from torchlc.lightcurve.model import LightCurve
from torchlc.scene import Free, Scene
from torchlc.scene.parts import Attitude
from torchlc.tensors.vectors import unit

if TYPE_CHECKING:
    from astropy.table import Table
    from matplotlib.figure import Figure

SCHEMA = "torchlc-rotation/1"
WITHIN_SD = 5.0
"""Standard deviations that the period's bounds in a scene are from its value at least: one in a million lies beyond."""


@dataclass(frozen=True)
class RotationResult:
    """Modes best first, and what was looked at; ``provenance`` says from what it was made."""

    search: RotationSearch
    seed: int = 0
    seconds: float = 0.0
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def modes(self) -> list[RotationMode]:
        return list(self.search.modes)

    @property
    def warnings(self) -> list[str]:
        return list(self.search.warnings)

    def told(self, mode: RotationMode) -> dict[str, Any]:
        """One mode as JSON holds it."""
        ra, dec = equatorial(mode)
        lon, lat = ecliptic(mode)
        numbers, sd = mode.numbers, mode.sd
        shrunk = math.cos(math.radians(numbers["pole_lat"]))
        pole_sd = math.hypot(sd.get("pole_lat", 0.0), sd.get("pole_lon", 0.0) * shrunk)
        tilt = [numbers[f"tilt_{axis}"] for axis in "xyz"] if "tilt_x" in numbers else None
        rates, moments = mode.rates, mode.moments
        return {
            "mode": mode.scene.attitude.mode,
            "pole_icrs": [ra, dec],
            "pole_ecliptic_j2000": [lon, lat],
            "pole_sd_deg": pole_sd,
            "period_s": mode.period_s,
            "period_sd_s": mode.period_sd_s,
            "period_h": numbers["period"],
            "rev_per_hour": 1 / numbers["period"],
            "periods_s": None
            if rates is None
            else {
                "precession_long": mode.period_s,
                "precession_short": 1 / float(rates.precession_short),
                "rotation": 1 / float(rates.polhode),
            },
            "axis_mode": None if rates is None else "short" if bool(rates.short_axis_mode) else "long",
            "period_rate_ms_per_day": numbers.get("period_rate", 0.0 if "period_rate" in sd else None),
            "period_rate_sd_ms_per_day": sd.get("period_rate"),
            "epoch": _told_epoch(mode.scene),
            "phase_deg": numbers["phase"] % 360,
            "phase_sd_deg": sd.get("phase"),
            "polhode_phase_deg": numbers["polhode_phase"] % 360 if mode.tumbling else None,
            "tilt_deg": tilt,
            "nutation_deg": numbers.get("nutation", 0.0),
            "nutation_sd_deg": sd.get("nutation"),
            "inertia_xyz": None if moments is None else list(moments),
            "inertia_ratios": None
            if moments is None
            else [moment / max(moments) for moment in sorted(moments)[:2]],
            "inertia_sd": [sd[f"inertia_{axis}"] for axis in "xy"] if moments else None,
            "chi2": mode.chi2,
            "above_best": mode.above,
            "rms_mag": mode.rms,
            "passes": [
                {"period_s": period, "period_sd_s": sd_, "synodic_s": light}
                for (period, sd_), light in zip(mode.periods, self._synodic(mode), strict=True)
            ],
            "per_night": list(mode.apart),
            "nights": [_told_night(mode, night) for night in mode.nights],
            "probability": mode.probability,
            "turns_between_passes": list(mode.counts),
            "counts_possible": mode.possible,
            "counts_likely": [_told_count(count) for count in mode.likely],
            "mirror": mode.mirror,
        }

    @cached_property
    def _rows(self) -> Rows:
        return rows_of(LightCurve(self.modes[0].scene, self.search.recording))

    def _synodic(self, mode: RotationMode) -> list[float | None]:
        """Turns, s, of each pass against the bisector of Sun and observer, whose direction the light follows; none of a free rotation."""
        if mode.tumbling:
            return [None] * len(mode.periods)
        rows = self._rows
        frame = frame_of(torch.tensor(_unit(*equatorial(mode)), dtype=torch.float64))
        x, y, _ = (unit(rows.to_sun + rows.to_observer) @ frame.T).unbind(-1)
        azimuth = torch.atan2(y, x)
        turns: list[float | None] = []
        for number, (period, _) in enumerate(mode.periods):
            here = rows.of(number)
            moved = np.unwrap(azimuth[here].numpy()) / (2 * math.pi)
            seconds = (rows.seconds[here] - rows.middle[number]).numpy()
            along = float(seconds @ (moved - moved.mean()) / max(seconds @ seconds, 1e-12))
            turns.append(1 / abs(1 / period - along))
        return turns

    def to_json(self) -> dict[str, Any]:
        search = self.search
        return without_nan(
            {
                "schema": SCHEMA,
                "verdict": search.verdict,
                "decided": search.decided,
                "modes": [self.told(mode) for mode in search.modes],
                "phase_per_pass": [self.told(mode) for mode in search.loose],
                "dof": search.dof,
                "rows": search.rows,
                "passes": search.passes,
                "passes_connected": search.connected,
                "symmetry": search.symmetry,
                "searched_s": list(search.searched_s),
                "seconds": self.seconds,
                "warnings": self.warnings,
                "provenance": dict(self.provenance),
            }
        )

    def to_table(self) -> Table:
        """A row a mode, best first."""
        from astropy.table import Table

        names = ("period_s", "period_sd_s", "rev_per_hour", "phase_deg", "chi2", "probability")
        rows = [self.told(mode) for mode in self.search.modes]
        table = Table({name: [row[name] for row in rows] for name in names})
        table["ra_deg"], table["dec_deg"] = (np.array([row["pole_icrs"][k] for row in rows]) for k in (0, 1))
        return table

    def lines(self) -> list[str]:
        """What a person reads."""
        lines = [self.search.verdict, *self._mode_lines(self.search.modes)]
        if self.search.loose:
            lines.append("with a phase for each night, no count of turns taken for granted:")
            lines += self._mode_lines(self.search.loose)
        return lines

    def _mode_lines(self, modes: Sequence[RotationMode]) -> list[str]:
        lines = []
        for number, mode in enumerate(modes):
            row = self.told(mode)
            (ra, dec), (lon, lat) = row["pole_icrs"], row["pole_ecliptic_j2000"]
            rate = row["period_rate_ms_per_day"]
            parts = [
                f"pole RA {ra:.2f} Dec {dec:+.2f} (ecliptic {lon:.2f} {lat:+.2f}) +- {rounded(row['pole_sd_deg'], 2)} deg",
                f"turn in {row['period_s']:.8g} +- {rounded(row['period_sd_s'], 1)} s ({row['rev_per_hour']:.6g} rev/h)",
                f"phase {row['phase_deg']:.1f} deg at {row['epoch']}",
            ]
            if row["periods_s"] is not None:
                first, second = row["inertia_ratios"]
                parts[1] = (
                    f"long axis about it in {row['period_s']:.8g} +- {rounded(row['period_sd_s'], 1)} s ({row['rev_per_hour']:.6g} rev/h), "
                    f"short axis in {row['periods_s']['precession_short']:.6g} s, the body's own turn {row['periods_s']['rotation']:.6g} s"
                )
                parts.append(
                    f"{row['axis_mode']}-axis mode, nutation {row['nutation_deg']:.2f} deg, "
                    f"moments of inertia {first:.3f} : {second:.3f} : 1"
                )
            if rate is not None and row["period_rate_sd_ms_per_day"] is not None:
                sd = row["period_rate_sd_ms_per_day"]
                parts.append(
                    f"period grows by {rate:.4g} +- {rounded(sd, 1)} ms a day"
                    if rate
                    else f"a change of the period by {rounded(sd, 1)} ms a day would not show"
                )
            if row["tilt_deg"] is not None:
                parts.append(f"tilt {', '.join(f'{x:.2f}' for x in row['tilt_deg'])} deg")
            if any(row["turns_between_passes"]):
                turns = ", ".join(f"{count:+g}" for count in row["turns_between_passes"])
                parts.append(f"turns between passes {turns} against mode 1")
            if mode.possible > 1 and mode.periods:
                each = ", ".join(f"{period:.6g} +- {rounded(sd_, 1)}" for period, sd_ in mode.periods)
                parts.append(f"turns of the passes, each by itself: {each} s")
            if mode.possible > 1:
                parts.append(f"{mode.possible} counts of turns between passes fit")
            if mode.apart:
                parts[2:3] = [
                    f"{' and '.join(mode.apart)} per pass: "
                    + ", ".join(
                        (f"{night['period_s']:.7g} s " if "period" in mode.apart else "")
                        + f"{night['phase_deg']:.1f} +- {rounded(night['phase_sd_deg'], 1)} deg in {night['night']}"
                        for night in row["nights"]
                    )
                ]
            if mode.mirror:
                parts.append(mode.mirror)
            lines.append(
                f"  {number + 1}. chi2 {mode.chi2:.1f}, probability {mode.probability:.3g}: {'; '.join(parts)}"
            )
        return lines

    def scene(self, number: int = 0) -> Scene:
        """The scene of a mode, ready for a fit or a diagnosis: rotation and materials at its numbers, free near them, the period within
        WITHIN_SD standard deviations of all counts of turns that are possible."""
        return self._scene(self.search.modes[number])

    def _scene(self, mode: RotationMode) -> Scene:
        scene, numbers = mode.scene, mode.numbers
        names = LightCurve(scene, self.search.recording).names
        fitted = dict(zip(names, mode.theta.tolist(), strict=True))
        attitude: dict[str, Any] = {}
        for key in scene.attitude.model_fields_set:
            attitude[key] = getattr(scene.attitude, key)
        attitude["pole"] = tuple(
            _at(given, numbers[key])
            for given, key in zip(attitude["pole"], ("pole_lon", "pole_lat"), strict=True)
        )
        for key in ("period", "phase", "period_rate", "nutation", "polhode_phase"):
            if key in attitude:
                attitude[key] = _at(attitude[key], numbers[key], key, numbers)
        attitude["period"] = _wider(attitude["period"], WITHIN_SD * mode.sd.get("period", 0.0))
        if "inertia" in attitude:
            attitude["inertia"] = tuple(
                _at(given, numbers[f"inertia_{axis}"])
                for given, axis in zip(attitude["inertia"], "xy", strict=True)
            )
        if "tilt" in attitude:
            attitude["tilt"] = tuple(
                _at(given, numbers[f"tilt_{axis}"])
                for given, axis in zip(attitude["tilt"], "xyz", strict=True)
            )
        materials = {
            name: material.model_copy(
                update={
                    "parameters": {
                        key: _at(value, fitted.get(f"{name}.{key}", math.nan))
                        for key, value in material.parameters.items()
                    }
                }
            )
            for name, material in scene.materials.items()
        }
        return scene.model_copy(update={"attitude": Attitude(**attitude), "materials": materials})

    def write(self, directory: OutputDirectory) -> None:
        """rotation.json, scene.toml of the best mode, and figures."""
        search = self.search
        best = search.modes[0]
        directory.write_json("rotation.json", self.to_json())
        directory.write_text("scene.toml", self.scene().to_toml())
        if search.loose:
            directory.write_text(PER_PASS_FILE, self._scene(search.loose[0]).to_toml())
        else:
            directory.clear([PER_PASS_FILE])
        from torchlc.figures import rotation as figures
        from torchlc.figures.saving import drawn, save

        def write(name: str, draw: Callable[[], Figure]) -> None:
            directory.write(
                name,
                lambda path: save(drawn(draw), path, dpi=figures.PNG_DPI, format="png", facecolor="white"),
            )

        with np.errstate(divide="ignore"):
            period = 1 / search.frequency
        marks = [mode.period_s for mode in search.modes]
        write("periodogram.png", lambda: figures.periodogram(period, search.power, marks))
        modes = np.array([_unit(*equatorial(mode)) for mode in search.modes])
        write("poles.png", lambda: figures.poles(*search.pole_map, modes))
        model = LightCurve(best.scene, search.recording)
        rows = self._rows
        with torch.no_grad():
            predicted = model(best.theta).numpy()[rows.index.numpy()]
        seconds, number = rows.seconds.numpy(), rows.number.numpy()
        phase, meaning = (seconds / best.period_s) % 1.0, "phase of a turn"
        if best.apart:
            since = since_nearest(rows.seconds, epochs_seconds(best.scene, search.recording, "epoch")).numpy()
            night = search.recording.night[rows.index.numpy()]
            names = search.recording.night_ids
            period, start = (
                np.array([_of_night(best.numbers, key, name) for name in names])[night]
                for key in ("period", "phase")
            )
            phase = (since / (3600 * period) + start / 360) % 1.0
        if best.tumbling:  # no phase of one turn folds it
            first = np.array([seconds[number == index].min() for index in range(rows.passes)])
            phase, meaning = (
                (seconds - first[number]) / best.period_s,
                "turns of the long axis since the first row",
            )
        observed = search.recording.observed[rows.index.numpy()]
        write("folded.png", lambda: figures.folded(phase, observed, predicted, number, meaning))

    def __repr__(self) -> str:
        return "\n".join([*self.lines(), *(f"  ! {text}" for text in self.warnings)])

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(repr(self))}</pre>"


def _at(number: Any, value: float, key: str = "", numbers: Mapping[str, float] | None = None) -> Any:
    """A number of a scene with another value, still inside its bounds; with those of nights by ``key`` where it has them."""
    if not isinstance(number, Free) or math.isnan(value):
        return number
    low = -math.inf if number.low is None else number.low
    high = math.inf if number.high is None else number.high
    nights = {
        night: min(max(_of_night(numbers or {}, key, night), low), high) for night in number.values or ()
    }
    return number.model_copy(
        update={"value": min(max(value, low), high), **({"values": nights} if nights else {})}
    )


def _wider(number: Any, reach: float) -> Any:
    """A number of a scene whose bounds are at least ``reach`` from its value."""
    if not isinstance(number, Free) or number.low is None or number.high is None or number.values:
        return number
    low = min(number.low, max(number.value - reach, 0.5 * number.value))  # no period is negative
    return number.model_copy(update={"low": low, "high": max(number.high, number.value + reach)})


def _of_night(numbers: Mapping[str, float], key: str, night: str) -> float:
    """A number of a night, or that of all."""
    return numbers.get(f"{key}[{night}]", numbers.get(key, 0.0))


def _told_night(mode: RotationMode, night: str) -> dict[str, Any]:
    """What a night has for itself, as JSON holds it."""
    return {
        "night": night,
        "period_s": 3600 * _of_night(mode.numbers, "period", night),
        "period_sd_s": 3600 * _of_night(mode.sd, "period", night),
        "phase_deg": mode.numbers[f"phase[{night}]"] % 360,
        "phase_sd_deg": mode.sd[f"phase[{night}]"],
    }


def _told_count(count: Count) -> dict[str, Any]:
    """A possible count of turns between passes, as JSON holds it."""
    return {
        "turns_more": list(count.more),
        "probability": count.probability,
        "period_s": count.period_s,
        "period_rate_ms_per_day": count.period_rate,
    }


def _told_epoch(scene: Scene) -> str:
    epoch = scene.attitude.epoch
    return ", ".join(map(str, epoch)) if isinstance(epoch, tuple) else str(epoch)


def _unit(longitude_deg: float, latitude_deg: float) -> np.ndarray:
    lon, lat = math.radians(longitude_deg), math.radians(latitude_deg)
    return np.array([math.cos(lat) * math.cos(lon), math.cos(lat) * math.sin(lon), math.sin(lat)])


def _angles(way: np.ndarray) -> tuple[float, float]:
    return math.degrees(math.atan2(way[1], way[0])) % 360, math.degrees(
        math.asin(max(-1.0, min(1.0, way[2])))
    )


def equatorial(mode: RotationMode) -> tuple[float, float]:
    """Right ascension and declination of a mode's pole, deg, ICRS."""
    way = _unit(mode.numbers["pole_lon"], mode.numbers["pole_lat"])
    return _angles(icrs_from_ecliptic() @ way if mode.scene.orbit.vectors == "ecliptic" else way)


def ecliptic(mode: RotationMode) -> tuple[float, float]:
    """Longitude and latitude of a mode's pole, deg, ecliptic and equinox of J2000."""
    return _angles(icrs_from_ecliptic().T @ _unit(*equatorial(mode)))
