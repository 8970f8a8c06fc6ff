"""Every figure and table of the paper, and their numbers in its page: ``python examples/paper [DIRECTORY]``."""

from __future__ import annotations

import argparse
import importlib
import time
from pathlib import Path

from page import fill
from publish import PAGE, write

NAMES = [f"figure_{k}" for k in range(1, 15)] + [f"table_{k}" for k in range(1, 5)] + ["nights"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("directory", nargs="?", type=Path, default=PAGE, help="default: beside the page")
    parser.add_argument(
        "--only", nargs="+", choices=NAMES, default=NAMES, metavar="NAME", help="figure_2 ..."
    )
    options = parser.parse_args()
    for name in options.only:
        began = time.perf_counter()
        write(name, importlib.import_module(name).make, options.directory)
        print(f"{name:10} {time.perf_counter() - began:5.1f} s", flush=True)
    if options.directory == PAGE:
        fill(PAGE / "index.md")


if __name__ == "__main__":
    main()
