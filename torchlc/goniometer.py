"""Reflection models fitted to laboratory tables of the BRDF: what a measured surface is in a scene's words.

Angles are degrees and the BRDF is in 1/sr. Incidence and exit count from the normal; azimuth lies between the
two planes, so that at 180 a positive exit angle is on the mirror's side and a negative one on the source's
side.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchlc.brdf import MODELS, Brdf, incidence
from torchlc.errors import InputError

COLUMNS = ("incidence", "azimuth", "exit", "brdf")
ROBUST_DEX = 0.1
"""Residuals beyond this count linearly: a factor of 1.26, twice what careful goniometers disagree by."""
FAINTEST = 1e-12
"""Floor of a model's f_r, 1/sr, below any instrument's: a lobe may vanish where a table does not."""


@dataclass(frozen=True)
class ReflectanceTable:
    """A measured BRDF: (N,) columns and the rows that could not be used."""

    incidence_deg: np.ndarray
    azimuth_deg: np.ndarray
    exit_deg: np.ndarray
    brdf: np.ndarray
    dropped: dict[str, int]

    @property
    def to_sun(self) -> np.ndarray:
        """Unit vectors to the source (N, 3); the normal is z and the source's plane is xz."""
        return _direction(self.incidence_deg, np.zeros_like(self.incidence_deg))

    @property
    def to_observer(self) -> np.ndarray:
        """Unit vectors to the detector (N, 3)."""
        return _direction(self.exit_deg, self.azimuth_deg)

    @property
    def mirror_angle_deg(self) -> np.ndarray:
        """Angle between detector and mirror direction (N,)."""
        mirror = self.to_sun * [-1, -1, 1]
        return np.degrees(
            2 * np.arcsin(np.clip(np.linalg.norm(self.to_observer - mirror, axis=-1) / 2, 0, 1))
        )

    def without_peak(self, width_deg: float) -> ReflectanceTable:
        """The table without the rows within ``width_deg`` of the mirror direction, where the instrument shows."""
        keep = self.mirror_angle_deg > width_deg
        columns = (self.incidence_deg, self.azimuth_deg, self.exit_deg, self.brdf)
        cut = int((~keep).sum())
        return ReflectanceTable(*(column[keep] for column in columns), {**self.dropped, "mirror peak": cut})


def read_table(path: str | Path) -> ReflectanceTable:
    """A CSV file with the columns incidence, azimuth, exit and brdf; rows at or beyond grazing, or dark, are dropped."""
    path = Path(path)
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            missing = [name for name in COLUMNS if name not in (reader.fieldnames or ())]
            if missing:
                raise InputError(path, "header", f"no column {', '.join(missing)}", ", ".join(COLUMNS))
            rows = [_numbers(path, reader.line_num, row) for row in reader]
    except OSError as error:
        raise InputError(path, None, f"cannot be read: {error.strerror}") from error
    columns = np.array(rows, dtype=float).reshape(-1, len(COLUMNS)).T
    grazing = (np.abs(columns[0]) >= 90) | (np.abs(columns[2]) >= 90)
    dark = ~grazing & ~(columns[3] > 0)
    usable = ~grazing & ~dark
    if usable.sum() < 2:
        raise InputError(path, None, f"{int(usable.sum())} usable rows", "at least 2 with brdf > 0")
    dropped = {"grazing": int(grazing.sum()), "not positive": int(dark.sum())}
    return ReflectanceTable(*columns[:, usable], {reason: n for reason, n in dropped.items() if n})


@dataclass(frozen=True)
class ReflectanceFit:
    """A model's values for a measured surface.

    ``sd`` is the formal error of the robust fit, widened by the length over which its residuals agree; where
    the model cannot follow the surface (``rms_dex`` well above the instrument's few hundredths) it says
    little.
    """

    model: str
    values: dict[str, float]
    sd: dict[str, float]
    rms_dex: float
    median_dex: float
    rows: int
    converged: bool
    reason: str

    def brdf(self) -> Brdf:
        """The fitted model with its values fixed."""
        return MODELS[self.model](learnable=False, **self.values)


def fit_table(
    table: ReflectanceTable, model: str = "ashikhmin-shirley", *, starts: int = 24, seed: int = 0
) -> ReflectanceFit:
    """Fit ``model`` to log10 of the table: Adam from many starts, then Levenberg-Marquardt from the best few.

    The loss is pseudo-Huber with the scale ``ROBUST_DEX``. A lobe of Ashikhmin and Shirley is taken as
    isotropic.
    """
    if model not in MODELS:
        raise InputError(None, "model", model, f"one of {', '.join(MODELS)}")
    kind = MODELS[model]
    short = {long: name for name, group in kind.shared.items() for long in group}
    names = tuple(dict.fromkeys(short.get(quantity.name, quantity.name) for quantity in kind.quantities))
    tabulated = _tabulate(kind, table)
    target = torch.log10(torch.as_tensor(table.brdf))

    def natural(raw: Tensor) -> Tensor:
        return torch.stack(list(kind.from_raw(dict(zip(names, raw, strict=True))).values()))

    def residual(raw: Tensor) -> Tensor:
        """log10 of model over measurement, (..., N), from raw values (P, ...)."""
        specular, diffuse = kind.parts(tabulated, dict(zip(names, natural(raw), strict=True)))
        return torch.log10((specular + diffuse).clamp(min=FAINTEST)) - target

    generator = torch.Generator().manual_seed(seed)
    raw = 2 * torch.randn(len(names), starts, generator=generator, dtype=torch.float64)
    raw.requires_grad_()
    adam = torch.optim.Adam([raw], lr=0.1)
    for _ in range(300):
        adam.zero_grad()
        _robust(residual(raw)).sum().backward()
        adam.step()
    raw = raw.detach()
    leaders = _robust(residual(raw)).sum(-1).argsort()[:4]
    polished = [_levenberg_marquardt(residual, raw[:, leader]) for leader in leaders]
    best, settled = min(polished, key=lambda found: float(_robust(residual(found[0])).sum()))

    left, values = residual(best), natural(best)
    sd = _errors(residual, natural, best)
    return ReflectanceFit(
        model=model,
        values=dict(zip(names, values.tolist(), strict=True)),
        sd=dict(zip(names, sd.tolist(), strict=True)),
        rms_dex=float(left.square().mean().sqrt()),
        median_dex=float(left.abs().median()),
        rows=len(left),
        converged=settled,
        reason="steps below 1e-9" if settled else "still moving after 200 steps of Levenberg-Marquardt",
    )


def _tabulate(kind: type[Brdf], table: ReflectanceTable) -> dict[str, Tensor]:
    """The model's own table for one unit facet, so that ``parts`` is f_r, (N,)."""
    normal, u = torch.eye(3, dtype=torch.float64)[[2, 0]]
    angles = incidence(normal, u, torch.as_tensor(table.to_sun), torch.as_tensor(table.to_observer))
    row = angles.flattened()
    return kind.tabulate(row, 1 / (row.cos_i * row.cos_r))


def _robust(residual: Tensor) -> Tensor:
    return torch.sqrt(1 + (residual / ROBUST_DEX) ** 2) - 1


def _weighted(residual: Callable[[Tensor], Tensor], raw: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Residual (N,), the pseudo-Huber weight of each (N,), and the Jacobian (N, P)."""
    left = residual(raw)
    return left, 1 / torch.sqrt(1 + (left / ROBUST_DEX) ** 2), torch.func.jacfwd(residual)(raw)


def _levenberg_marquardt(residual: Callable[[Tensor], Tensor], raw: Tensor) -> tuple[Tensor, bool]:
    """The minimum of the robust loss near ``raw`` (P,), and whether the steps died out."""
    damping, cost = 1e-3, _robust(residual(raw)).sum()
    for _ in range(200):
        left, weight, slope = _weighted(residual, raw)
        curvature, pull = slope.T @ (weight[:, None] * slope), slope.T @ (weight * left)
        scale = torch.diag(curvature.diagonal().clamp(min=1e-12))
        step = -torch.linalg.solve(curvature + damping * scale, pull)
        step = step * (2 / step.abs().max()).clamp(max=1)
        trial = _robust(residual(raw + step)).sum()
        if trial <= cost:
            raw, damping, gain, cost = raw + step, max(damping / 5, 1e-9), cost - trial, trial
            if float(step.abs().max()) < 1e-9 or float(gain) < 1e-12 * float(cost):
                return raw, True
        elif damping > 1e12:
            return raw, True
        else:
            damping *= 4
    return raw, False


def _errors(residual: Callable[[Tensor], Tensor], natural: Callable[[Tensor], Tensor], raw: Tensor) -> Tensor:
    """Standard deviation of the natural values (P,)."""
    left, weight, slope = _weighted(residual, raw)
    variance = (weight * left**2).sum() / max(len(left) - len(raw), 1) * _correlation_length(left)
    covariance = variance * torch.linalg.pinv(slope.T @ (weight[:, None] * slope), hermitian=True)
    turn = torch.func.jacfwd(natural)(raw)
    return (turn @ covariance @ turn.T).diagonal().clamp(min=0).sqrt()


def _correlation_length(left: Tensor) -> float:
    """1 + 2 sum of the autocorrelation of neighbouring rows, up to its first zero."""
    centred = left - left.mean()
    power = float(centred.square().sum())
    length = 1.0
    for lag in range(1, len(left) // 2):
        share = float((centred[lag:] * centred[:-lag]).sum()) / power
        if share <= 0:
            break
        length += 2 * share
    return length


def _direction(from_normal_deg: np.ndarray, azimuth_deg: np.ndarray) -> np.ndarray:
    polar, azimuth = np.radians(from_normal_deg), np.radians(azimuth_deg)
    sine = np.sin(polar)
    return np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(polar)], axis=-1)


def _numbers(path: Path, line: int, row: dict[str, str]) -> list[float]:
    values = []
    for name in COLUMNS:
        try:
            values.append(float(row[name]))
        except (TypeError, ValueError):
            raise InputError(path, f"line {line}, {name}", f"{row[name]!r}", "a number") from None
        if not math.isfinite(values[-1]):
            raise InputError(path, f"line {line}, {name}", f"{row[name]!r}", "a finite number")
    return values
