"""What detector and calibration make of a curve."""

from __future__ import annotations

import numpy as np
from body import Scene, number
from curve import Curve, Effects
from sky import Array


def photometry(curve: Curve, scene: Scene, effects: Effects) -> Array:
    """Noiseless apparent magnitudes (T,) after detector and calibration; inf where no light arrives."""
    flux = curve.flux.copy()
    hours = (curve.t - curve.t.mean()) / 3600.0
    if "flash" in effects:  # outside torchlc's library: a part that turns by itself
        flash = effects["flash"]
        cycle = np.mod((curve.t - curve.t[0]) / 60.0 / flash["period_min"] + 0.5, 1.0) - 0.5
        flux += flash["fraction"] * np.median(curve.flux) * np.exp(-0.5 * (cycle / flash["width"]) ** 2)
    if "star" in effects:  # outside torchlc's library: in the aperture for a while
        star = effects["star"]
        inside = np.abs(curve.t - star["time"]) < 30.0 * star["minutes"]
        flux += star["fraction"] * np.median(curve.flux) * inside
    if "background" in effects:
        flux += effects["background"]["fraction"] * np.median(curve.flux)
    if "saturation" in effects:
        flux *= 1.0 - effects["saturation"]["q"] * flux / flux.max()
    with np.errstate(divide="ignore"):
        mag = -2.5 * np.log10(np.maximum(flux, 0.0))
    mag += number(scene.parameters.get("band_sun_magnitude", -26.7))
    mag += number(scene.parameters.get("zero_point", 0.0))
    if "color_term" in effects:
        color = effects["color_term"]
        chosen = [name.startswith(color["component"]) for name in curve.components]
        mag = mag + color["mag"] * curve.component_flux[:, chosen].sum(1) / np.maximum(curve.flux, 1e-300)
    if "extinction_residual" in effects:
        mag = mag + effects["extinction_residual"]["mag_per_airmass"] * (curve.airmass - 1.0)
    if "zero_point_drift" in effects:
        mag = mag + effects["zero_point_drift"]["mag_per_hour"] * hours
    if "zero_point_step" in effects:
        mag = mag + effects["zero_point_step"]["mag"] * (curve.t > effects["zero_point_step"]["time"])
    if "cloud" in effects:  # outside torchlc's library: it comes quickly and clears slowly
        cloud = effects["cloud"]
        since = (curve.t - cloud["time"]) / 60.0 / cloud["minutes"]
        mag = mag + cloud["mag"] * np.exp(-0.5 * (since / np.where(since < 0, 0.3, 1.0)) ** 2)
    if "cirrus" in effects:  # outside torchlc's library: thin cloud that dims in waves, and never brightens
        cirrus = effects["cirrus"]
        waves = np.random.default_rng(cirrus["seed"])
        depth = np.zeros_like(mag)
        for _ in range(12):
            turns = (curve.t - curve.t[0]) / 60.0 / (2 * np.pi * cirrus["tau_min"] * waves.uniform(0.3, 1.5))
            depth += waves.standard_normal() * np.sin(2 * np.pi * (turns + waves.random()))
        mag = mag + cirrus["mag"] * np.abs(depth) / np.sqrt(6.0)
    return mag
