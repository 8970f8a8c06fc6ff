"""A light curve in an ordinary PyTorch training script: your own loop, your own optimiser, your own loss.

    python examples/training_script.py [DIRECTORY]

The demo's recording is fitted with Adam, the parameters are saved as a state_dict, and loaded again. Chi-square
stays at 11 a row: the demo's panels hold a second material, which `torchlc diagnose` names.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import torch

import torchlc

DEMO = Path(torchlc.__file__).parent / "demo"
STEPS = 400


def main() -> None:
    scene, recording = torchlc.load(DEMO / "scene.toml", DEMO / "recording.ecsv")
    model = torchlc.LightCurve(scene, recording)
    print(f"{scene.name}: {len(recording)} rows, free: {', '.join(model.names)}")
    observed, error = torch.as_tensor(recording.observed), torch.as_tensor(recording.error)
    optimizer = torch.optim.Adam(model.parameters(), lr=0.05)
    for step in range(STEPS):
        optimizer.zero_grad()
        loss = (((model() - observed) / error) ** 2).mean()
        loss.backward()
        optimizer.step()
        if step % 100 == 0 or step == STEPS - 1:
            print(f"step {step:3}  chi-square per row {loss.item():9.3f}")
    for name, value in zip(model.names, model.theta().tolist(), strict=True):
        print(f"{name:14} {value:10.4g}")

    out = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())
    out.mkdir(parents=True, exist_ok=True)
    torch.save(model.state_dict(), out / "materials.pt")
    again = torchlc.LightCurve(scene, recording)
    again.load_state_dict(torch.load(out / "materials.pt"))
    with torch.no_grad():
        same = torch.equal(again(), model())
    print(f"saved to {out / 'materials.pt'} and loaded: {'the same curve' if same else 'another curve'}")
    if not same:
        sys.exit(1)


if __name__ == "__main__":
    main()
