"""What docs/how_to/files_from_strangers.md says in numbers."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent


def hostile_files() -> dict[str, str]:
    """What docs/how_to/files_from_strangers.md says in numbers, from those that ``python -m tests.hostile_files`` wrote."""
    numbers = json.loads((HERE / "hostile_files.json").read_text(encoding="utf-8"))

    def table(heads: list[str], rows: list[tuple[list[str], dict[str, Any]]]) -> str:
        total = {key: sum(found[key] for _, found in rows) for key in ("done", "refused", "else")}
        lines = [
            [*heads, "files", "read", "refused in one line", "anything else"],
            ["---"] * (len(heads) + 4),
        ]
        for names, found in [*rows, (["all", *[""] * (len(heads) - 1)], total)]:
            counts = [found["done"], found["refused"], found["else"]]
            lines.append([*names, str(sum(counts)), *map(str, counts)])
        return "\n".join(f"| {' | '.join(line)} |" for line in lines)

    files, damages = numbers["files"], numbers["damages"]
    return {
        "hostile_files": table(
            ["file", "command"], [([name, f"`{found['command']}`"], found) for name, found in files.items()]
        ),
        "hostile_damages": table(["damage"], [([name], found) for name, found in damages.items()]),
        "by_hand": str(sum(numbers["by_hand"].values())),
        "by_hand_scenes": str(numbers["by_hand"]["scenes"]),
        "by_hand_recordings": str(numbers["by_hand"]["recordings"]),
    }
