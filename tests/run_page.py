"""Run the code of one page, ``python -m tests.run_page PAGE``, in a folder with the demo's two files.

Blocks marked ``python`` share one namespace and blocks marked ``sh`` one folder, in the order of the page; a
``toml`` block that is a scene is read as one. Other blocks (``text``, ``console``) are only shown.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

BLOCK = re.compile(r"^```(?P<kind>\w+)\n(?P<code>.*?)^```$", re.MULTILINE | re.DOTALL)
SCENE = "torchlc-scene/1"


def blocks(page: Path) -> Iterator[tuple[int, str, str]]:
    """(line of the page, kind, code) of every block that runs."""
    text = page.read_text(encoding="utf-8")
    for match in BLOCK.finditer(text):
        kind, code = match["kind"], match["code"]
        if kind in ("python", "sh") or (kind == "toml" and SCENE in code):
            yield text.count("\n", 0, match.start()) + 2, kind, code


def run(page: Path) -> None:
    namespace: dict[str, object] = {"__name__": "__main__"}
    for line, kind, code in blocks(page):
        if kind == "python":
            exec(compile("\n" * (line - 1) + code, str(page), "exec"), namespace)
        elif kind == "sh":
            subprocess.run(["bash", "-euo", "pipefail", "-c", code], check=True)
        else:
            from torchlc.scene import Scene

            Scene.from_toml(code, Path(), f"{page}:{line}")


if __name__ == "__main__":
    run(Path(sys.argv[1]))
