"""What docs/evidence/paper_story.md says in numbers."""

from __future__ import annotations

import json
from pathlib import Path

HERE = Path(__file__).parent


def evidence_of_the_peak() -> dict[str, str]:
    """What docs/evidence/paper_story.md says in numbers, from those of its example."""
    found = json.loads((HERE / "paper_story.json").read_text(encoding="utf-8"))
    rows = ["| cause | size | changes, mag | uneven over the peak, mag | refit leaves, mag | chi, refit | steepest, mag/h | refit's |"
            " global p | verdict | named, with its family | probability |", "|" + "---|" * 12]  # fmt: skip
    for name, one in found.items():
        if name == "overview" or "verdict" not in one:
            continue
        family = "; ".join(" or ".join(members) for members in one["families"]) or "nothing"
        size = "wings at the wall" if "gap_m" in one else ", ".join(
            f"{key} = {value:.3g}"
            for values in one["parameters"].values()
            for key, value in values.items()
            if not isinstance(value, str)
        )  # fmt: skip
        cells = [name, size, f"{one['largest_change_mag']:.3f}", f"{one['uneven_at_peak_mag']:.4f}",
                 f"{one['left_by_refit_mag']:.4f}", f"{one['gain']:.1f}", f"{one['slope_with']:.3f}",
                 f"{one['slope_refit']:.3f}", f"{one['global_p']:.2g}", one["verdict"], family, f"{one['told']:.2f}"]  # fmt: skip
        rows.append("| " + " | ".join(cells) + " |")
    occlusion = found["occlusion"]
    return {
        "story_plain": f"{found['lobe tail, plain']['left_at_peak_mag']:.2f}",
        "story_told": f"{found['lobe tail, plain']['told']:.2f}",
        "story_table": "\n".join(rows),
        "story_error": f"{occlusion['error_to_be_seen_mag']:.4f}",
        "story_change": f"{occlusion['largest_change_mag']:.3f}",
        "story_uneven": f"{occlusion['uneven_at_peak_mag']:.4f}",
        "story_left": f"{occlusion['left_by_refit_mag']:.4f}",
        "story_gap": f"{found['occlusion as published']['gap_m']:.2f}",
    }
