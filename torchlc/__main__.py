"""``python -m torchlc``."""

from torchlc.cli import main

main()
