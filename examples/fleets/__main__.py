"""Fleets of Starlink satellites: v1.5 by unseen nights, v2 mini by unseen satellites, visor or none from 23 magnitudes.

    python examples/fleets [DIRECTORY]

Satellites of one design share geometry and materials; each differs by an offset from a population whose spread is
learnt. Needs ../shared/data/starlink_v15, starlink_v2mini and starlink_2021_visor; without them the script says so and ends.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

from modes import low_modes
from observers import observers
from populations import fleet
from unseen import DATA, ROOT
from v15 import v15
from visor import visor

PARTS = {"v15": v15, "v2mini": fleet, "modes": low_modes, "observers": observers, "visor": visor}


def main() -> None:
    if not (DATA / "starlink_v2mini").exists():
        print(f"{DATA / 'starlink_v2mini'} is not here: nothing to do")
        return
    out = Path(sys.argv[1] if len(sys.argv) > 1 else ROOT / "out")
    out.mkdir(parents=True, exist_ok=True)
    path = out / "fleets.json"
    found: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {}
    for name in sys.argv[2:] or PARTS:
        began = time.process_time()
        found[name] = PARTS[name]()
        found[name]["cpu_seconds"] = time.process_time() - began
        path.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
