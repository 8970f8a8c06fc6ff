"""``python -m torchlc``."""

from torchlc.cli import main

if __name__ == "__main__":
    main()
