"""Laboratory tables: signs of their angles, recovery of known surfaces, the Starlink v1.5 samples."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch

from torchlc.brdf import MODELS
from torchlc.errors import InputError
from torchlc.materials.goniometer import ReflectanceTable, fit_table, read_table

pytestmark = pytest.mark.filterwarnings("ignore:.*torch.jit.script:DeprecationWarning")
LABORATORY = Path(__file__).parents[1].parent / "shared" / "data" / "starlink_v15"
needs_laboratory = pytest.mark.skipif(
    not LABORATORY.exists(), reason=f"the laboratory tables are not at {LABORATORY}"
)


def synthetic(model: str, noise_dex: float, seed: int, **values: float) -> ReflectanceTable:
    """In-plane scans at three incidences, as a goniometer makes them."""
    exits = np.arange(-85.0, 86.0, 1.0)
    incidence = np.repeat([5.0, 40.0, 65.0], len(exits))
    blank = ReflectanceTable(
        incidence, np.full_like(incidence, 180.0), np.tile(exits, 3), np.ones_like(incidence), {}
    )
    normal, u = torch.eye(3, dtype=torch.float64)[[2, 0]]
    surface = MODELS[model](**values, learnable=False)
    brdf = surface(normal, u, torch.tensor(blank.to_sun), torch.tensor(blank.to_observer)).numpy()
    noise = 10 ** np.random.default_rng(seed).normal(0, noise_dex, brdf.shape)
    return ReflectanceTable(blank.incidence_deg, blank.azimuth_deg, blank.exit_deg, brdf * noise, {})


def table_file(folder: Path, text: str) -> Path:
    path = folder / "table.csv"
    path.write_text(text)
    return path


def test_angles_follow_the_tables_signs(tmp_path: Path) -> None:
    """Azimuth 180: a positive exit angle is on the mirror's side, a negative one on the source's."""
    rows = ["30,180,30,1", "30,180,-30,1", "30,0,30,1", "30,90,30,1", "30,180,90,1", "30,180,10,0"]
    table = read_table(table_file(tmp_path, "\n".join(["incidence,azimuth,exit,brdf", *rows])))
    np.testing.assert_allclose(table.mirror_angle_deg[:3], [0, 60, 60], atol=1e-6)
    across = math.degrees(math.acos(math.cos(math.radians(30)) ** 2))
    assert table.mirror_angle_deg[3] == pytest.approx(across)
    np.testing.assert_allclose((table.to_sun * table.to_observer).sum(-1)[1:3], 1.0)
    assert table.dropped == {"grazing": 1, "not positive": 1}
    assert table.without_peak(2.0).dropped == {"grazing": 1, "not positive": 1, "mirror peak": 1}


@pytest.mark.parametrize(
    ("model", "values"),
    [
        ("ashikhmin-shirley", {"n": 300.0, "r_spec": 0.3, "r_diff": 0.2}),
        ("phong-mirror", {"n": 40.0, "r_spec": 0.2, "r_diff": 0.05}),
        ("ggx", {"alpha": 0.12, "f0": 0.4, "r_diff": 0.1}),
        ("cook-torrance", {"m": 0.2, "f0": 0.1, "r_diff": 0.5}),
    ],
)
def test_known_surfaces_are_recovered_within_their_errors(model: str, values: dict[str, float]) -> None:
    fit = fit_table(synthetic(model, 0.03, 1, **values), model)
    assert fit.converged, fit.reason
    assert fit.rms_dex == pytest.approx(0.03, rel=0.15)
    for name, value in values.items():
        assert abs(fit.values[name] - value) < 4 * fit.sd[name] < 0.2 * value


def test_errors_cover_the_scatter_of_repeated_measurements() -> None:
    """Twelve tables with fresh noise: the fits scatter by their quoted errors, within three times 1 / sqrt(2 * 11), 21 %."""
    fits = [
        fit_table(synthetic("ggx", 0.05, seed, alpha=0.12, f0=0.4, r_diff=0.1), "ggx", starts=6)
        for seed in range(12)
    ]
    for name in ("alpha", "f0", "r_diff"):
        scatter = np.std([fit.values[name] for fit in fits], ddof=1)
        assert scatter / np.mean([fit.sd[name] for fit in fits]) == pytest.approx(1.0, abs=0.64)


def test_a_few_wild_rows_do_not_pull_the_fit() -> None:
    table = synthetic("ashikhmin-shirley", 0.02, 2, n=300.0, r_spec=0.3, r_diff=0.2)
    table.brdf[::40] *= 30.0
    fit = fit_table(table)
    assert fit.values["n"] == pytest.approx(300.0, rel=0.05)
    assert fit.values["r_diff"] == pytest.approx(0.2, rel=0.05)


def test_two_mirror_exponents_make_one_half_vector_lobe() -> None:
    """A lobe about the mirror direction has a quarter of its exponent about the half vector."""
    fit = fit_table(synthetic("phong-mirror", 0.0, 0, n=2500.0, r_spec=0.5, r_diff=0.001), "phong-half")
    assert fit.values["n"] == pytest.approx(4 * 2500.0, rel=0.05)


@needs_laboratory
@pytest.mark.parametrize(
    ("file", "model", "rms_dex"),
    [
        ("lab_brdf_array.csv", "phong-half", 0.25),
        ("lab_brdf_array.csv", "ashikhmin-shirley", 0.45),
        ("lab_brdf_chassis.csv", "ggx", 0.25),
        ("lab_brdf_chassis.csv", "ashikhmin-shirley", 0.35),
    ],
)
def test_measured_starlink_samples(file: str, model: str, rms_dex: float) -> None:
    """Over three decades of brightness the models err by 0.2 to 0.4 dex off the peak, Lambert by 0.8."""
    table = read_table(LABORATORY / file).without_peak(2.5)
    assert table.dropped["mirror peak"] == 20
    fit = fit_table(table, model, starts=12)
    assert fit.converged, fit.reason
    assert fit.rms_dex < rms_dex
    assert fit.rms_dex < 0.5 * fit_table(table, "lambert", starts=4).rms_dex
    assert 50 < 1 / float(MODELS[model].lobe_variance(fit.brdf().values())) < 600


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("incidence,azimuth,brdf\n1,2,3\n", "no column exit"),
        ("incidence,azimuth,exit,brdf\n1,180,3,x\n", "line 2, brdf"),
        ("incidence,azimuth,exit,brdf\n1,180,3,nan\n", "finite"),
        ("incidence,azimuth,exit,brdf\n1,180,3,1\n", "1 usable rows"),
        ("incidence,azimuth,exit,brdf\n1,180\n", "line 2, exit"),
    ],
)
def test_unusable_tables_are_refused_with_a_place(text: str, word: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=word):
        read_table(table_file(tmp_path, text))
    with pytest.raises(InputError, match=r"absent.csv: cannot be read"):
        read_table(tmp_path / "absent.csv")


def test_an_unknown_model_is_named() -> None:
    with pytest.raises(InputError, match="minnaert"):
        fit_table(synthetic("lambert", 0.0, 0, albedo=0.5), "minnaert")
