"""Reflection models fitted to laboratory tables of the BRDF: what a measured surface is in a scene's words.

Angles are degrees and the BRDF is in 1/sr. Incidence and exit count from the normal; azimuth lies between the
two planes, so that at 180 a positive exit angle is on the mirror's side and a negative one on the source's
side.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchlc.brdf import MODELS, Brdf, incidence
from torchlc.errors import InputError
from torchlc.files.decimals import decimal
from torchlc.tensors.least_squares import minimise
from torchlc.tensors.moving import on_cpu

COLUMNS = ("incidence", "azimuth", "exit", "brdf")
ROBUST_DEX = 0.1
"""Residuals beyond this count linearly: a factor of 1.26, twice what careful goniometers disagree by."""
RAW_EDGE = 20.0
"""Largest unconstrained number: 2e-9 of the range from a bound."""
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
        """The table without rows within ``width_deg`` of the mirror direction, where the instrument shows."""
        keep = self.mirror_angle_deg > width_deg
        return ReflectanceTable(
            self.incidence_deg[keep],
            self.azimuth_deg[keep],
            self.exit_deg[keep],
            self.brdf[keep],
            {**self.dropped, "mirror peak": int((~keep).sum())},
        )


def read_table(path: str | Path) -> ReflectanceTable:
    """A CSV file with columns incidence, azimuth, exit, brdf; drops rows that are dark or at 90 degrees."""
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
    angle_i, azimuth, angle_r, brdf = np.array(rows, dtype=float).reshape(-1, len(COLUMNS)).T
    grazing = (np.abs(angle_i) >= 90) | (np.abs(angle_r) >= 90)
    dark = ~grazing & (brdf <= 0)
    usable = ~grazing & ~dark
    if usable.sum() < 2:
        raise InputError(path, None, f"{int(usable.sum())} usable rows", "at least 2 with brdf > 0")
    dropped = {"grazing": int(grazing.sum()), "not positive": int(dark.sum())}
    dropped = {reason: count for reason, count in dropped.items() if count}
    return ReflectanceTable(angle_i[usable], azimuth[usable], angle_r[usable], brdf[usable], dropped)


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
        values: dict[str, Any] = dict(self.values)
        return MODELS[self.model](learnable=False, **values)


@on_cpu
def fit_table(
    table: ReflectanceTable, model: str = "ashikhmin-shirley", *, starts: int = 24, seed: int = 0
) -> ReflectanceFit:
    """Fit ``model`` to log10 of the table by Levenberg-Marquardt from many starts at once.

    The loss is pseudo-Huber with the scale ``ROBUST_DEX``. A lobe of Ashikhmin and Shirley is isotropic here.
    """
    if model not in MODELS:
        raise InputError(None, "model", model, f"one of {', '.join(MODELS)}")
    kind = MODELS[model]
    short = {long: name for name, group in kind.shared.items() for long in group}
    names = tuple(dict.fromkeys(short.get(quantity.name, quantity.name) for quantity in kind.quantities))
    tabulated = _tabulate(kind, table)
    target = torch.log10(torch.as_tensor(table.brdf))

    def natural(raw: Tensor) -> dict[str, Tensor]:
        return kind.from_raw(dict(zip(names, raw.unbind(-1), strict=True)))

    def residual(raw: Tensor) -> Tensor:
        """log10 of model over measurement, (..., N), from raw values (..., P)."""
        specular, diffuse = kind.parts(tabulated, natural(raw))
        return torch.log10((specular + diffuse).clamp(min=FAINTEST)) - target

    generator = torch.Generator().manual_seed(seed)
    start = 2 * torch.randn(starts, len(names), generator=generator, dtype=torch.float64)
    edge = torch.full((len(names),), RAW_EDGE, dtype=torch.float64)
    solution = minimise(lambda raw: _robust(residual(raw)), start, -edge, edge, iterations=200)
    best = int(solution.cost.argmin())
    raw, slope = solution.y[best], solution.jacobian[best]
    left, values = residual(raw), natural(raw)

    variance = solution.cost[best] / max(len(left) - len(names), 1) * _correlation_length(left)
    covariance = variance * torch.linalg.pinv(slope.T @ slope, hermitian=True)
    turn = torch.func.jacrev(lambda raw: torch.stack(list(natural(raw).values())))(raw)
    sd = (turn @ covariance @ turn.T).diagonal().clamp(min=0).sqrt()
    settled = bool(solution.converged[best])
    at_bound = [name for name, number in zip(names, raw, strict=True) if abs(float(number)) > RAW_EDGE / 2]
    return ReflectanceFit(
        model=model,
        values={name: float(value) for name, value in values.items()},
        sd=dict(zip(names, sd.tolist(), strict=True)),
        rms_dex=float(left.square().mean().sqrt()),
        median_dex=float(left.abs().median()),
        rows=len(left),
        converged=settled and not at_bound,
        reason=f"{', '.join(at_bound)} at a bound" if at_bound else "settled" if settled else "still moving",
    )


def _tabulate(kind: type[Brdf], table: ReflectanceTable) -> dict[str, Tensor]:
    """The model's own table for one unit facet, so that ``parts`` is f_r, (N,)."""
    normal, u = torch.eye(3, dtype=torch.float64)[[2, 0]]
    angles = incidence(normal, u, torch.as_tensor(table.to_sun), torch.as_tensor(table.to_observer))
    row = angles.flattened()
    return kind.tabulate(row, 1 / (row.cos_i * row.cos_r))


def _robust(residual: Tensor) -> Tensor:
    """Residual whose square is the pseudo-Huber loss: r when small, sqrt(2 |r| ROBUST_DEX) when large."""
    return residual * torch.sqrt(2 / (1 + torch.sqrt(1 + (residual / ROBUST_DEX) ** 2)))


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
            values.append(decimal(row[name]))
        except (AttributeError, ValueError):
            raise InputError(path, f"line {line}, {name}", f"{row[name]!r}", "a number") from None
        if not math.isfinite(values[-1]):
            raise InputError(path, f"line {line}, {name}", f"{row[name]!r}", "a finite number")
    return values
